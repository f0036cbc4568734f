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


@given(records)
def test_a_record_survives_its_bytes(record):
    """What is decoded is what was encoded."""
    assert decode_record(encode_record(record)) == record


@given(st.binary(max_size=200))
def test_random_bytes_raise_nothing_else(data):
    """Bytes from a stranger are a record or a ValueError."""
    with suppress(ValueError):
        decode_record(data)


def test_an_end_never_sends_a_record_that_the_other_refuses(monkeypatch):
    """The encoder refuses what is too large for the decoder."""
    monkeypatch.setattr(call_records, "_MOST_BYTES", 100)
    with pytest.raises(ValueError, match="more than 100"):
        encode_record(Record(caller="a", callee="b", number=1, content=Answer(body=bytes(100))))
    with pytest.raises(ValueError, match="a text of 2000 bytes"):
        encode_record(Record(caller="a" * 2000, callee="b", number=1, content=Signal.DONE))
