"""Slow work beside the executor."""

import threading
from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from arpd.ros.world import PeriodicThread


class Node:
    """A node whose context can end."""

    def __init__(self):
        self.is_ok = True
        self.context = SimpleNamespace(ok=lambda: self.is_ok)


def threads():
    return [thread for thread in threading.enumerate() if thread.name == "arpd-periodic"]


def test_a_part_that_fails_does_not_stop_the_others(eventually, caplog):
    """The failure is logged, and all tasks run again and again until the context ends."""
    node, done = Node(), []

    def fail():
        raise ValueError("a bug")

    PeriodicThread(node, fail, lambda: done.append(1), every_s=0.01)
    eventually("the other task goes on", lambda: len(done) >= 3)
    assert "a periodic task failed" in caplog.text
    node.is_ok = False
    eventually("the thread ends", lambda: not threads())
