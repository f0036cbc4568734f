"""Shards of a relay, and its status."""

from itertools import chain

from hypothesis import given
from hypothesis import strategies as st

from arpd.apply.relay_status import RelayStatus, shards


@given(st.integers(0, 2000))
def test_shards_hold_every_topic_once(number):
    """Shards keep the order of the topics, hold 100 at most, and differ by one at most; there is always one."""
    topics = tuple(f"/t{k}" for k in range(number))
    parts = shards(topics)
    sizes = [len(part) for part in parts]
    assert tuple(chain.from_iterable(parts)) == topics
    assert len(parts) == max(1, -(-number // 100))
    assert max(sizes) <= 100
    assert max(sizes) - min(sizes) <= 1


def test_the_status_names_what_is_not_carried():
    """One line counts the topics, and names what is not carried and why."""
    status = RelayStatus(
        topics=("/a", "/b", "/c", "/d"),
        flowing=("/a",),
        unpublished=("/b",),
        gone=("/c",),
        refused=(("/d", "why"),),
        ignored=(("/a", "std_msgs/msg/Empty"),),
    )
    assert status.line == (
        "relaying 1 of 4 topics; not published yet: /b; no longer published: /c; refused /d: why; "
        "on /a ignored std_msgs/msg/Empty"
    )
