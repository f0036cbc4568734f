"""Signs of life of the ends."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from arpd.relay.envelope import WRAP
from arpd.relay.flight import Receipt
from arpd.relay.signs import Sign, decode_sign, encode_sign

NUMBERS = st.integers(0, WRAP - 1)
SIGNS = st.builds(Sign, NUMBERS, NUMBERS, NUMBERS, st.builds(Receipt, NUMBERS, NUMBERS, NUMBERS, NUMBERS, NUMBERS))


@given(SIGNS)
def test_a_sign_arrives_as_it_was_sent(sign):
    """Session, probe and receipt survive up to their last values."""
    assert decode_sign(encode_sign(sign)) == sign


@given(SIGNS, st.integers(0, 255), st.binary(max_size=60))
def test_another_version_or_length_is_refused(sign, version, other):
    """An end of another version is understood by none, instead of misunderstood."""
    good = encode_sign(sign)
    for data in (bytes([version]) + good[1:], other, good[:-1], good + other):
        if data[:1] != good[:1] or len(data) != len(good):
            with pytest.raises(ValueError, match="version"):
                decode_sign(data)
