"""The thread that writes, and the locks around it."""

import threading

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from arpd.endpoint.queue import PacedQueue
from arpd.endpoint.writing_thread import WritingThread

LONG_S = 5.0


def test_a_context_that_shuts_down_can_stop_it():
    """A context holds its lock while it calls `stop`, and takes the same one to tell whether it is alive."""
    context, asked = threading.Lock(), threading.Event()

    def is_alive():
        asked.set()
        with context:
            return True

    thread = WritingThread(PacedQueue(), name="writing", is_alive=is_alive)
    with context:
        thread.start()
        assert asked.wait(LONG_S)
        stopping = threading.Thread(target=thread.stop, daemon=True)
        stopping.start()
        stopping.join(LONG_S)
        assert not stopping.is_alive()
