"""Messages that `tests.messages.generate` makes are ROS messages like any other."""

import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from geometry_msgs.msg import TransformStamped

from scripts.bench.record import REPO
from tests.messages import generate

pytestmark = pytest.mark.ros

#: As `ros2 topic info --verbose /tf` shows it on a robot with Jazzy.
HASH = "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087"
IMPORT = "from tf2_msgs.msg import TFMessage; import tf2_msgs; print(TFMessage().transforms, tf2_msgs.__file__)"
BUILD = (
    "from tests.messages import generate; generate.CACHE = generate.Path({folder!r}); print(generate.build('tf2_msgs'))"
)


def transform(number):
    stamped = TransformStamped(child_frame_id=f"wheel {number}")
    stamped.header.frame_id = "base"
    stamped.header.stamp.nanosec = number
    stamped.transform.translation.x = 0.1 * number
    return stamped


def python(code, environment):
    return subprocess.run(
        [sys.executable, "-c", code], cwd=REPO, env=environment, capture_output=True, text=True, check=False
    )


@pytest.fixture
def fresh(tmp_path, monkeypatch):
    """Give `build` a cache that holds no package yet."""
    monkeypatch.setattr(generate, "CACHE", tmp_path)
    generate.build.cache_clear()
    yield tmp_path
    generate.build.cache_clear()


@pytest.mark.parametrize("count", [0, 1, 3])
def test_a_published_message_arrives_equal(ros, tf_message, eventually, count):
    """Transforms cross from one participant to another, with every field."""
    received = []
    ros.node("far").create_subscription(tf_message, "/tf", received.append, 10)
    publisher = ros.node("near").create_publisher(tf_message, "/tf", 10)
    sent = tf_message(transforms=[transform(number) for number in range(count)])
    eventually(lambda: publisher.get_subscription_count() == 1)
    publisher.publish(sent)
    eventually(lambda: received)
    assert received == [sent]
    assert len(received[0].transforms) == count


def test_the_type_is_that_of_every_robot(ros, tf_message, eventually):
    """DDS announces the hash that the tf2_msgs of ROS announces, so that both match."""
    node = ros.node("near")
    node.create_publisher(tf_message, "/tf", 10)
    eventually(lambda: node.get_publishers_info_by_topic("/tf"))
    (info,) = node.get_publishers_info_by_topic("/tf")
    assert (info.topic_type, str(info.topic_type_hash)) == ("tf2_msgs/msg/TFMessage", HASH)


def test_another_process_imports_it(tf_message):
    """The environment is all that it needs."""
    done = python(IMPORT, generate.environment("tf2_msgs"))
    assert (done.returncode, done.stdout.split()[0]) == (0, "[]"), done.stderr


def test_processes_that_build_at_once_share_one_folder(tf_message, fresh):
    """Three processes begin with an empty cache; all return the same folder, and nothing else is left."""
    command = BUILD.format(folder=str(fresh))
    with ThreadPoolExecutor(3) as pool:
        finished = list(pool.map(lambda _: python(command, dict(os.environ)), range(3)))
    assert not any(done.returncode for done in finished), finished
    (folder,) = {done.stdout.strip() for done in finished}
    assert [str(path) for path in fresh.iterdir()] == [folder]
    assert (
        python(IMPORT, {**os.environ, "PYTHONPATH": folder}).stdout.strip().endswith(f"{folder}/tf2_msgs/__init__.py")
    )


def test_without_a_compiler_the_error_names_the_package_to_install(fresh, monkeypatch):
    """Nothing is built, and nothing is left in the cache."""
    monkeypatch.setenv("PATH", str(fresh))
    with pytest.raises(generate.MessagesError, match=r"tf2_msgs: gcc and g\+\+ not found; .* apt install g\+\+"):
        generate.build("tf2_msgs")
    assert not list(fresh.iterdir())
