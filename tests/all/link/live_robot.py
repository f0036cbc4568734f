"""The demo robot for tests: live, with arpd, over a real link."""

from __future__ import annotations

import os
import signal
from contextlib import contextmanager

from scripts.netns.simlink import SimLink
from scripts.robot.manner import WITH_ARPD
from scripts.robot.run import PREFIX, SOURCES, robot
from tests.waiting import eventually

FAST, SLOW = 20e6 / 8, 5e6 / 8
# 5 Mbit/s cannot carry these topics at the source's rate; the others keep their rates and their deadlines.
HEAVY = {PREFIX + topic for topic in ("/camera/image/compressed", "/points", "/scan/front", "/scan/rear")}


@contextmanager
def live_robot(workdir):
    """Yield the publishing robot and end it with the block."""
    with SimLink(f"test-{os.getpid()}", rate_bytes_per_second=FAST) as link, robot(link, workdir, WITH_ARPD) as side:
        side.signal(signal.SIGUSR1, *SOURCES)
        yield side


def topics(side):
    """Return the topics of the status by name; a daemon that has no time to answer is asked again."""
    status = eventually("the daemon answers", side.status)
    return {topic["topic"]: topic for topic in status["topics"]}


def is_confirmed(side):
    """Return whether every topic is planned and confirmed."""
    status = side.status()
    return (
        status is not None
        and len(status["topics"]) == 12
        and status["plan"]["topics"] == 12
        and status["plan"]["confirmed"] == 12
    )


def received(side, name):
    """Return how often a topic arrived in the planner's last second."""
    return side.arrivals.get(name, {}).get("rate_hz", 0)
