"""The first configuration file: always accepted, whatever the names and types on the network are."""

from __future__ import annotations

import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from arpd.adapters.config.first_file import LinkChoice, first_file
from arpd.adapters.config.load import load_settings
from arpd.govern.what_if import OfflinePlanner
from arpd.model.errors import ConfigError
from arpd.model.link_topics import LinkTopic, TopicTraffic
from arpd.report.first_guess import first_guess
from arpd.solve.topics import assumed_traffic
from tests.unit.report.test_first_guess import TOPICS, camera, topic

LINK = LinkChoice(link_domain=77, robot="10.0.0.1", robot_is_guessed_from="wlan0")
QUICK = settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
WORDS = st.text(max_size=80)
# What breaks a line somewhere: in YAML, in Python, on a terminal.
BREAKS = "\n", "\r", "\x85", "\u2028", "\u2029", "\x0b", "\x0c", "\x1b[2J", "\x00", "\ud800"


@pytest.fixture
def loaded(tmp_path):
    """Write a first file for topics, and read it as the daemon does."""

    def loaded(topics, link=LINK, origin="a test"):
        path = tmp_path / "arpd.yaml"
        guess = first_guess(topics)
        path.write_bytes(first_file(guess, link, origin=origin).encode())
        return guess, load_settings(path, interfaces=None, local_domain=0)

    return loaded


@QUICK
@given(topics=TOPICS)
def test_every_guess_is_accepted_and_read_back(loaded, topics):
    """The daemon reads exactly the guessed preferences."""
    guess, read = loaded(topics)
    assert set(read.topics) == {each.name for each in guess.topics}
    for each in guess.topics:
        entry = read.topics[each.name]
        assert (entry.weight, entry.min_rate_hz, entry.max_rate_hz) == (each.weight, each.min_rate_hz, each.max_rate_hz)
        assert (entry.payload_bytes, entry.source_rate_hz) == (each.payload_bytes, each.source_rate_hz)
    assert [(group.name, group.topics) for group in read.relay.groups] == [
        (group.name, group.topics) for group in guess.groups
    ]
    assert (read.relay.link_domain, read.relay.robot, read.relay.ceddp) == (77, "10.0.0.1", None)


@QUICK
@given(words=st.tuples(WORDS, WORDS, WORDS, WORDS), breaking=st.sampled_from(BREAKS))
def test_words_from_outside_stay_in_their_comments(loaded, words, breaking):
    """Types, nodes, reasons, interfaces and host names with line breaks and escapes change no value."""
    kind, reason, interface, origin = (f"{text}{breaking}topics: [evil]{breaking}" for text in words)
    found = [
        LinkTopic(name="/a", types=(kind,), readers=(reason,), unmeasured=reason),
        LinkTopic(name="/b", types=(kind,), writers=(kind,), traffic=TopicTraffic(samples=0, rate_hz=0.0)),
    ]
    link = LinkChoice(link_domain=77, robot="robot", robot_is_guessed_from=interface)
    _, read = loaded(found, link, origin)
    assert set(read.topics) == {"/a", "/b"}
    assert (read.relay.robot, read.on_stop) == ("robot", "restore")


@pytest.mark.parametrize("name", ["/on", "/null", "/y", "/x1e3"])
def test_names_that_yaml_could_take_for_something_else_stay_names(loaded, name):
    """Every name is read back as text."""
    assert list(loaded([topic(name, "std_msgs/msg/String")])[1].topics) == [name]


def test_without_an_address_check_names_the_line_to_fill_in(loaded):
    """A robot whose address is unknown gets a file with one fault, and a comment at the line that mends it."""
    link = LinkChoice(link_domain=77)
    with pytest.raises(ConfigError) as error:
        loaded([], link)
    assert len(error.value.faults) == 1
    assert "relay.robot" in error.value.faults[0]
    above, line = next(
        pair
        for text in [first_file(first_guess([]), link, origin="")]
        for pair in zip(text.splitlines(), text.splitlines()[1:], strict=False)
        if pair[1].strip() == "robot: none"
    )
    assert above.strip().startswith("#")
    assert line.startswith("  ")


def test_a_robot_without_topics_gets_a_valid_file(loaded):
    """The file says that there are none."""
    assert loaded([])[1].topics == {}


def test_the_plan_for_a_robot_is_sensible(loaded):
    """At 4 Mbit/s commands and state have all they want, the picture gets the rest, and nothing degrades."""
    found = [
        *camera(**{"image_raw": 30.0, "image_raw/compressed": 30.0, "camera_info": 30.0}),
        topic("/cmd_vel", "geometry_msgs/msg/Twist", rate_hz=20.0, size=52),
        topic("/imu", "sensor_msgs/msg/Imu", rate_hz=100.0, size=324),
        topic("/scan", "sensor_msgs/msg/LaserScan", rate_hz=10.0, size=5828),
        topic("/odom", "nav_msgs/msg/Odometry", rate_hz=50.0, size=716),
        topic("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", rate_hz=1.0, size=300),
    ]
    _, read = loaded(found)
    planner = OfflinePlanner(read, assumed_traffic(read))
    plan = planner.plan(4e6 / 8)
    rows = {row.topic.name: row for row in plan.topics}
    assert all(rows[name].has_its_wish for name in ("/cmd_vel", "/imu", "/odom", "/scan", "/diagnostics"))
    assert 2 < rows["/cam/image_raw/compressed"].rate_hz < 30
    assert rows["/cam/image_raw"].rate_hz < 0.1
    assert not plan.allocation.degradation
    assert not planner.plan(2.5e6 / 8).allocation.degradation  # the floors and their headroom


def test_values_are_the_yaml_librarys(loaded):
    """Another reader of YAML sees the same file."""
    text = first_file(first_guess(camera(image_raw=30.0, camera_info=30.0)), LINK, origin="x")
    document = yaml.safe_load(text)
    assert document["relay"]["groups"][0]["topics"] == ["/cam/image_raw", "/cam/camera_info"]
    assert document["topics"][0]["max_depth"] == 5
