"""Quantities as people write them."""

from __future__ import annotations

import contextlib

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from arpd.model.quantities import (
    DURATION,
    RATE,
    SIZE,
    format_duration,
    format_number,
    format_period,
    format_rate,
    format_share,
    format_size,
)

FINITE = st.floats(min_value=0, max_value=1e15)
WRITTEN = (RATE, format_rate, 1e-9 / 8), (SIZE, format_size, 1e-9), (DURATION, format_duration, 1e-18)


@pytest.mark.parametrize(
    ("units", "text", "value"),
    [
        (RATE, "500 KBit", 62_500.0),
        (RATE, "5.00 Mbit/s", 625_000.0),
        (RATE, "125kB/s", 125_000.0),
        (SIZE, "64MiB", 64 * 2**20),
        (SIZE, "500KB", 5e5),
        (DURATION, "1.1ms", 0.0011),
        (DURATION, "5µs", 5e-6),
        (DURATION, "5μs", 5e-6),
    ],
)
def test_a_quantity_is_the_nearest_float_in_base_units(units, text, value):
    """Bit units are decimal and any case, bytes decimal or binary as written; nothing is lost before the float."""
    assert units.parse(text) == value


@pytest.mark.parametrize(
    ("units", "text", "message"),
    [
        (RATE, "5", "'5' has no unit; write a rate like 20mbit"),
        (RATE, "5mbps", "means bits to some and bytes to tc"),
        (RATE, "5kB", "'kB' is not a unit of a rate"),
        (RATE, "1e999gbit", "too large"),
        (SIZE, "64Mi", "'Mi' is not a unit of a size"),
        (DURATION, "2 fortnights", "'fortnights' is not a unit of a duration"),
        (DURATION, "٣s", "is not a duration"),
    ],
)
def test_what_is_no_quantity_is_refused_with_the_way_out(units, text, message):
    """The message quotes what was written and shows what would be right."""
    with pytest.raises(ValueError, match="; write ") as refused:
        units.parse(text)
    assert message in str(refused.value)


@given(FINITE)
@example(0.125)
def test_a_spelled_quantity_reads_back_exactly_and_a_formatted_one_to_three_digits(value):
    """What is printed may be pasted into the configuration; of the smallest unit only nine decimals are written."""
    for units, write, least in WRITTEN:
        assert units.parse(units.spell(value)) == value
        assert units.parse(write(value)) == pytest.approx(value, rel=0.006, abs=least)


@pytest.mark.parametrize(
    ("formatted", "text"),
    [
        (format_rate(612_500), "4.9 Mbit/s"),
        (format_rate(float("inf")), "unlimited"),
        (format_rate(None), "-"),
        (format_size(64 * 2**20), "64 MiB"),
        (format_duration(0.0125), "12.5 ms"),
        (format_period(0), "none"),
        (format_share(0.756), "76 %"),
        (format_number(12.345), "12.3"),
        (format_number(0.00001234, digits=4), "0.00001234"),
    ],
)
def test_a_quantity_is_written_for_a_reader(formatted, text):
    """Three significant digits and the unit that fits; no zeros at the end, no exponent, a dash for the unknown."""
    assert formatted == text


@given(st.text(max_size=60))
def test_any_text_is_a_quantity_or_refused(text):
    """No text does more than raise ValueError."""
    for units in (RATE, SIZE, DURATION):
        with contextlib.suppress(ValueError):
            assert units.parse(text) >= 0
