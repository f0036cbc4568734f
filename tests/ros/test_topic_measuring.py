"""`arpd topics` on a live graph: what it lists, measures, and does not bring over the link for it."""

import json

from std_msgs.msg import String, UInt8MultiArray

from arpd.model.names import is_internal
from tests.ros.ends_world import BEST_EFFORT, latched


def test_the_command_lists_and_suggests_what_check_accepts(ros, arpd, tmp_path):
    """A user's three commands: look at topics of all kinds, write a first file, check it."""

    def output(*arguments, **environment):
        process = arpd(*arguments, **environment)
        said, _ = process.communicate(timeout=120)
        assert process.returncode == 0, (tmp_path / "log").read_text()
        return said

    talker, driver = ros.node("talker"), ros.node("driver", namespace="/arm")
    fast = talker.create_publisher(String, "/fast", 10)
    talker.create_timer(0.02, lambda: fast.publish(String(data="x" * 99)))
    large = driver.create_publisher(UInt8MultiArray, "/large", BEST_EFFORT)
    driver.create_timer(0.1, lambda: large.publish(UInt8MultiArray(data=bytes(200_000))))
    talker.create_publisher(String, "/map", latched(3)).publish(String(data="x" * 999))
    talker.create_subscription(String, "/cmd", lambda _sample: None, 10)

    found = {topic["name"]: topic for topic in json.loads(output("topics", "--seconds", "2", "--json"))["topics"]}
    assert not [name for name in found if is_internal(name)]
    assert found["/fast"]["traffic"]["mean_bytes"] == 4 + 4 + 100
    assert found["/fast"]["traffic"]["rate_hz"] > 0
    assert found["/large"]["writers"] == ["/arm/driver"]
    assert 200_000 < found["/large"]["traffic"]["mean_bytes"] < 200_100
    of_map = found["/map"]["traffic"]
    assert (of_map["rate_hz"], of_map["mean_bytes"]) == (0.0, 4 + 4 + 1000)
    assert (found["/cmd"]["traffic"], found["/cmd"]["readers"]) == (None, ["/talker"])

    path = tmp_path / "arpd.yaml"
    path.write_text(output("topics", "--seconds", "1", "--suggest", "--robot", "10.9.8.7"))
    settings = json.loads(output("check", path, "--json", ROS_DOMAIN_ID="0"))["settings"]
    assert settings["relay.robot"] == "10.9.8.7"
    assert "topics[/fast].weight" in settings
