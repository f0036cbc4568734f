"""The thread of an end that writes to the link."""

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from arpd.endpoint.lane import Lane
from arpd.relay.ends.link import LinkThread
from arpd.relay.envelope import decode_chunk, wrap


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


def test_small_messages_of_one_turn_leave_in_one_packet(eventually):
    """The thread waits for the end of the turn in which they are read, or until they fill a packet."""
    written = []
    thread = LinkThread(1, state=lambda _state: None, sign=lambda _sign: None, together=written.append)
    lanes = [Lane(written.append, has_company=True) for _ in range(3)]
    for lane in lanes:
        thread.add(lane)
    thread.start()
    eventually("it sleeps", lambda: thread._next_s > 1.0)
    for lane in lanes[:2]:
        thread.offer(lane, b"small")
    assert not written
    thread.collect()
    eventually("they leave", lambda: written)
    assert [decode_chunk(sample).part for sample in written] == [b"smallsmall"]
    for lane in lanes:
        thread.offer(lane, bytes(500))
    eventually("a packet is full", lambda: len(written) > 1)
    thread.stop()
