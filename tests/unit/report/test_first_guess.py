"""First preferences by type: what comes first, floors that suit the link, and pictures with their camera_info."""

from hypothesis import given
from hypothesis import strategies as st

from arpd.model.link_topics import LinkTopic, TopicTraffic
from arpd.report.first_guess import LATCHED, first_guess, wire_bytes_per_second
from tests.examples import examples

TYPES = [
    "geometry_msgs/msg/Twist",
    "tf2_msgs/msg/TFMessage",
    "sensor_msgs/msg/Imu",
    "sensor_msgs/msg/Image",
    "sensor_msgs/msg/CompressedImage",
    "sensor_msgs/msg/CameraInfo",
    "sensor_msgs/msg/PointCloud2",
    "foxglove_msgs/msg/CompressedVideo",
    "nav_msgs/msg/OccupancyGrid",
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


def topic_of(kind, rate_hz, size, *, name="/a", **other):
    """Return one topic of the robot."""
    traffic = TopicTraffic(samples=50, rate_hz=rate_hz, mean_bytes=size, largest_bytes=int(size))
    return LinkTopic(name=name, types=(kind,), writers=("/node",), traffic=traffic, **other)


def guess_of(*topic, **other):
    (guess,) = first_guess([topic_of(*topic, **other)]).topics
    return guess


def test_a_picture_that_is_compressed_is_not_to_be_read_compressed():
    """What is more than Wi-Fi may carry has a way out that it does not have already."""
    for kind, way_out in (("Image", "read it compressed"), ("CompressedImage", "max_rate_hz")):
        assert way_out in " ".join(guess_of(f"sensor_msgs/msg/{kind}", 30.0, 2.7e5).remarks)


@examples(30)
@given(st.floats(0.05, 20.0), st.floats(0.05, 20.0))
def test_a_map_is_latched_at_any_rate(one_hz, other_hz):
    """A timer that drifts from 1.00 to 1.01 Hz changes nothing."""
    one, other = (guess_of("nav_msgs/msg/OccupancyGrid", rate, 4e5, is_latched=True) for rate in (one_hz, other_hz))
    assert one.role is other.role is LATCHED
    assert one.settings.min_rate_hz == other.settings.min_rate_hz


def test_a_video_is_not_thinned_like_pictures():
    """Its frames need those before them: the floor is the whole rate, with a warning."""
    for kind in ("ffmpeg_image_transport_msgs/msg/FFMPEGPacket", "theora_image_transport/msg/Packet"):
        guess = guess_of(kind, 30.0, 20_000.0)
        assert guess.settings.min_rate_hz == 30.0
        assert "WARNING" in guess.role.reason
    assert guess_of("sensor_msgs/msg/CompressedImage", 30.0, 20_000.0).settings.min_rate_hz < 5
    assert guess_of("rosgraph_msgs/msg/Clock", 940.0, 8.0).settings.min_rate_hz >= 50, "nodes stand still between two"


def test_a_picture_crosses_together_with_its_camera_info():
    """Neither is of use without the other; of several pictures it is the one that suits Wi-Fi best."""
    raw = topic_of("sensor_msgs/msg/Image", 30.0, 9e5, name="/camera/image")
    small = topic_of("sensor_msgs/msg/CompressedImage", 30.0, 40_000.0, name="/camera/image/compressed")
    info = topic_of("sensor_msgs/msg/CameraInfo", 29.9, 400.0, name="/camera/camera_info")
    guess = first_guess([info, raw, small])
    assert [group.topics for group in guess.groups] == [(small.name, info.name)]
    sizes = {each.settings.name: each.settings.payload_bytes for each in guess.topics}
    assert sizes == {raw.name: 9e5, small.name: 40_400.0}


@examples(100)
@given(TOPICS)
def test_every_floor_suits_its_role(topics):
    """A floor takes no more of the link than suits its role, and each topic or group has one guess."""
    guess = first_guess(topics)
    grouped = {group.name for group in guess.groups}
    for each in guess.topics:
        topic, role = each.settings, each.role
        if topic.name not in grouped:  # which carry their camera_info, too
            floor = wire_bytes_per_second(topic.payload_bytes, topic.min_rate_hz)
            assert floor <= role.most_kbit * 125 * 1.02
        if topic.source_rate_hz and role is not LATCHED:  # a few latched samples may come at once
            assert topic.min_rate_hz <= topic.source_rate_hz
    named = {each.settings.name for each in guess.topics}
    members = [member for group in guess.groups for member in group.topics]
    assert len(members) == len(set(members))
    assert named | set(members) == {each.name for each in topics}
    assert grouped <= named
    assert not {member for group in guess.groups for member in group.topics[1:]} & named
