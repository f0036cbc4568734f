"""`arpd topics`: its table, its JSON, its suggested configuration, and what it refuses; the measurement is made up."""

from __future__ import annotations

import json
import sys
from contextlib import nullcontext
from types import ModuleType

import pytest
import yaml

from arpd.adapters.config.load import load_settings
from arpd.adapters.host import interface as host
from arpd.adapters.ros import runtime
from arpd.cli import main as cli
from arpd.cli.topics_table import link_table
from arpd.model.errors import RosUnavailableError
from arpd.model.link_topics import LinkTopic, TopicList, TopicTraffic

SMALL = "relay:\n  link_domain: 90\n  robot: robot.local\n  ceddp: 10.0.0.2\n"


def measured(name, kind, rate_hz, size, **other):
    traffic = TopicTraffic(samples=5, rate_hz=rate_hz, mean_bytes=size, largest_bytes=int(size))
    return LinkTopic(name=name, types=(kind,), traffic=traffic, **{"writers": ("/driver",), **other})


ROBOT = (
    measured("/camera/compressed", "sensor_msgs/msg/CompressedImage", 30.0, 61_000.0, far_readers=("/rviz", "/log")),
    LinkTopic(
        name="/cmd_vel", types=("geometry_msgs/msg/Twist",), readers=("/base",), unmeasured="nobody publishes it now"
    ),
    LinkTopic(
        name="/goal",
        types=("geometry_msgs/msg/PoseStamped",),
        readers=("/nav",),
        far_writers=("/rviz",),
        unmeasured="it comes from beyond this host",
    ),
    measured("/imu", "sensor_msgs/msg/Imu", 200.0, 324.0, relayed_as="/link/imu"),
    LinkTopic(
        name="/odd", types=("my_msgs/msg/Odd",), writers=("/x",), unmeasured="my_msgs/msg/Odd is not installed here"
    ),
)


@pytest.fixture
def robot(monkeypatch, tmp_path):
    """Let the measurement find these topics; returns what it was asked."""
    asked: dict[str, object] = {}

    def robot(topics=ROBOT, **other):
        def list_topics(_node, *, is_of_interest, seconds, prefix, on_progress):
            on_progress(0.0, "begun")
            asked.update(seconds=seconds, prefix=prefix, is_of_interest=is_of_interest)
            found = tuple(topic for topic in topics if is_of_interest(topic.name))
            return TopicList(topics=found, seconds=seconds, domain_id=7, **other)

        module = ModuleType("arpd.adapters.ros.topic_measuring")
        monkeypatch.setattr(module, "list_topics", list_topics, raising=False)
        monkeypatch.setitem(sys.modules, module.__name__, module)
        monkeypatch.setattr(runtime, "ros_node", lambda _name: nullcontext())
        monkeypatch.setattr(host, "likeliest_interface", lambda: "wlan0")
        monkeypatch.setattr(host, "ipv4_addresses", lambda: {"wlan0": frozenset({"10.0.0.7"})})
        monkeypatch.setattr(cli, "DEFAULT_CONFIG", tmp_path / "installed.yaml")
        monkeypatch.delenv("ROS_DOMAIN_ID", raising=False)
        monkeypatch.setenv("FASTDDS_BUILTIN_TRANSPORTS", "UDPv4")  # which the command may set for its process
        return asked

    return robot


@pytest.fixture
def suggested(run, tmp_path):
    """Suggest a configuration; returns the settings that it means, and stderr."""

    def suggested(*arguments):
        code, out, err = run("topics", "--suggest", *arguments)
        assert code == 0
        path = tmp_path / "suggested.yaml"
        path.write_text(out)
        return load_settings(path, interfaces=None, local_domain=0), err

    return suggested


def cells(out, name):
    """Return the words of one line of the table."""
    (line,) = [line for line in out.splitlines() if line.startswith(f"{name} ")]
    return line


