"""First preferences by type: what comes first, floors that fit together, and pictures with their camera_info."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from arpd.model.link_topics import LinkTopic, TopicTraffic
from arpd.report.first_guess import FLOORS_BYTES_PER_SECOND, first_guess
from arpd.report.topic_roles import Role, role_of

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


def topic(name, kind, *, rate_hz=None, size=None, **other):
    """Return a topic of this robot, measured where it has a rate."""
    traffic = None
    if rate_hz is not None:
        traffic = TopicTraffic(
            samples=5 if size else 0, rate_hz=rate_hz, mean_bytes=size, largest_bytes=int(size) if size else None
        )
    return LinkTopic(name=name, types=(kind,), **{"writers": ("/node",), "traffic": traffic, **other})


def guess_of(*topics):
    return {each.name: each for each in first_guess(topics).topics}


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


@pytest.mark.parametrize(
    ("kind", "role"),
    [
        ("geometry_msgs/msg/TwistStamped", Role.COMMAND),
        ("ackermann_msgs/msg/AckermannDriveStamped", Role.COMMAND),
        ("trajectory_msgs/msg/JointTrajectory", Role.COMMAND),
        ("geometry_msgs/msg/TwistWithCovarianceStamped", Role.STATE),
        ("geometry_msgs/msg/PoseStamped", Role.STATE),
        ("tf2_msgs/msg/TFMessage", Role.TRANSFORM),
        ("sensor_msgs/msg/JointState", Role.STATE),
        ("sensor_msgs/msg/CompressedImage", Role.PICTURE),
        ("sensor_msgs/msg/PointCloud2", Role.PICTURE),
        ("theora_image_transport/msg/Packet", Role.PICTURE),
        ("nav_msgs/msg/Path", Role.PERCEPTION),
        ("visualization_msgs/msg/MarkerArray", Role.PERCEPTION),
        ("sensor_msgs/msg/BatteryState", Role.STATUS),
        ("sensor_msgs/msg/Range", Role.PERCEPTION),
        ("diagnostic_msgs/msg/DiagnosticArray", Role.DIAGNOSTIC),
        ("my_robot_msgs/msg/Wheel", Role.OTHER),
        ("sensor_msgs/msg/ImuExtra", Role.STATUS),
    ],
)
def test_the_type_tells_the_role(kind, role):
    """Most roles follow from the type alone."""
    assert role_of(topic("/x", kind, rate_hz=10.0, size=100)) is role


@pytest.mark.parametrize(
    ("found", "role"),
    [
        (topic("/tf_static", "tf2_msgs/msg/TFMessage", rate_hz=0.0, size=900, is_latched=True), Role.LATCHED),
        (topic("/map", "nav_msgs/msg/OccupancyGrid", rate_hz=0.0, size=1e6, is_latched=True), Role.LATCHED),
        (topic("/imu", "sensor_msgs/msg/Imu", rate_hz=100.0, size=300, is_latched=True), Role.STATE),
        (topic("/goal", "geometry_msgs/msg/PoseStamped", writers=(), readers=("/nav",)), Role.COMMAND),
        (topic("/plan", "nav_msgs/msg/Path", writers=(), readers=("/nav",)), Role.PERCEPTION),
        (topic("/estop", "std_msgs/msg/Bool", rate_hz=0.0), Role.COMMAND),
        (topic("/stopwatch", "std_msgs/msg/Bool", rate_hz=0.0), Role.OTHER),
        (topic("/blob", "my_msgs/msg/Blob", rate_hz=10.0, size=50_000), Role.PICTURE),
        (topic("/raw", "sensor_msgs/msg/Image", rate_hz=30.0, size=900_000), Role.FLOOD),
    ],
    ids=lambda value: value.name,
)
def test_durability_direction_name_and_traffic_tell_more(found, role):
    """Latched topics, commands by direction or name, and large topics of an unknown type are known, too."""
    assert role_of(found) is role


def test_commands_come_first_and_diagnostics_nearly_last():
    """Weights fall from commands to what floods the link."""
    weights = [role.care.weight for role in Role]
    assert weights == sorted(weights, reverse=True)
    assert next(iter(Role)) is Role.COMMAND
    assert [*Role][-2:] == [Role.DIAGNOSTIC, Role.FLOOD]


def test_a_floor_follows_the_measured_rate():
    """A quarter of an IMU's rate up to 30 Hz, and no floor above what is published."""
    found = guess_of(
        topic("/fast", "sensor_msgs/msg/Imu", rate_hz=200.0, size=300),
        topic("/slow", "sensor_msgs/msg/Imu", rate_hz=3.0, size=300),
        topic("/cmd_vel", "geometry_msgs/msg/Twist", writers=(), readers=("/base",), unmeasured="nobody publishes it"),
    )
    assert (found["/fast"].min_rate_hz, found["/fast"].max_rate_hz) == (30, 220)
    assert found["/slow"].min_rate_hz == 3
    assert (found["/cmd_vel"].min_rate_hz, found["/cmd_vel"].max_rate_hz, found["/cmd_vel"].weight) == (20, None, 10)
    assert any("nobody publishes it" in remark for remark in found["/cmd_vel"].remarks)


