"""First preferences by type: what comes first, floors that fit together, and pictures with their camera_info."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from arpd.model.link_topics import LinkTopic, TopicTraffic
from arpd.report.first_guess import FLOORS_BYTES_PER_SECOND, first_guess
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


def test_commands_come_first_and_diagnostics_nearly_last():
    """Weights fall from commands to what floods the link."""
    weights = [role.care.weight for role in Role]
    assert weights == sorted(weights, reverse=True)
    assert next(iter(Role)) is Role.COMMAND
    assert [*Role][-2:] == [Role.DIAGNOSTIC, Role.FLOOD]


@examples(100)
@given(TOPICS)
def test_floors_fit_together_and_below_every_ceiling(topics):
    """Floors fit into the budget, unless those of commands and transforms alone exceed it."""
    guess = first_guess(topics)
    kept = sum(each.floor_bytes_per_second for each in guess.topics if each.role in {Role.COMMAND, Role.TRANSFORM})
    assert guess.floors_bytes_per_second <= max(FLOORS_BYTES_PER_SECOND, kept) * (1 + 1e-9)
    for each in guess.topics:
        assert 0 <= each.min_rate_hz <= (each.max_rate_hz or 1e5)
        if each.source_rate_hz and each.role is not Role.LATCHED:  # a few latched samples may come at once
            assert each.min_rate_hz <= each.source_rate_hz
    named = {each.name for each in guess.topics}
    members = [member for group in guess.groups for member in group.topics]
    assert len(members) == len(set(members))
    assert named | set(members) == {each.name for each in topics}
    assert {group.name for group in guess.groups} <= named
    assert not {member for group in guess.groups for member in group.topics[1:]} & named
