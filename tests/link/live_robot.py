"""A live robot for tests: the demo's, with arpd, over a real link, and what its status says."""

from __future__ import annotations

import os
import signal
import time
from contextlib import contextmanager

from scripts.netns.simlink import SimLink
from scripts.robot.manner import WITH_ARPD
from scripts.robot.run import PREFIX, robot
from scripts.robot.sensors import SENSORS

FAST, SLOW = 20e6 / 8, 5e6 / 8
# What 5 Mbit/s cannot carry at the source's rate; the others keep theirs, so their QoS need not change again.
HEAVY = {PREFIX + topic for topic in ("/camera/image/compressed", "/points", "/scan/front", "/scan/rear")}
SOURCES = ("planner", *(topic.strip("/").replace("/", "_") for topic in SENSORS), "base_driver")


@contextmanager
def live_robot(workdir):
    """Yield the robot, publishing; it ends with the block."""
    with (
        SimLink(f"test-{os.getpid()}", rate_bytes_per_second=FAST) as link,
        robot(link, workdir, WITH_ARPD) as side,
    ):
        side.signal(signal.SIGUSR1, *SOURCES)
        yield side


def topics(side):
    status = side.status()
    return {topic["topic"]: topic for topic in status["topics"]} if status else {}


def eventually(condition, timeout_s=30.0):
    until_s = time.monotonic() + timeout_s
    while time.monotonic() < until_s:
        if condition():
            return
        time.sleep(0.2)
    assert condition(), "did not happen in time"


def is_confirmed(side):
    """Every topic is planned and runs what is planned."""
    status = side.status()
    return (
        status is not None
        and len(status["topics"]) == 12
        and status["plan"]["topics"] == 12
        and status["plan"]["confirmed"] == 12
    )


def qos(topic):
    confirmed = topic["confirmed"]
    return confirmed["rate_hz"], confirmed["depth"], confirmed["deadline_ns"]


def received(side, name):
    """How often a topic arrived in the planner's last second."""
    return side.arrivals.get(name, {}).get("rate_hz", 0)
