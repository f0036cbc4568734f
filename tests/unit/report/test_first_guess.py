"""First preferences by type: what comes first, floors that suit the link, and pictures with their camera_info."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from arpd.model.link_topics import LinkTopic, TopicTraffic
from arpd.report.first_guess import first_guess
from arpd.report.topic_roles import Role
from tests.examples import examples

TYPES = [
    "geometry_msgs/msg/Twist",
    "geometry_msgs/msg/PoseStamped",
    "tf2_msgs/msg/TFMessage",
    "sensor_msgs/msg/Imu",
    "sensor_msgs/msg/Image",
    "sensor_msgs/msg/CompressedImage",
    "sensor_msgs/msg/CameraInfo",
    "sensor_msgs/msg/PointCloud2",
    "foxglove_msgs/msg/CompressedVideo",
    "rosgraph_msgs/msg/Clock",
    "sensor_msgs/msg/LaserScan",
    "nav_msgs/msg/OccupancyGrid",
    "diagnostic_msgs/msg/DiagnosticArray",
    "std_msgs/msg/String",
    "my_robot_msgs/msg/Wheel",
]


TRAFFIC = st.one_of(
    st.none(),
    st.builds(
        lambda rate_hz, size: TopicTraffic(samples=3, rate_hz=rate_hz, mean_bytes=size, largest_bytes=int(size)),
        st.one_of(st.just(0.0), st.floats(0.01, 2000.0)),
        st.floats(4.0, 2e7),
    ),
    st.just(TopicTraffic(samples=0, rate_hz=0.0)),
)
NODES = st.sampled_from([(), ("/a",), ("/a", "/b")])
TOPIC = st.builds(
    lambda name, kind, **other: LinkTopic(name=name, types=(kind,), unmeasured="for a reason", **other),
    st.from_regex(r"\A(/camera|/left)?/[a-z]{1,4}(/camera_info|/compressed)?\Z"),
    st.sampled_from(TYPES),
    writers=NODES,
    readers=NODES,
    far_writers=NODES,
    far_readers=NODES,
    is_latched=st.booleans(),
    traffic=TRAFFIC,
)
TOPICS = st.lists(TOPIC, max_size=25, unique_by=lambda each: each.name)


def test_commands_come_first_and_diagnostics_last():
    """Weights fall from commands to diagnostics."""
    weights = [role.care.weight for role in Role]
    assert weights == sorted(weights, reverse=True)
    assert next(iter(Role)) is Role.COMMAND
    assert [*Role][-1] is Role.DIAGNOSTIC


def guess_of(kind, rate_hz, size, **other):
    """Return the guess for one topic of the robot."""
    traffic = TopicTraffic(samples=50, rate_hz=rate_hz, mean_bytes=size, largest_bytes=int(size))
    (guess,) = first_guess([LinkTopic(name="/a", types=(kind,), writers=("/node",), traffic=traffic, **other)]).topics
    return guess


@examples(30)
@given(st.floats(0.05, 20.0), st.floats(0.05, 20.0))
def test_a_map_is_latched_at_any_rate(one_hz, other_hz):
    """A timer that drifts from 1.00 to 1.01 Hz changes nothing."""
    one, other = (guess_of("nav_msgs/msg/OccupancyGrid", rate, 4e5, is_latched=True) for rate in (one_hz, other_hz))
    assert one.role is other.role is Role.LATCHED
    assert (one.weight, one.min_rate_hz, one.max_rate_hz) == (other.weight, other.min_rate_hz, other.max_rate_hz)


def test_the_clock_of_a_simulation_keeps_its_pace():
    """Nodes with use_sim_time stand still between two of its messages."""
    assert guess_of("rosgraph_msgs/msg/Clock", 940.0, 8.0).min_rate_hz >= 50


@pytest.mark.parametrize(
    "kind",
    [
        "ffmpeg_image_transport_msgs/msg/FFMPEGPacket",
        "foxglove_msgs/msg/CompressedVideo",
        "theora_image_transport/msg/Packet",
    ],
)
def test_a_video_is_not_thinned_like_pictures(kind):
    """Its frames need those before them: the floor is the whole rate, with a warning."""
    guess = guess_of(kind, 30.0, 20_000.0)
    assert (guess.min_rate_hz, guess.max_rate_hz) == (30.0, None)
    assert "WARNING" in guess.role.reason
    assert guess_of("sensor_msgs/msg/CompressedImage", 30.0, 20_000.0).min_rate_hz < 5


@examples(100)
@given(TOPICS)
def test_every_floor_suits_its_role_and_is_below_its_ceiling(topics):
    """A floor takes no more of the link than suits its role, and each topic or group has one guess."""
    guess = first_guess(topics)
    for each in guess.topics:
        assert 0 <= each.min_rate_hz <= (each.max_rate_hz or 1e5)
        if each.name not in {group.name for group in guess.groups}:  # which carry their camera_info, too
            assert each.floor_bytes_per_second <= each.role.care.most_bytes_per_second * 1.02
        if each.source_rate_hz and each.role is not Role.LATCHED:  # a few latched samples may come at once
            assert each.min_rate_hz <= each.source_rate_hz
    named = {each.name for each in guess.topics}
    members = [member for group in guess.groups for member in group.topics]
    assert len(members) == len(set(members))
    assert named | set(members) == {each.name for each in topics}
    assert {group.name for group in guess.groups} <= named
    assert not {member for group in guess.groups for member in group.topics[1:]} & named
