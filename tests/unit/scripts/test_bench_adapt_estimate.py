"""The figures of arpd's estimate over a link, from made readings; real readings need the link."""

from typing import Any

import pytest

from arpd.adapters.sim.schedule import RateSchedule
from arpd.report.status import status_document
from scripts.bench.adapt_course import Belief, BucketReading, Instant, believed, course_of
from scripts.bench.adapt_estimate import estimate_figures
from scripts.bench.adapt_links import MBIT, OUTAGE_BYTES_PER_SECOND, Link


def link_of(rates):
    return Link(name="made", what="", rates=RateSchedule.parse(rates), duration_s=35.0)


DROP, RISE, STEADY = map(link_of, ("0:20mbit,12:5mbit", "0:5mbit,12:20mbit", "0:20mbit"))
OUTAGE = link_of(f"0:20mbit,12:{8 * OUTAGE_BYTES_PER_SECOND:g}bit,17:20mbit")


def belief(**changes):
    values: dict[str, Any] = dict.fromkeys(Belief.__slots__, 0) | {
        "estimate_bytes_per_second": 20 * MBIT,
        "budget_bytes_per_second": 17 * MBIT,
    }
    return Belief(**(values | changes))


def made_course(link, believe, *, queue_s=lambda _t: 0.01, sent=lambda t: round(t * MBIT * 10)):
    times = [round(0.1 * k, 1) for k in range(1, round(link.duration_s / 0.1) + 1)]
    return [
        Instant(
            t_s=t,
            truth_bytes_per_second=0.0 if any(a <= t < b for a, b in link.outages) else link.rates.rate_at(t),
            queue_delay_s=queue_s(t),
            carried_bytes=sent(t),
            belief=believe(t),
        )
        for t in times
    ]


def test_readings_at_their_own_moments_come_to_one_grid():
    """An instant has its longest queue, the last rate, the bytes sent since the start, and a fresh belief.

    While nothing passes it has no queue.
    """
    buckets = [
        BucketReading(at_s=at_s, rate_bytes_per_second=rate, backlog_bytes=backlog, sent_bytes=sent)
        for at_s, rate, backlog, sent in (
            (99.99, 1000.0, 500, 70),  # before the start
            (100.03, 1000.0, 100, 80),
            (100.06, 1000.0, 300, 90),
            (100.09, 1000.0, 200, 100),
            (100.15, 500.0, 50, 110),
            (100.77, OUTAGE_BYTES_PER_SECOND, 50, 110),
        )
    ]
    course = course_of(buckets, [(100.05, belief(swaps=7))], started_s=100.0, duration_s=0.8)
    assert [instant.t_s for instant in course] == pytest.approx([0.1 * k for k in range(1, 9)])
    assert [instant.queue_delay_s for instant in course[:3]] == pytest.approx([0.3, 0.1, 0.1])
    assert [instant.truth_bytes_per_second for instant in course[:2]] == [1000.0, 500.0]
    assert (course[7].truth_bytes_per_second, course[7].queue_delay_s) == (0.0, 0.0)
    assert [instant.carried_bytes for instant in course[:2]] == [30, 40]
    assert [instant.belief is not None for instant in course] == [True] * 5 + [False] * 3


def test_a_status_document_becomes_a_belief(sample_snapshot):
    """The status document has every figure, and a swap with two results counts once."""
    document = status_document(sample_snapshot)
    document["topics"][0]["swaps"] = {"ok": 2, "timeout": 1, "undelivered": 3}
    others = sum(sum(topic["swaps"].values()) for topic in document["topics"][1:])
    found = believed(document, report_wire_bytes=200)
    assert found.estimate_bytes_per_second == document["link"]["capacity_bytes_per_second"]
    assert found.budget_bytes_per_second == document["allocation"]["capacity_bytes_per_second"]
    assert found.swaps == 3 + others
    assert found.report_bytes == 200 * sample_snapshot.totals.reports


