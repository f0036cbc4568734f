"""Real rclpy for every test: its own context, on this host only, with executors in threads."""

import os
import subprocess
import sys
import threading
from contextlib import ExitStack

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from tests.ros.ends_world import TwoEnds
from tests.ros.world import DOMAIN, REPO, Ros, SkippingClock


@pytest.fixture
def environment(monkeypatch):
    """Keep this process, and those that it starts, on this host, with the profile of users' nodes."""
    monkeypatch.setenv("FASTDDS_BUILTIN_TRANSPORTS", "UDPv4")
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    from arpd.ros.runtime import FASTDDS_PROFILE, PROFILE_VARIABLE, prepare_environment

    # A test may have left another one of arpd's, which would be kept.
    monkeypatch.delenv(PROFILE_VARIABLE, raising=False)
    prepare_environment(FASTDDS_PROFILE)


@pytest.fixture
def stack():
    with ExitStack() as stack:
        yield stack


@pytest.fixture
def ros(environment, stack):
    return Ros(stack)


@pytest.fixture
def world(ros, stack, tmp_path):
    """Make two ends of a relay, with these lines under ``relay:``."""
    return lambda *relay, **options: TwoEnds(tmp_path, stack, relay, **options)


@pytest.fixture
def clock():
    return SkippingClock()


@pytest.fixture
def arpd(environment, stack, tmp_path):
    """Start a command of arpd in the tests' domain, which is killed with the test; its log is a file ``log``."""

    def start(*arguments, **environment):
        process = subprocess.Popen(
            [sys.executable, "-u", "-m", "arpd.cli", *map(str, arguments)],
            env={**os.environ, "ROS_DOMAIN_ID": str(DOMAIN), **environment},
            stdout=subprocess.PIPE,
            stderr=(tmp_path / "log").open("w"),
            text=True,
            cwd=REPO,
        )
        stack.callback(process.communicate)
        stack.callback(process.kill)
        return process

    return start


@pytest.fixture(scope="module", autouse=True)
def _own_network(network):
    """Keep what a file of tests sends from the other workers."""


@pytest.fixture
def background():
    """Run functions in threads until the test ends, before the nodes go that were made before."""
    stopping, threads = threading.Event(), []

    def start(work):
        threads.append(threading.Thread(target=work, args=(stopping,), daemon=True))
        threads[-1].start()

    yield start
    stopping.set()
    for thread in threads:
        thread.join(timeout=5)


@pytest.fixture
def talking(background):
    """Let writers publish until the test ends, at most so many times a second."""

    def start(*writers, rate_hz=100):
        def talk(stopping):
            while not stopping.wait(1 / rate_hz):
                for writer in writers:
                    writer.publish()

        background(talk)

    return start
