"""Figures of the benchmark of the relay, from made turns; real ones need the link."""

import pytest

from scripts.bench.relay import DIRECT, TWO_ENDS, added_ms, cpu_us


def side(*cpu_s, latency_s):
    """Return three turns of a side; its processes spend the given time per message, more in one of the turns."""
    return {
        "cpu_s": [[spent * factor for spent in cpu_s] for factor in (1.0, 5.0, 1.0)],
        "latency_s": [latency_s, latency_s * 3.0, latency_s],
        "p95_s": [latency_s * 2.0] * 3,
    }


def test_figures_are_medians_of_turns():
    """One disturbed turn does not count, both ends add up, and latency is that beyond no relay."""
    measured = {"sides": {DIRECT: side(latency_s=200e-6), TWO_ENDS: side(350e-6, 250e-6, latency_s=1100e-6)}}
    assert cpu_us(measured, TWO_ENDS) == pytest.approx(600.0)
    assert [cpu_us(measured, TWO_ENDS, process=process) for process in (0, 1)] == pytest.approx([350.0, 250.0])
    assert added_ms(measured, TWO_ENDS) == pytest.approx(0.9)
    assert added_ms(measured, TWO_ENDS, "p95_s") == pytest.approx(1.8)
