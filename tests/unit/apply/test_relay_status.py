"""Shards of a relay, and the status over all of them."""

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


def test_the_status_covers_all_shards():
    """One line counts the topics of all shards, and names what any of them does not carry."""
    parts = (
        RelayStatus(topics=("/a", "/b"), flowing=("/a",), unpublished=("/b",), ignored=(("/a", "Empty from /x"),)),
        RelayStatus(topics=("/c", "/d"), gone=("/c",), refused=(("/d", "why"),)),
        RelayStatus(topics=("/e", "/f"), unpublished=("/e",), refused=(("/0", "first"),)),
    )
    assert RelayStatus.of(parts).line == (
        "relaying 1 of 6 topics; not published yet: /b, /e; no longer published: /c; refused /0: first; "
        "refused /d: why; on /a ignored Empty from /x"
    )
