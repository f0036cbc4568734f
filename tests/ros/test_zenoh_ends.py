"""The ends over Zenoh of the benchmark: real processes, a domain on each side, on this host."""

import json
import os
import subprocess
import sys
import time
from dataclasses import asdict

import pytest
from std_msgs.msg import String

from scripts.bench.samples import BASE, Topic
from tests.ros.ends_world import BASE as BASE_DOMAIN
from tests.ros.ends_world import RELIABLE, ROBOT, latched, listen
from tests.ros.world import REPO, Ros
from tests.waiting import eventually

TOPICS = (
    Topic(name="/small", size=100, rate_hz=1.0, node="sensors"),
    Topic(name="/large", size=300_000, rate_hz=1.0, node="sensors"),
    Topic(name="/map", size=100, rate_hz=1.0, node="sensors", is_latched=True),
    Topic(name="/command", size=100, rate_hz=1.0, node=BASE),
)


@pytest.fixture
def ends(environment, stack, tmp_path):
    """Both ends of the side in README.md; each ends with its standard input."""
    world = tmp_path / "world.json"
    world.write_text(json.dumps({"topics": list(map(asdict, TOPICS))}))
    for host, domain in (("robot", ROBOT), ("base", BASE_DOMAIN)):
        stack.enter_context(
            subprocess.Popen(
                [sys.executable, "-m", "scripts.bench.zenoh_ends", world, host, "127.0.0.1", "zenoh_first"],
                env={**os.environ, "ROS_DOMAIN_ID": str(domain)},
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                cwd=REPO,
            )
        )


def test_samples_cross_and_commands_come_back(ends, stack):
    """Small, large and latched samples reach the base as they were, and a command reaches the robot."""
    robot, base = Ros(stack, ROBOT).node("robot"), Ros(stack, BASE_DOMAIN).node("base")
    texts = {"/small": "one", "/large": "x" * 300_000, "/map": "a map", "/command": "go"}
    writers, heard = {}, {}
    for topic in TOPICS:
        qos = latched(1) if topic.is_latched else RELIABLE
        writer, reader = (base, robot) if topic.node == BASE else (robot, base)
        writers[topic.name] = writer.create_publisher(String, topic.name, qos)
        heard[topic.name] = listen(reader, topic.name, qos)
    writers["/map"].publish(String(data=texts["/map"]))  # once, when nobody reads it yet

    def has_come():
        for name in heard.keys() - {"/map"}:
            if not heard[name]:
                writers[name].publish(String(data=texts[name]))
        time.sleep(0.2)  # at full speed, the large ones would crowd each other out
        return all(heard.values())

    eventually("all have come", has_come)
    assert {name: set(found) for name, found in heard.items()} == {name: {text} for name, text in texts.items()}
