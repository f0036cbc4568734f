"""Records of calls: their bytes, and what a decoder refuses."""

from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from arpd.apply.relay import call_records
from arpd.apply.relay.call_records import (
    Answer,
    CallFailure,
    FailureReason,
    Record,
    Request,
    Signal,
    decode_record,
    encode_record,
)

names = st.text(st.characters(codec="utf-8"), max_size=60)
numbers = st.integers(0, 2**64 - 1)
contents = st.one_of(
    st.builds(Request, service=names, type_name=names, body=st.binary()),
    st.builds(Answer, body=st.binary()),
    st.builds(CallFailure, reason=st.sampled_from(FailureReason), message=names),
    st.sampled_from(Signal),
)
records = st.builds(Record, caller=names, callee=names, number=numbers, oldest=numbers, content=contents)
REQUEST = Record(
    caller="here", callee="there", number=7, oldest=5, content=Request(service="/s", type_name="t/srv/T", body=b"body")
)


@given(records)
def test_a_record_survives_its_bytes(record):
    """What is decoded is what was encoded."""
    assert decode_record(encode_record(record)) == record


@given(records, st.data())
def test_a_cut_record_is_no_other_record(record, data):
    """A record that was cut short is refused."""
    whole = encode_record(record)
    with pytest.raises(ValueError, match=r"."):
        decode_record(whole[: data.draw(st.integers(0, len(whole) - 1))])


@given(st.binary(max_size=200))
def test_random_bytes_raise_nothing_else(data):
    """Bytes from a stranger are a record or a ValueError."""
    with suppress(ValueError):
        decode_record(data)


@given(records, st.integers(0, 10_000), st.integers(0, 255))
def test_a_changed_byte_raises_nothing_else(record, at, value):
    """A record with one other byte is a record or a ValueError."""
    data = bytearray(encode_record(record))
    data[at % len(data)] = value
    with suppress(ValueError):
        decode_record(bytes(data))


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda data: b"\x09" + data[1:], "version 9"),
        (lambda data: data[:1] + b"\x63" + data[2:], "unknown kind 99"),
        (lambda data: data[:1] + b"\x04" + data[2:], "of 3 parts"),
        (lambda data: data + b"\0\0\0\0", "more than 5 parts"),
        (lambda data: data + b"\0", "middle of a length"),
        (lambda data: data[:-1], "1 bytes early"),
        (lambda data: data[:18], "without its sessions"),
        (lambda data: data[:17], "17 bytes"),
        (lambda data: data.replace(b"here", b"\xff\xff\xff\xff"), "utf-8"),
    ],
)
def test_a_refusal_names_its_reason(change, reason):
    """Each kind of bad record is refused with its own reason."""
    with pytest.raises(ValueError, match=reason):
        decode_record(change(encode_record(REQUEST)))


def test_an_end_never_sends_a_record_that_the_other_refuses(monkeypatch):
    """The encoder refuses what is too large for the decoder."""
    monkeypatch.setattr(call_records, "_MOST_BYTES", 100)
    with pytest.raises(ValueError, match="more than 100"):
        encode_record(Record(caller="a", callee="b", number=1, content=Answer(body=bytes(100))))
    with pytest.raises(ValueError, match="a text of 2000 bytes"):
        encode_record(Record(caller="a" * 2000, callee="b", number=1, content=Signal.DONE))


def test_a_long_reason_is_cut():
    """A failure is told even where its words are too many, or no Unicode."""
    failure = CallFailure(reason=FailureReason.TYPE, message="ä\udcff" * 5000)
    decoded = decode_record(encode_record(Record(caller="a", callee="b", number=1, content=failure)))
    assert isinstance(decoded.content, CallFailure)
    assert decoded.content.reason is FailureReason.TYPE
    assert decoded.content.message.startswith("ä?ä?")
