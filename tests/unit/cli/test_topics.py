"""`arpd topics`: its table, its suggested configuration, and what it refuses; the measurement is made up."""

from __future__ import annotations

import sys
from contextlib import nullcontext
from unittest.mock import Mock

import pytest
import yaml

from arpd.cli import options
from arpd.host import interface as host
from arpd.host import kernel
from arpd.model.link_topics import LinkTopic, TopicList, TopicTraffic
from arpd.ros import runtime

TRAFFIC = TopicTraffic(samples=5, rate_hz=200.0, mean_bytes=324.0, largest_bytes=324)
IMU = LinkTopic(name="/imu", types=("sensor_msgs/msg/Imu",), writers=("/driver",), traffic=TRAFFIC)


@pytest.fixture
def robot(monkeypatch, tmp_path):
    """Let the measurement find these topics; returns what makes it."""

    def robot(topics=(IMU,)):
        survey = Mock()
        survey.return_value.run = lambda seconds: TopicList(topics=tuple(topics), seconds=seconds, domain_id=7)
        monkeypatch.setitem(sys.modules, "arpd.ros.topic_measuring", Mock(TopicSurvey=survey))
        monkeypatch.setattr(runtime, "ros_node", lambda _name: nullcontext())
        monkeypatch.setattr(kernel, "likeliest_interface", lambda: "wlan0")
        monkeypatch.setattr(host, "ipv4_addresses", lambda: {"wlan0": frozenset({"10.0.0.7"})})
        monkeypatch.setattr(options, "DEFAULT_CONFIG", tmp_path / "installed.yaml")
        monkeypatch.delenv("ROS_DOMAIN_ID", raising=False)
        monkeypatch.setenv("FASTDDS_BUILTIN_TRANSPORTS", "UDPv4")  # which the command may set for its process
        return survey

    return robot


def test_names_from_the_network_cannot_steer_the_terminal(run, robot):
    """Escape sequences and line breaks of nodes, types and reasons are shown, not sent."""
    evil = "\x1b[2J\n/fake"
    robot([LinkTopic(name="/a", types=(evil,), writers=(evil,), far_readers=(evil,), unmeasured=evil)])
    _, out, _ = run("topics")
    assert "\x1b" not in out
    assert not [line for line in out.splitlines() if line.startswith("/fake")]


def test_no_topics_exit_1_and_say_what_to_check(run, robot, monkeypatch):
    """The variables that hide nodes are named with their values."""
    robot([])
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "OFF")
    for arguments in ([], ["--json"], ["--suggest"]):
        code, out, err = run("topics", *arguments)
        assert (code, out) == (1, "")
        assert "domain 7" in err
        assert "here: OFF" in err
        assert "ROS_LOCALHOST_ONLY" in err


@pytest.mark.parametrize(("options", "is_listed"), [([], False), (["--all"], True)])
def test_topics_of_ros_and_of_arpd_and_hidden_ones_are_listed_on_request(run, robot, options, is_listed):
    """They are seldom what a user looks for."""
    survey = robot()
    run("topics", *options)
    is_of_interest = survey.call_args.kwargs["is_of_interest"]
    names = ("/imu", "/rosout", "/arpd/price", "/navigate/_action/status")
    assert [is_of_interest(name) for name in names] == [True, *3 * [is_listed]]


def test_the_link_domain_is_not_that_of_the_nodes(run, robot, monkeypatch):
    """A robot whose nodes live in domain 77 gets another link domain."""
    robot()
    monkeypatch.setenv("ROS_DOMAIN_ID", "77")
    assert yaml.safe_load(run("topics", "--suggest")[1])["relay"]["link_domain"] == 78


@pytest.mark.parametrize(
    ("text", "prefix"),
    [
        ("relay: {prefix: /air}\n", "/air"),
        ("relay: {link_domain: 90, robot: robot.local, base: 10.0.0.2}\n", ""),
        (None, "/link"),
    ],
)
def test_the_configuration_in_force_names_the_relayed_topics(run, robot, tmp_path, text, prefix):
    """The prefix is that of the installed file; a missing one does not stop a first look."""
    survey = robot()
    if text is not None:
        (tmp_path / "installed.yaml").write_text(text)
    assert (run("topics")[0], survey.call_args.kwargs["prefix"]) == (0, prefix)


def test_a_name_of_the_configuration_that_no_topic_has_is_named(run, robot, tmp_path):
    """A name that is misspelt would else be told nowhere."""
    robot()
    (tmp_path / "installed.yaml").write_text("topics: [{name: /imu}, {name: '/**/imu'}, {name: /cmd_vell}]\n")
    assert "The configuration names /cmd_vell; no topic" in run("topics")[1]