def test_the_table_shows_each_topic_once_the_heaviest_first(run, robot):
    """Rate, size and traffic stand beside what crosses, and `-` for what was not measured."""
    robot()
    code, out, err = run("topics")
    assert (code, err) == (0, "")
    names = [line.split()[0] for line in out.splitlines()[1:6]]
    assert names == ["/camera/compressed", "/imu", "/cmd_vel", "/goal", "/odd"]
    camera = cells(out, "/camera/compressed").split()
    assert camera[1:7] == ["sensor_msgs/CompressedImage", "30", "61", "kB", "14.6", "out,"]
    assert camera[7:] == ["now", "0+2", "driver", "to", "rviz,", "log"]
    assert cells(out, "/imu").endswith("driver as /link/imu")
    assert cells(out, "/cmd_vel").split()[1:7] == ["geometry_msgs/Twist", "-", "-", "-", "in", "1+0"]
    assert cells(out, "/goal").endswith("rviz to nav")
    assert "in, now" in cells(out, "/goal")
    assert "is not installed here" in cells(out, "/odd")


@pytest.mark.parametrize("width", [60, 80, 100, 120, 200])
def test_the_table_fits_the_terminal(run, robot, monkeypatch, width):
    """No line is wider than asked, and rate, traffic and link stay."""
    robot()
    monkeypatch.setenv("COLUMNS", str(width))
    lines = run("topics")[1].split("\n\n")[0].splitlines()
    assert max(map(len, lines)) <= width
    assert all(title in lines[0] for title in ("TOPIC", "HZ", "MBIT/S", "LINK"))


def test_the_largest_size_is_shown_where_sizes_vary():
    """One picture twice as large as the mean is worth a column."""
    traffic = TopicTraffic(samples=9, rate_hz=10.0, mean_bytes=1000.0, largest_bytes=2000)
    heading, row = link_table([LinkTopic(name="/a", types=("x/msg/X",), writers=("/n",), traffic=traffic)]).rows
    assert row[heading.index("LARGEST")] == "2 kB"
    assert "LARGEST" not in link_table(ROBOT).rows[0]


def test_names_from_the_network_cannot_steer_the_terminal(run, robot):
    """Escape sequences and line breaks of nodes, types and reasons are shown, not sent."""
    evil = "\x1b[2J\n/fake"
    robot([LinkTopic(name="/a", types=(evil,), writers=(evil,), far_readers=(evil,), unmeasured=evil)])
    _, out, _ = run("topics")
    assert "\x1b" not in out
    assert not [line for line in out.splitlines() if line.startswith("/fake")]


def test_json_has_everything(run, robot):
    """Each topic has its endpoints and its traffic."""
    robot()
    document = json.loads(run("topics", "--json", "--seconds", "2")[1])
    assert (document["seconds"], document["domain_id"], len(document["topics"])) == (2, 7, 5)
    assert document["topics"][0]["traffic"]["rate_hz"] == 30
    assert document["topics"][1]["traffic"] is None
    assert [topic["is_crossing"] for topic in document["topics"]] == [True, False, True, False, False]


@pytest.mark.parametrize(("arguments", "shown"), [([], False), (["--all"], True)])
def test_topics_of_ros_and_hidden_ones_need_all(run, robot, arguments, shown):
    """/rosout, arpd's own topics and those of actions are of no interest by default."""
    is_of_interest = robot()
    run("topics", *arguments)
    names = ("/rosout", "/parameter_events", "/arpd/price", "/nav/_action/feedback")
    assert [is_of_interest["is_of_interest"](name) for name in names] == [shown] * 4
    assert is_of_interest["is_of_interest"]("/scan")


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


def test_a_suggestion_is_a_configuration_and_nothing_else(suggested, robot):
    """Stdout is the file; the guessed address is told on stderr, too."""
    robot()
    settings, err = suggested()
    assert set(settings.topics) == {topic.name for topic in ROBOT}
    assert (settings.relay.link_domain, settings.relay.robot, settings.relay.ceddp) == (77, "10.0.0.7", None)
    assert settings.topics["/cmd_vel"].weight > settings.topics["/imu"].weight
    assert settings.topics["/imu"].weight > settings.topics["/camera/compressed"].weight
    assert "wlan0" in err
    assert "not measured: /cmd_vel, /goal, /odd" in err


