"""`arpd simulate`: arpd on a recorded or made-up link."""

from __future__ import annotations

import json

import pytest

from arpd.cli import options

CONFIG = """\
relay: {topics: [{name: /camera}]}
topics:
  - {name: /link/camera, payload: 20kB, source_rate_hz: 20}
  - {name: /scan, payload: 5kB, source_rate_hz: 10, weight: 2}
  - {name: /cmd_vel, payload: 80B, source_rate_hz: 10, min_rate_hz: 10}
"""
TINY = "topics: [{name: /a, payload: 100B, source_rate_hz: 1}]\n"
TRACE = "time_s,rate_bit_per_s,loss\n0,8000000,0\n12,2000000,0.001\n"
QUICK = ("--duration", "20s")
WAYS = ("arpd", "without", "oracle")


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("simulate")
    (folder / "robot.yaml").write_text(CONFIG)
    (folder / "tiny.yaml").write_text(TINY)
    (folder / "empty.yaml").write_text("link: {interface: auto}\n")
    (folder / "walk.csv").write_text(TRACE)
    return folder


@pytest.fixture
def simulate(files, run, monkeypatch):
    """Run ``arpd simulate`` beside the files."""
    monkeypatch.chdir(files)

    def simulate(*arguments, config="robot.yaml"):
        return run("simulate", *(() if config is None else ("--config", config)), *arguments)

    return simulate


# -- what it says


def test_the_document_has_everything(simulate):
    """JSON has summary, topics and course of every way, in a form that any parser reads."""
    code, out, _ = simulate("--trace", "walk.csv", *QUICK, "--json", "--seed", "3")
    document = json.loads(out, parse_constant=pytest.fail)
    assert code == 0
    assert (document["trace"], document["duration_s"], document["seed"]) == ("walk.csv", 20.0, 3)
    assert set(document["ways"]) == set(WAYS)
    for way in document["ways"].values():
        assert {len(column) for column in way["course"].values()} == {200}
        assert [topic["topic"] for topic in way["topics"]] == ["/camera", "/scan", "/cmd_vel"]
    arpd, without, oracle = (document["ways"][way] for way in WAYS)
    assert set(without["course"]["estimate_bytes_per_second"]) == {None}
    assert oracle["summary"]["error_p90"] < 1e-9 < arpd["summary"]["error_p90"]
    assert arpd["course"]["truth_bytes_per_second"][0] == 1e6
    assert arpd["course"]["truth_bytes_per_second"][-1] == 2.5e5
    assert "start" in arpd["course"]["cause"]
    robot = [topic["prefix"] + topic["name"] for topic in document["robot"]["topics"]]
    assert robot == ["/link/camera", "/scan", "/cmd_vel"]


def test_the_same_seed_gives_the_same_document(simulate):
    """Another seed gives another document."""
    first, again, other = (
        simulate("--rate", "0:3mbit", *QUICK, "--json", "--loss", "0.01", "--seed", seed, config="tiny.yaml")[1]
        for seed in "112"
    )
    assert first == again != other


# -- the robot and the link


def test_without_a_configuration_the_demo_robot_plays(simulate, files, monkeypatch):
    """A default configuration that exists is read, one that is named must exist, and the demo's fills in."""
    monkeypatch.setattr(options, "DEFAULT_CONFIG", files / "nosuch.yaml")
    code, out, _ = simulate("--rate", "0:20mbit", *QUICK, config="empty.yaml")
    assert (code, "the demo robot; " in out) == (0, True)
    code, _, err = simulate("--rate", "0:20mbit", *QUICK, config="nosuch.yaml")
    assert (code, err.startswith("nosuch.yaml:1:1: file: ")) == (78, True)
    monkeypatch.setattr(options, "DEFAULT_CONFIG", files / "tiny.yaml")
    document = json.loads(simulate("--rate", "0:20mbit", *QUICK, "--json", config=None)[1])
    assert (document["config"], document["robot"]["is_demo"]) == (str(files / "tiny.yaml"), False)
