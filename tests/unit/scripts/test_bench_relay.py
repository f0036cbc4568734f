"""Figures of the benchmark of the relay, from made turns; real ones need the link."""

import pytest

from scripts.bench.record import conditions
from scripts.bench.relay_report import BARE, DIRECT, ONE_END, TWO_ENDS, added_ms, cpu_us, lost, markdown, ratio, table


def side(*cpu_s, latency_s, sent=600, received=600, rest=()):
    """Return three turns of a side; its processes spend the given time per message, more in one of the turns."""
    return {
        "sent": sent,
        "received": received,
        "cpu_s": [[spent * factor for spent in cpu_s] for factor in (1.0, 5.0, 1.0)],
        "latency_s": [latency_s, latency_s * 3.0, latency_s],
        "p95_s": [latency_s * 2.0] * 3,
        "rest": list(rest),
    }


def cell(*, one_end_s=240e-6, two_ends_lost=0, **changes):
    sides = {
        DIRECT: side(latency_s=200e-6),
        BARE: side(200e-6, latency_s=500e-6),
        ONE_END: side(one_end_s, latency_s=600e-6, rest=(0.01, 0.01)),
        TWO_ENDS: side(350e-6, 250e-6, latency_s=1100e-6, received=600 - two_ends_lost, rest=(0.02, 0.04)),
    }
    return {"payload_bytes": 1000, "topics": 12, "rate_hz": 400, "sides": sides} | changes


def test_figures_are_medians_of_turns():
    """One disturbed turn does not count, both ends add up, and latency is that beyond no relay."""
    measured = cell()
    assert cpu_us(measured, TWO_ENDS) == pytest.approx(600.0)
    assert [cpu_us(measured, TWO_ENDS, process=process) for process in (0, 1)] == pytest.approx([350.0, 250.0])
    assert ratio(measured) == pytest.approx(1.2)
    assert ratio(measured, TWO_ENDS, to=ONE_END) == pytest.approx(2.5)
    assert added_ms(measured, TWO_ENDS) == pytest.approx(0.9)
    assert added_ms(measured, TWO_ENDS, "p95_s") == pytest.approx(1.8)
    assert lost(cell(two_ends_lost=7), TWO_ENDS) == 7


def test_a_cell_above_the_target_is_marked():
    """The table marks it and counts it out, and the page names it."""
    cells = [cell(one_end_s=210e-6), cell(one_end_s=300e-6, topics=100)]
    lines = table(cells).splitlines()
    assert ["1.50!" in line for line in lines[2:4]] == [False, True]
    assert lines[-1].startswith("1 of 2 ")
    page = markdown({"conditions": conditions(), "cells": cells})
    assert "1.50 times with 100 topics of 1,000 bytes" in page


def test_the_page_has_every_cell_and_the_ranges():
    """Each cell is a row of the table; the bullets have the extremes, and what got lost."""
    cells = [cell(), cell(payload_bytes=1_000_000, one_end_s=200e-6, two_ends_lost=7)]
    page = markdown({"conditions": conditions(), "cells": cells})
    assert "2.50 to 3.00 times" in page
    assert "adds 0.50 to 0.50 ms" in page  # of the small payload alone
    assert " 7 got lost" in page
    assert "| 1,000,000 | 12 | 400 | 200 | 200 | 600 | 350+250 | 0.30 (0.60) |" in page