def test_given_addresses_go_into_the_suggestion(suggested, robot):
    """What the user says is not guessed."""
    robot()
    settings, err = suggested("--robot", "robot.local", "--ceddp", "10.1.1.1")
    assert (settings.relay.robot, settings.relay.ceddp) == ("robot.local", "10.1.1.1")
    assert "wlan0" not in err


def test_configured_addresses_stay(suggested, robot, config):
    """A configuration in force has the link's domain and addresses already."""
    robot()
    settings, _ = suggested("--config", config())
    assert (settings.relay.link_domain, settings.relay.robot, settings.relay.ceddp) == (90, "robot.local", "10.0.0.2")


def test_the_link_domain_is_not_that_of_the_nodes(run, robot, monkeypatch):
    """A robot whose nodes live in domain 77 gets another link domain."""
    robot()
    monkeypatch.setenv("ROS_DOMAIN_ID", "77")
    assert yaml.safe_load(run("topics", "--suggest")[1])["relay"]["link_domain"] == 78


def test_without_an_address_the_user_is_told_what_to_fill_in(run, robot, monkeypatch):
    """Where no interface stands out, the file has no address, and both it and stderr say so."""
    robot()
    monkeypatch.setattr(host, "likeliest_interface", lambda: None)
    code, out, err = run("topics", "--suggest")
    assert code == 0
    assert yaml.safe_load(out)["relay"]["robot"] == "none"
    assert "--robot" in err


@pytest.mark.parametrize(
    ("text", "prefix"),
    [("relay:\n  prefix: /air\n", "/air"), (SMALL, ""), ("", "/link"), (None, "/link")],
    ids=["one end", "two ends", "empty", "missing"],
)
def test_the_configuration_in_force_names_the_relayed_topics(run, robot, tmp_path, text, prefix):
    """The prefix is that of the installed file; an empty or missing one does not stop a first look."""
    asked = robot()
    if text is not None:
        (tmp_path / "installed.yaml").write_text(text)
    code, _, err = run("topics")
    assert (code, asked["prefix"]) == (0, prefix)
    assert ("has faults" in err) is (text == "")


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (["--seconds", "0"], "--seconds"),
        (["--seconds", "nan"], "--seconds"),
        (["--seconds", "1e9"], "--seconds"),
        (["--robot", "10.0.0.1"], "--suggest"),
        (["--suggest", "--robot", "not an address"], "--robot"),
        (["--suggest", "--ceddp", "10.0.0"], "--ceddp"),
        (["--suggest", "--json"], "not allowed with"),
    ],
)
def test_wrong_usage_exits_2(run, robot, arguments, word):
    """The fault is named before anything is measured."""
    asked = robot()
    code, out, err = run("topics", *arguments)
    assert (code, out, asked) == (2, "", {})
    assert word in err


def test_a_wrong_configuration_that_was_named_exits_78(run, robot, config):
    """A file that the user names must be right."""
    robot()
    code, out, err = run("topics", "--config", config("link: 1\n"))
    assert (code, out) == (78, "")
    assert "link" in err


def test_without_ros_the_command_exits_69(run, robot, monkeypatch):
    """The reason is one line."""
    robot()

    def no_ros(_name):
        raise RosUnavailableError("ROS 2 cannot be imported")

    monkeypatch.setattr(runtime, "ros_node", no_ros)
    assert run("topics") == (69, "", "arpd: ROS 2 cannot be imported\n")


def test_where_hosts_are_unknown_the_user_is_told(run, robot):
    """The reason stands once, below the table."""
    robot(cannot_tell_hosts="the middleware does not show hosts")
    assert "arpd: the middleware does not show hosts" in run("topics")[2]
