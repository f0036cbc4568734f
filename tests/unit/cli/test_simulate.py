"""`arpd simulate`: arpd on a recorded or made-up link."""

from __future__ import annotations

import json
import re
from itertools import pairwise
from pathlib import Path

import pytest

from arpd.cli import main as cli

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


@pytest.fixture
def refused(simulate):
    """Run it with arguments that cannot be used; returns exit code and the one line that says why."""

    def refused(*arguments, **more):
        code, out, err = simulate(*arguments, **more)
        assert out == ""
        assert err.count("\n") == 1
        return code, err.strip()

    return refused


# -- what it says


def test_the_table_has_the_three_ways_side_by_side(simulate):
    """The tables have the whole run, every topic twice, and the events."""
    code, out, err = simulate("--trace", "walk.csv", *QUICK)
    assert (code, err) == (0, "")
    assert re.search(r"^link +walk\.csv: 2 Mbit/s to 8 Mbit/s, mean 5\.6 Mbit/s$", out, re.MULTILINE)
    assert re.search(r"^from 10 s on +arpd +without +oracle$", out, re.MULTILINE)
    assert re.search(r"^of the oracle's, % +[\d.]+ +[\d.]+ +100\.0$", out, re.MULTILINE)
    assert re.search(r"^estimate off by, median, % +[\d.]+ +- +0\.0$", out, re.MULTILINE)
    for topic in ("/camera", "/scan", "/cmd_vel"):
        assert len(re.findall(rf"^{topic} ", out, re.MULTILINE)) == 2
    assert re.search(r"^ +1[2-9]\.\d s +down +[\d.]+ Mbit/s -> [\d.]+ Mbit/s$", out, re.MULTILINE)
    assert max(map(len, out.splitlines())) <= 120


def test_the_names_of_figures_stand_above_their_columns(simulate):
    """A title ends where the oracle's column ends."""
    _, out, _ = simulate("--rate", "0:8mbit", *QUICK, config="tiny.yaml")
    lines = out.splitlines()
    for above, titles in pairwise(lines):
        if titles.startswith("topic, whole run"):
            ends = [match.end() for match in re.finditer("oracle", titles)]
            assert [match.end() for match in re.finditer(r"\S+(?: \S+)*", above)] == ends


def test_the_document_has_everything(simulate):
    """JSON has summary, topics and course of every way, in a form that any parser reads."""
    code, out, _ = simulate("--trace", "walk.csv", *QUICK, "--json", "--seed", "3")
    document = json.loads(out, parse_constant=pytest.fail)
    assert code == 0
    assert (document["trace"], document["duration_s"], document["seed"]) == ("walk.csv", 20.0, 3)
    assert tuple(document["ways"]) == WAYS
    for way in document["ways"].values():
        assert {len(column) for column in way["course"].values()} == {200}
        assert [topic["topic"] for topic in way["topics"]] == ["/camera", "/scan", "/cmd_vel"]
    arpd, without, oracle = document["ways"].values()
    assert "estimate_bytes_per_second" not in without["course"]
    assert oracle["summary"]["error_p90"] < 1e-9 < arpd["summary"]["error_p90"]
    assert arpd["course"]["truth_bytes_per_second"][0] == 1e6
    assert arpd["course"]["truth_bytes_per_second"][-1] == 2.5e5
    assert document["events"][0]["what"] == "start"
    assert [topic["link_topic"] for topic in document["robot"]["topics"]] == ["/link/camera", "/scan", "/cmd_vel"]


def test_the_same_seed_gives_the_same_document(simulate):
    """Another seed gives another document."""
    first, again, other = (
        simulate("--rate", "0:3mbit", *QUICK, "--json", "--loss", "0.01", "--seed", seed, config="tiny.yaml")[1]
        for seed in "112"
    )
    assert first == again != other


def test_the_picture_is_a_png(simulate, files):
    """The table is printed, too."""
    pytest.importorskip("matplotlib")
    code, out, _ = simulate("--trace", "walk.csv", *QUICK, "--plot", "walk.png", config="tiny.yaml")
    assert code == 0
    assert out
    assert (files / "walk.png").read_bytes().startswith(b"\x89PNG")