def test_the_steady_error_leaves_out_the_start_and_the_reaction():
    """Error and bias are those of the estimate long after the link changed, and long after the start."""

    def believe(t):
        truth = DROP.rates.rate_at(t)
        return belief(estimate_bytes_per_second=(0.9 if t >= 20 else 1.1 if 8 <= t < 12 else 9.0) * truth)

    found = estimate_figures(made_course(DROP, believe), DROP)
    assert found["error_median"] == pytest.approx(0.1)
    assert found["error_p90"] == pytest.approx(0.1)
    assert found["bias"] == pytest.approx(-0.1)


def test_the_reaction_to_a_drop_is_when_the_estimate_is_near_and_stays():
    """An estimate or a budget that passes the truth is no reaction; both must stay for a second."""

    def believe(t):
        near = 12.5 <= t < 12.8 or t >= 13.2
        fits = 12.15 < t < 12.25 or t > 12.35
        return belief(
            estimate_bytes_per_second=(5.5 if near else 20.0) * MBIT,
            budget_bytes_per_second=(4.0 if fits else 9.0) * MBIT,
        )

    found = estimate_figures(made_course(DROP, believe, queue_s=lambda t: 0.4 if 12.2 < t < 12.6 else 0.02), DROP)
    assert found["reaction_s"] == pytest.approx(1.2)
    assert found["budget_s"] == pytest.approx(0.4)
    assert found["peak_queue_s"] == 0.4
    assert "rise_s" not in found


def test_what_never_happens_is_none():
    """An estimate that stays high has no reaction time, and one that stays low never rises."""
    assert estimate_figures(made_course(DROP, lambda _t: belief()), DROP)["reaction_s"] is None
    low = belief(estimate_bytes_per_second=5 * MBIT)
    assert estimate_figures(made_course(RISE, lambda _t: low), RISE)["rise_s"] is None


def test_the_rise_is_when_80_per_cent_are_known():
    """The rise ends at 80 % of 20 Mbit/s."""

    def believe(t):
        return belief(estimate_bytes_per_second=min(20.0, 5.0 + max(0.0, t - 12.0)) * MBIT)

    assert estimate_figures(made_course(RISE, believe), RISE)["rise_s"] == pytest.approx(11.0)


def test_an_outage_has_three_times():
    """They end when the budget is a tenth of what it was, when the estimate is back, and when the traffic is back."""

    def believe(t):
        return belief(
            budget_bytes_per_second=(1.6 if 12.4 <= t < 17.3 else 17.0) * MBIT,
            estimate_bytes_per_second=(12.0 if 17.0 <= t < 19.0 else 20.0) * MBIT,
        )

    def sent(t):
        return round(MBIT * 10 * (min(t, 12.0) + max(0.0, t - 18.0)))

    found = estimate_figures(made_course(OUTAGE, believe, sent=sent), OUTAGE)
    assert found["closed_s"] == pytest.approx(0.4)
    assert found["recovery_s"] == pytest.approx(2.0)
    assert found["traffic_back_s"] == pytest.approx(1.8)


def test_costs_are_counted_after_the_start_and_per_minute():
    """Plans and swaps of the first seconds do not count; probes and reports are shares of the truth."""

    def believe(t):
        return belief(
            levels=2 if t > 20 else 1,
            swaps=12 if t > 9 else 0,
            probe_bytes=round(t * 0.01 * 20 * MBIT),
            report_bytes=round(t * 0.002 * 20 * MBIT),
        )

    found = estimate_figures(made_course(STEADY, believe), STEADY)
    minutes = 24.9 / 60.0
    assert found["plans_per_minute"] == pytest.approx(1 / minutes)
    assert found["swaps_per_minute"] == 0.0
    assert found["probe_share"] == pytest.approx(0.01, rel=1e-3)
    assert found["report_share"] == pytest.approx(0.002, rel=1e-3)
    assert found["utilisation"] == pytest.approx(0.5, rel=1e-3)


def test_without_arpd_only_the_link_is_judged():
    """A run without arpd has a queue and traffic, and no error."""
    found = estimate_figures(made_course(DROP, lambda _t: None), DROP)
    assert set(found) == {"peak_queue_s", "start_queue_s", "utilisation"}