def test_topics_of_ros_and_of_arpd_and_hidden_ones_get_no_guess():
    """Neither /rosout nor /arpd/price nor an action's feedback is configured."""
    names = ("/rosout", "/arpd/price", "/nav/_action/feedback", "/odom")
    assert list(guess_of(*(topic(name, "nav_msgs/msg/Odometry") for name in names))) == ["/odom"]


def test_a_name_that_is_too_long_is_left_out_and_told():
    """A name that no configuration takes spoils nothing."""
    guess = first_guess([topic("/" + "x" * 247, "std_msgs/msg/String"), topic("/y", "std_msgs/msg/String")])
    assert [each.name for each in guess.topics] == ["/y"]
    assert guess.left_out == ("/" + "x" * 247,)


def camera(**rates):
    """Return a camera's topics in /cam: raw, compressed and camera_info, with these rates."""
    kinds = {"image_raw": ("Image", 900_000), "image_raw/compressed": ("CompressedImage", 30_000)}
    kinds["camera_info"] = ("CameraInfo", 400)
    return [
        topic(f"/cam/{name}", f"sensor_msgs/msg/{kinds[name][0]}", rate_hz=rate_hz, size=kinds[name][1])
        for name, rate_hz in rates.items()
    ]


def test_a_picture_crosses_with_its_camera_info():
    """Of raw and compressed pictures at the rate of camera_info, the compressed one is grouped with it."""
    guess = first_guess(camera(**{"image_raw": 30.0, "image_raw/compressed": 29.0, "camera_info": 30.0}))
    assert [group.topics for group in guess.groups] == [("/cam/image_raw/compressed", "/cam/camera_info")]
    assert {each.name for each in guess.topics} == {"/cam/image_raw", "/cam/image_raw/compressed"}
    (grouped,) = [each for each in guess.topics if each.name == "/cam/image_raw/compressed"]
    assert grouped.payload_bytes is not None
    assert 30_400 <= grouped.payload_bytes < 31_000


@pytest.mark.parametrize(
    "found",
    [
        camera(**{"image_raw/compressed": 10.0, "camera_info": 30.0}),
        camera(**{"image_raw/compressed": 0.0, "camera_info": 0.0}),
        camera(camera_info=30.0),
        [
            *camera(camera_info=30.0),
            topic("/other/image", "sensor_msgs/msg/Image", rate_hz=30.0, size=9000),
        ],
    ],
    ids=["other rate", "silent", "alone", "other namespace"],
)
def test_no_group_without_the_same_stamps(found):
    """Where rates differ or are unknown, a group could drop samples that belong to nothing."""
    assert first_guess(found).groups == ()


def test_floors_of_large_topics_give_way_first():
    """Many cameras lower the floors of pictures, and neither those of an IMU nor of commands."""
    imu = topic("/imu", "sensor_msgs/msg/Imu", rate_hz=100.0, size=300)
    command = topic("/cmd_vel", "geometry_msgs/msg/Twist", rate_hz=50.0, size=52)
    cameras = [
        topic(f"/c{n}/compressed", "sensor_msgs/msg/CompressedImage", rate_hz=30.0, size=40_000.0) for n in range(8)
    ]
    guess = first_guess([imu, command, *cameras])
    found = {each.name: each for each in guess.topics}
    assert guess.is_lowered
    assert (found["/imu"].min_rate_hz, found["/cmd_vel"].min_rate_hz) == (25, 20)
    assert 0 < found["/c0/compressed"].min_rate_hz < 2
    assert 0.7 * FLOORS_BYTES_PER_SECOND < guess.floors_bytes_per_second <= FLOORS_BYTES_PER_SECOND


def test_one_huge_topic_does_not_take_the_floor_of_small_ones():
    """Within a role the topic that needs most is lowered first."""
    found = guess_of(
        topic("/small/compressed", "sensor_msgs/msg/CompressedImage", rate_hz=10.0, size=5_000.0),
        topic("/huge", "sensor_msgs/msg/PointCloud2", rate_hz=1.0, size=2_000_000.0),
    )
    assert found["/small/compressed"].min_rate_hz == 1
    assert found["/huge"].min_rate_hz < 0.5


@settings(max_examples=300, deadline=None)
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


@settings(max_examples=50, deadline=None)
@given(TOPICS, st.randoms())
def test_the_order_of_the_topics_does_not_matter(topics, dice):
    """The same robot gets the same guess."""
    shuffled = [*topics]
    dice.shuffle(shuffled)
    assert first_guess(sorted(shuffled, key=lambda each: each.name)) == first_guess(
        sorted(topics, key=lambda each: each.name)
    )