def test_a_picture_that_cannot_be_written_is_an_error(simulate):
    """The table comes first, so the run was not wasted."""
    pytest.importorskip("matplotlib")
    code, out, err = simulate("--rate", "0:8mbit", *QUICK, "--plot", "nowhere/walk.png", config="tiny.yaml")
    assert code == 1
    assert out
    assert err == "arpd: --plot nowhere/walk.png cannot be written (No such file or directory); name another file\n"


# -- the robot and the link


def test_a_configuration_without_traffic_gets_the_demo_robot(simulate):
    """The output says that it is the demo robot."""
    _, out, _ = simulate("--rate", "0:20mbit", *QUICK, config="empty.yaml")
    assert "the demo robot, 12 topics" in out
    assert "no topic in empty.yaml has a payload and a source_rate_hz" in out
    assert "/camera/image/compressed" in out


def test_without_a_configuration_the_demo_robot_plays(simulate, refused, files, monkeypatch):
    """A default configuration that exists is read, and one that is named must exist."""
    monkeypatch.setattr(cli, "DEFAULT_CONFIG", files / "nosuch.yaml")
    code, out, _ = simulate("--rate", "0:20mbit", *QUICK, config=None)
    assert code == 0
    assert "the demo robot, 12 topics" in out
    code, said = refused("--rate", "0:20mbit", *QUICK, config="nosuch.yaml")
    assert (code, "nosuch.yaml:1:1: file: does not exist" in said) == (78, True)
    assert refused("--rate", "0:20mbit", "--actuation", "/imu", config=None)[0] == 2
    monkeypatch.setattr(cli, "DEFAULT_CONFIG", files / "tiny.yaml")
    document = json.loads(simulate("--rate", "0:20mbit", *QUICK, "--json", config=None)[1])
    assert (document["config"], document["robot"]["is_demo"]) == (str(files / "tiny.yaml"), False)


def test_a_topic_may_cross_the_other_way(simulate):
    """Commands towards the robot do not wait behind its camera."""
    _, out, _ = simulate("--rate", "0:1mbit", *QUICK, "--actuation", "/cmd_vel", "--json")
    document = json.loads(out)
    assert [topic["direction"] for topic in document["robot"]["topics"]] == ["sensing", "sensing", "actuation"]
    commands = document["ways"]["without"]["topics"][2]
    assert commands["lost"] == 0
    assert commands["latency_p99_s"] < 0.02


def test_the_links_other_properties_reach_the_link(simulate):
    """Every option takes quantities as the configuration does."""
    link = ("--loss", "0.05", "--delay", "30ms", "--queue", "64kB", "--packet-overhead", "150us", "--aggregate", "4")
    _, out, _ = simulate("--rate", "0:8mbit", *QUICK, "--json", *link, config="tiny.yaml")
    document = json.loads(out)
    assert document["link"] == {
        "delay_s": 0.03,
        "queue_bytes": 64_000,
        "loss": 0.05,
        "packet_overhead_s": 150e-6,
        "aggregate_packets": 4,
        "firmware_bytes": 0,
    }
    assert document["ways"]["arpd"]["topics"][0]["latency_p50_s"] > 0.03


def test_the_run_is_as_long_as_the_trace(simulate, files):
    """A short trace still gives a minute."""
    (files / "long.csv").write_text("time_s,rate_bit_per_s\n0,3000000\n70,3000000\n")
    for trace, duration_s in (("walk.csv", 60.0), ("long.csv", 70.0)):
        document = json.loads(simulate("--trace", trace, "--json", config="tiny.yaml")[1])
        assert document["duration_s"] == duration_s


def test_a_trace_of_deliveries_repeats(simulate, files):
    """A mahimahi trace of a second serves a run of twenty."""
    (files / "lte.up").write_text("".join(f"{ms}\n" for ms in range(3, 1001, 3)))
    document = json.loads(simulate("--trace", "lte.up", *QUICK, "--json", config="tiny.yaml")[1])
    truths = document["ways"]["arpd"]["course"]["truth_bytes_per_second"]
    assert sum(truths) / len(truths) == pytest.approx(333 * 1500, rel=0.01)


