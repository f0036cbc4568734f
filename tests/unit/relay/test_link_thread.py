"""The thread of an end that writes to the link."""

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from arpd.relay.ends.link import LinkThread
from arpd.ros.cdr import wrap


def test_of_the_states_that_wait_for_the_link_the_newest_leaves(eventually):
    """Those of an outage do not pile up, to fill the link when it is back."""
    written = []
    thread = LinkThread(1, state=written.append, sign=lambda _sign: None, together=lambda _sample: None)
    for state in (b"old", b"older", b"newest"):
        thread.tell(state)
    thread.start()
    eventually("a state leaves", lambda: written)
    thread.stop()
    assert written == [wrap(b"newest")]
