"""Sets of samples with one stamp."""

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from arpd.relay.envelope import Record
from arpd.relay.sets import Sets
from arpd.ros.cdr import stamp_of


def sample(member, stamp):
    return Record(bytes([member] * 8), stamp, b"\0\1\0\0" + struct.pack("<iI", 0, stamp))


@given(st.lists(st.lists(st.booleans(), min_size=3, max_size=3), max_size=40), st.randoms())
def test_only_whole_sets_leave_and_each_once(given_by, random):
    """Of any mixture of topics, each in its own order, sets leave whole, in order, and none that misses a sample."""
    queues = [[sample(m, k) for k, present in enumerate(given_by) if present[m]] for m in range(3)]
    sets, left = Sets({0, 1, 2}, on_drop=lambda _samples: None), []
    while any(queues):
        member = random.choice([member for member, queue in enumerate(queues) if queue])
        if whole := sets.add(member, queues[member].pop(0)):
            left.append(whole)
    expected = [k for k, present in enumerate(given_by) if all(present)]
    assert left == [[sample(member, k) for member in range(3)] for k in expected]


def test_samples_of_sets_that_stay_incomplete_are_counted():
    """A complete set, of the wanted members alone, drops the older ones, and too many begun sets drop the oldest."""
    dropped = []
    sets = Sets({0, 1}, on_drop=dropped.append)
    assert sets.add(2, sample(2, 4)) == []
    for stamp in range(5):
        sets.add(0, sample(0, stamp))
    assert sets.add(1, sample(1, 4))
    assert sum(dropped) == 4
    for stamp in range(10, 10 + 65):
        sets.add(0, sample(0, stamp))
    assert sum(dropped) == 5


def test_sets_that_wait_for_a_dead_camera_take_little_memory():
    """However large its samples are, 16 MB wait at most, or two sets; each of those may still become whole."""
    dropped = []
    sets = Sets({0, 1}, on_drop=dropped.append)

    def image(member, stamp, size_bytes):
        return Record(bytes([member] * 8), stamp, sample(member, stamp).sample + bytes(size_bytes))

    for stamp in range(64):
        sets.add(0, image(0, stamp, 4_000_000))
        assert (stamp + 1 - sum(dropped)) * 4_000_000 <= 16_000_000
    assert sum(dropped) == 64 - 3
    for stamp in (70, 71):
        sets.add(0, image(0, stamp, 20_000_000))
    assert len(sets.add(1, sample(1, 70))) == 2
    assert len(sets.add(1, sample(1, 71))) == 2
    for stamp in range(100, 100 + 64):  # what is gone counts no more
        sets.add(0, image(0, stamp, 200_000))
    assert sum(dropped) == 64


def test_a_stamp_is_read_in_either_byte_order_or_refused():
    """A serialized header begins with seconds and nanoseconds; what is too short or encoded otherwise has none."""
    for order in "<>":
        head = bytes([0, order == "<", 0, 0])
        assert stamp_of(head + struct.pack(order + "iI", 12, 34) + b"rest") == (12, 34)
    for other in (b"", b"\0\1\0\0", b"\0\7\0\0" + bytes(8)):
        with pytest.raises(ValueError, match="stamp"):
            stamp_of(other)