def test_a_link_that_never_returns_is_shown_as_such(simulate, files):
    """Its queue never ends, and JSON has null for that."""
    (files / "gone.csv").write_text("time_s,rate_bit_per_s\n0,3000000\n12,0\n")
    arguments = ("--trace", "gone.csv", *QUICK)
    document = json.loads(simulate(*arguments, "--json", config="tiny.yaml")[1], parse_constant=pytest.fail)
    assert document["ways"]["arpd"]["summary"]["queue_peak_s"] is None
    _, out, _ = simulate(*arguments, "--plot", "gone.png", config="tiny.yaml")
    assert re.search(r"^longest queue, ms +never +never +never$", out, re.MULTILINE)
    assert re.search(r"^ +12\.\d s +outage$", out, re.MULTILINE)


# -- what it refuses


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--rate", "20mbit"), "--rate: step '20mbit': write SECONDS:RATE, for example 20:5mbit"),
        (("--rate", "0:8mbit", "--duration", "5m"), "'m' is not a unit of a duration"),
        (("--rate", "0:8mbit", "--duration", "19s"), "is too short; the first 10 s are start-up, write 20s or more"),
        (("--rate", "0:8mbit", "--duration", "25h"), "--duration: 25h is out of range; write at most 24h"),
        (("--rate", "0:8mbit", "--loss", "5%"), "--loss '5%' is not a number from 0 to 1"),
        (("--rate", "0:8mbit", "--loss", "nan"), "--loss 'nan' is not a number from 0 to 1"),
        (("--rate", "0:8mbit", "--aggregate", "0"), "--aggregate '0' is not a number from 1 to 1024"),
        (("--rate", "0:8mbit", "--delay", "30"), "--delay: '30' has no unit"),
        (("--rate", "0:8mbit", "--queue", "2GB"), "--queue: 2GB is out of range; write at most 1GiB"),
        (("--rate", "0:8mbit", "--packet-overhead", "1s"), "--packet-overhead: 1s is out of range"),
        (("--rate", "0:8mbit", "--actuation", "/odom"), "--actuation /odom: robot.yaml does not say what it publishes"),
        (("--rate", "0:8mbit", "--plot", "walk.jpg"), "--plot walk.jpg is not a PNG; write a name that ends in .png"),
    ],
)
def test_a_wrong_argument_is_named_with_the_right_one(refused, arguments, said):
    """It exits 2 with one line, before any simulation."""
    code, line = refused(*arguments)
    assert code == 2
    assert line.startswith("arpd: --")
    assert said in line


def test_a_broken_trace_is_named_with_its_place(refused, files):
    """The error has file, line and column."""
    (files / "broken.csv").write_text("time_s,rate_bit_per_s\n0,8000000\n5,fast\n")
    code, line = refused("--trace", "broken.csv")
    assert code != 0
    assert "broken.csv:3:3: rate_bit_per_s 'fast' is not a number" in line


def test_a_missing_trace_is_an_error(refused):
    """The error is one line."""
    code, line = refused("--trace", "none.csv")
    assert code != 0
    assert "none.csv" in line


def test_a_broken_configuration_is_reported_as_by_check(refused, files):
    """It exits 78 with a line that begins with the place."""
    (files / "broken.yaml").write_text("link: {headrom: 0.9}\n")
    code, line = refused("--rate", "0:8mbit", config="broken.yaml")
    assert code == 78
    assert line.startswith("broken.yaml:1:8: link.headrom: is not a key arpd knows; did you mean headroom?")


@pytest.mark.parametrize("arguments", [(), ("--rate", "0:8mbit", "--trace", "walk.csv")])
def test_exactly_one_link_must_be_given(simulate, arguments):
    """The link is a trace or rates, not both."""
    code, _, err = simulate(*arguments)
    assert code == 2
    assert "--trace" in err


def test_every_example_of_the_help_can_be_parsed(run):
    """Every option in the examples exists."""
    _, out, _ = run("simulate", "--help")
    examples = re.findall(r"^  arpd (simulate .*?)(?:  .*| \|.*)?$", out, re.MULTILINE)
    assert len(examples) >= 6
    for example in examples:
        options = cli._parser().parse_args(example.split())
        assert options.config == Path(example.split()[2])
