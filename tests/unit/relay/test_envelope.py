"""Samples as they cross the link, in chunks."""

from itertools import cycle

import pytest
from hypothesis import given
from hypothesis import strategies as st

from arpd.relay.calls import Kind
from arpd.relay.calls import Record as CallRecord
from arpd.relay.envelope import (
    MOST_MESSAGE_BYTES,
    WRAP,
    Assembly,
    Chunk,
    Record,
    decode_chunk,
    encode_chunk,
    pack,
    unpack,
)
from arpd.ros.cdr import wrap

NUMBERS = st.integers(0, WRAP - 1)
RECORDS = st.builds(
    Record,
    writer=st.binary(min_size=8, max_size=8),
    sequence=st.integers(0, 2**64 - 1),
    sample=st.binary(max_size=300),
)
CHUNKS = st.builds(
    Chunk,
    session=NUMBERS,
    number=NUMBERS,
    departed_us=NUMBERS,
    message=NUMBERS,
    offset=st.integers(0, MOST_MESSAGE_BYTES - 40),
    total=st.just(MOST_MESSAGE_BYTES),
    is_kept=st.booleans(),
    part=st.binary(max_size=40),
)
CHUNK = Chunk(session=7, number=1, departed_us=2, message=3, offset=4, total=10, is_kept=False, part=b"abc")


def cut(message, size, *, session=7, number=1):
    """Return the chunks of a message."""
    whole = CHUNK._replace(session=session, message=number, total=len(message))
    return [whole._replace(offset=at, part=message[at : at + size]) for at in range(0, max(1, len(message)), size)]


@given(st.lists(RECORDS, max_size=4), st.data())
def test_records_arrive_as_they_were_packed_and_no_part_of_them_does(records, data):
    """Writers, numbers and samples survive; nobody hears a part of a sample."""
    assert unpack(pack(records)) == records
    if records:
        message = pack(records[:1])
        with pytest.raises(ValueError, match="relay"):
            unpack(message[: data.draw(st.integers(1, len(message) - 1))])


@given(CHUNKS, st.data())
def test_a_chunk_arrives_as_it_was_sent_and_no_part_of_it_does(chunk, data):
    """Every field survives up to its last value; whatever cuts a chunk off, it is refused."""
    sample = encode_chunk(chunk)
    assert decode_chunk(sample) == chunk
    with pytest.raises(ValueError, match="chunk"):
        decode_chunk(sample[: data.draw(st.integers(0, len(sample) - 1))])


@pytest.mark.parametrize(
    "sample",
    [
        encode_chunk(CHUNK._replace(total=6)),
        encode_chunk(CHUNK._replace(total=MOST_MESSAGE_BYTES + 1)),
        wrap(b"shorter than a chunk"),
        b"\0\0" + encode_chunk(CHUNK)[2:],
        encode_chunk(CHUNK)[:4] + b"\1" + encode_chunk(CHUNK)[5:],
    ],
    ids=["beyond its message", "of a message that would fill the memory", "no header", "big endian", "dimensions"],
)
def test_a_malformed_chunk_is_refused(sample):
    """What no end sends is refused, and not put together."""
    with pytest.raises(ValueError, match="chunk"):
        decode_chunk(sample)


@given(st.binary(max_size=80))
def test_any_bytes_are_a_chunk_or_refused(data):
    """Bytes of another origin do no harm."""
    for sample in (data, wrap(data)):
        try:
            decode_chunk(sample)
        except ValueError:
            continue


@given(
    st.lists(st.tuples(st.integers(1, 9), st.integers(1, 9)), min_size=1, max_size=6),
    st.lists(st.sampled_from(["arrives", "arrives", "arrives", "lost", "twice", "foreign"]), min_size=1, max_size=40),
    st.integers(0, 6),
)
def test_nothing_is_torn_and_nothing_doubled(messages, fates, restart):
    """Chunks that are lost, come twice or are another session's, and a restart: what arrives is whole, and once."""
    fate, arriving, sent, untouched = cycle(fates), [], [], []
    for place, (length, size) in enumerate(messages):
        sent.append(bytes(range(10 * place, 10 * place + length)))
        session, number = (7, place) if place < restart else (8, place - restart)
        chunks = cut(sent[-1], size, session=session, number=number)
        happened = [next(fate) for _ in chunks]
        for chunk, happens in zip(chunks, happened, strict=True):
            foreign = chunk._replace(session=99, part=b"\xff" * len(chunk.part))
            arriving += {"arrives": [chunk], "lost": [], "twice": [chunk] * 2, "foreign": [foreign, chunk]}[happens]
        if set(happened) == {"arrives"}:
            untouched.append(sent[-1])
    assembly = Assembly()
    found = [assembly.add(chunk) for chunk in arriving]
    found = [message for message in found if message is not None and set(message) != {255}]
    assert set(untouched) <= set(found) <= set(sent)
    assert found == sorted(set(found))


@given(st.lists(st.integers(2, 60), min_size=1, max_size=6), st.randoms())
def test_messages_that_cross_by_turns_are_put_together(lengths, random):
    """Each message is whole; a new message of a writer replaces its torn one."""
    messages = [bytes([place]) * 8 + bytes(length) for place, length in enumerate(lengths)]
    torn = [cut(message, 9, session=7, number=place)[0] for place, message in enumerate(messages)]
    left = [cut(message, 9, session=7, number=100 + place) for place, message in enumerate(messages)]
    assembly, found = Assembly(), []
    assert not any(map(assembly.add, torn))
    while left:
        chunks = random.choice(left)
        found += [message] if (message := assembly.add(chunks.pop(0))) else []
        left = [each for each in left if each]
    assert sorted(found) == messages
    assert not any(
        map(
            assembly.add,
            [chunk for place in range(len(lengths)) for chunk in cut(messages[place], 9, session=7, number=place)[1:]],
        )
    )


def test_a_small_call_crosses_beside_a_large_one():
    """Each call is a writer of its own, so the record of one tears none of another under way."""
    large, small = (CallRecord(Kind.REQUEST, 7, number, bytes(length)).encode() for number, length in ((1, 40), (2, 1)))
    first, *rest = cut(large, 20, session=7, number=1)
    assembly = Assembly()
    assert assembly.add(first) is None
    assert assembly.add(cut(small, 20, session=7, number=2)[0]) == small
    assert [assembly.add(chunk) for chunk in rest][-1] == large


def test_of_many_messages_that_never_end_the_oldest_give_way():
    """An end that is sent the beginnings of many messages keeps some of them, and puts the next one together."""
    message, assembly = bytes(40), Assembly()
    begun = [cut(number.to_bytes(8, "big") + message, 20, session=7, number=number) for number in range(300)]
    for chunks in begun:
        assembly.add(chunks[0])
    ended = [[assembly.add(chunk) for chunk in chunks[1:]][-1] is not None for chunks in begun]
    assert ended == [False] * 44 + [True] * 256
