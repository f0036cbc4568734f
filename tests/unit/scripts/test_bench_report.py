"""The parts of the benchmarks' reports."""

import pytest

from scripts.bench.report import Target, mbit, milli, percent, spread, table, targets


def test_a_table_puts_numbers_right_and_dashes_where_nothing_came():
    """The cells decide, not the declaration; a value has its form, and text is as it is."""
    rows = [{"side": "arpd", "p99_s": 0.2134, "n": 12}, {"side": "2 ends", "p99_s": None, "n": 100}]
    found = table(rows, ("side", "side"), ("p99 ms", "p99_s", milli), ("twice", lambda row: 2 * row["n"], "{:.1f}"))
    assert found.splitlines() == [
        "| side | p99 ms | twice |",
        "|---|---:|---:|",
        "| arpd | 213 | 24.0 |",
        "| 2 ends | – | 200.0 |",
    ]


@pytest.mark.parametrize(
    ("values", "expected"),
    [([], ""), ([1.0], "1.0"), ([3.0, 1.0, 2.0], "2.0 (3.0)"), ([1.0, 1.04], "1.0"), ([None, 1.0], "never in 1 of 2")],
)
def test_the_worst_stands_beside_the_median(values, expected):
    """What never came is worse than any value, and a worst that looks like the median is left out."""
    assert spread(values, "{:.1f}") == expected


@pytest.mark.parametrize(
    ("value", "at_least", "is_met"),
    [(0.5, False, True), (0.51, False, False), (0.5, True, True), (0.49, True, False), (None, True, False)],
)
def test_a_target_is_met_at_its_limit(value, at_least, is_met):
    """What never came misses any target."""
    target = Target("price", value, 0.5, "{:.2f} s", at_least=at_least, parts="probes")
    assert target.is_met is is_met
    assert targets([target]).startswith(f"Targets: {int(is_met)} of 1 met.")
    assert ("probes" in targets([target])) is not is_met


def test_quantities_have_the_unit_of_their_form():
    """Shares become per cent, seconds milliseconds, and bytes per second Mbit/s."""
    assert (percent(0.0123), milli(0.0123), mbit(2.5e6)) == ("1.2", "12", "20")
