"""The figures of the benchmark of the real link, from made readings; real readings need the link."""

import json
from typing import Any

import pytest

from arpd.adapters.config.load import load_settings
from arpd.daemon.scenario import run as simulate
from arpd.report.status import status_document
from scripts.bench.link_course import MBIT, Belief, Instant, Run, Scenario, virtual_course, with_outages
from scripts.bench.link_figures import FIGURES, figures, gather
from scripts.bench.link_report import draw, save, table
from scripts.bench.link_sampler import BucketReading, believed, make_course
from scripts.robot.run import CONFIG

DROP = Scenario(name="drop", schedule="0:20mbit,12:5mbit", duration_s=35.0)
RISE = Scenario(name="rise", schedule="0:5mbit,12:20mbit", duration_s=35.0)
STEADY = Scenario(name="steady", schedule="0:20mbit", duration_s=35.0)
OUTAGE = Scenario(name="outage", schedule="0:20mbit", duration_s=35.0, outages=((12.0, 17.0),))


def belief(**changes):
    values: dict[str, Any] = dict.fromkeys(Belief.__slots__, 0.0) | {
        "estimate_bytes_per_second": 20 * MBIT,
        "budget_bytes_per_second": 17 * MBIT,
        "kind": "peer",
        "state": "steady",
        "generation": 1,
        "levels_by_cause": {"start": 1},
        "swaps": 12,
    }
    return Belief(**(values | changes))


def course_of(scenario, believe, *, queue_s=lambda _t: 0.01, sent=lambda t: round(t * MBIT * 10)):
    times = [round(0.1 * k, 1) for k in range(1, round(scenario.duration_s / 0.1) + 1)]
    instants = [
        Instant(
            t_s=t,
            truth_bytes_per_second=scenario.rates.rate_at(t),
            queue_delay_s=queue_s(t),
            carried_bytes=sent(t),
            belief=believe(t),
        )
        for t in times
    ]
    return with_outages(instants, scenario)


def test_readings_at_their_own_moments_come_to_one_grid():
    """An instant has its longest queue, the last rate, the bytes sent since the start, and a fresh belief."""
    buckets = [
        BucketReading(at_s=at_s, rate_bytes_per_second=rate, backlog_bytes=backlog, sent_bytes=sent)
        for at_s, rate, backlog, sent in (
            (99.99, 1000.0, 500, 70),  # before the start
            (100.03, 1000.0, 100, 80),
            (100.06, 1000.0, 300, 90),
            (100.09, 1000.0, 200, 100),
            (100.15, 500.0, 50, 110),
        )
    ]
    course = make_course(buckets, [(100.05, belief(swaps=7))], started_s=100.0, duration_s=0.8)
    assert [instant.t_s for instant in course] == pytest.approx([0.1 * k for k in range(1, 9)])
    assert [instant.queue_delay_s for instant in course[:3]] == pytest.approx([0.3, 0.1, 0.1])
    assert [instant.truth_bytes_per_second for instant in course[:2]] == [1000.0, 500.0]
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

    found = figures(course_of(DROP, believe), DROP)
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

    found = figures(course_of(DROP, believe, queue_s=lambda t: 0.4 if 12.2 < t < 12.6 else 0.02), DROP)
    assert found["reaction_s"] == pytest.approx(1.2)
    assert found["budget_s"] == pytest.approx(0.4)
    assert found["peak_queue_s"] == 0.4
    assert "rise_s" not in found


def test_what_never_happens_is_none():
    """An estimate that stays high has no reaction time, and one that stays low never rises."""
    assert figures(course_of(DROP, lambda _t: belief()), DROP)["reaction_s"] is None
    low = belief(estimate_bytes_per_second=5 * MBIT)
    assert figures(course_of(RISE, lambda _t: low), RISE)["rise_s"] is None


def test_the_rise_is_when_80_per_cent_are_known():
    """The rise ends at 80 % of 20 Mbit/s."""

    def believe(t):
        return belief(estimate_bytes_per_second=min(20.0, 5.0 + max(0.0, t - 12.0)) * MBIT)

    assert figures(course_of(RISE, believe), RISE)["rise_s"] == pytest.approx(11.0)


def test_an_outage_has_three_times():
    """They end when the budget is a tenth of what it was, when the estimate is back, and when the traffic is back."""

    def believe(t):
        return belief(
            budget_bytes_per_second=(1.6 if 12.4 <= t < 17.3 else 17.0) * MBIT,
            estimate_bytes_per_second=(12.0 if 17.0 <= t < 19.0 else 20.0) * MBIT,
        )

    def sent(t):
        return round(MBIT * 10 * (min(t, 12.0) + max(0.0, t - 18.0)))

    found = figures(course_of(OUTAGE, believe, sent=sent), OUTAGE)
    assert found["closed_s"] == pytest.approx(0.4)
    assert found["recovery_s"] == pytest.approx(2.0)
    assert found["traffic_back_s"] == pytest.approx(1.8)


def test_costs_are_counted_after_the_start_and_per_minute():
    """Plans and swaps of the first seconds do not count; probes and reports are shares of the truth."""

    def believe(t):
        return belief(
            levels_by_cause={"start": 1, "down": 1 if t > 20 else 0},
            swaps=12 if t > 9 else 0,
            probe_bytes=round(t * 0.01 * 20 * MBIT),
            report_bytes=round(t * 0.002 * 20 * MBIT),
        )

    found = figures(course_of(STEADY, believe), STEADY)
    minutes = 24.9 / 60.0
    assert found["levels_per_minute"] == pytest.approx(1 / minutes)
    assert found["swaps_per_minute"] == 0.0
    assert found["probe_share"] == pytest.approx(0.01, rel=1e-3)
    assert found["report_share"] == pytest.approx(0.002, rel=1e-3)
    assert found["utilisation"] == pytest.approx(0.5, rel=1e-3)


def test_without_arpd_only_the_link_is_judged():
    """A run without arpd has a queue and traffic, and no error."""
    found = figures(course_of(DROP, lambda _t: None), DROP)
    assert set(found) == {"peak_queue_s", "start_queue_s", "utilisation"}


def test_never_is_worse_than_any_number():
    """Never is the worst value; the worst bias is the largest, the worst utilisation the smallest."""
    assert gather([{"rise_s": 3.0}, {"rise_s": None}, {"rise_s": 2.0}], "rise_s") == (3.0, None)
    assert gather([{"rise_s": None}, {"rise_s": None}, {"rise_s": 2.0}], "rise_s") == (None, None)
    assert gather([{"bias": -0.2}, {"bias": 0.1}, {"bias": 0.05}], "bias") == (0.05, -0.2)
    assert gather([{"utilisation": 0.9}, {"utilisation": 0.7}], "utilisation") == pytest.approx((0.8, 0.7))
    assert gather([{}, {}], "rise_s") is None


@pytest.fixture(scope="module")
def virtual_runs():
    settings = load_settings(CONFIG, interfaces=None)
    return {
        is_managed: simulate(settings, STEADY.rates, 12.0, seed=1, managed=is_managed) for is_managed in (True, False)
    }


def test_a_simulated_run_has_the_same_form(virtual_runs):
    """The course of a run in virtual time has the fields of a real one, with levels counted by cause."""
    course = virtual_course(virtual_runs[True].moments, STEADY)
    last = course[-1].belief
    assert last is not None
    assert sum(last.levels_by_cause.values()) == len(virtual_runs[True].plans)
    assert last.swaps >= 12
    assert last.probe_bytes > 0
    assert all(instant.belief is None for instant in virtual_course(virtual_runs[False].moments, STEADY))


def test_the_report_shows_every_run(virtual_runs, tmp_path):
    """The table has a row for each figure, the picture is drawn, and the document has every run."""
    runs = [
        Run(
            scenario=STEADY.name,
            side=side,
            is_managed=is_managed,
            round=1,
            course=(course := virtual_course(result.moments, STEADY)),
            topics=result.topics,
            figures=figures(course, STEADY),
            load=0.0,
        )
        for side in ("real", "virtual")
        for is_managed, result in virtual_runs.items()
    ]
    text = table([STEADY], runs)
    assert all(FIGURES[name][0] in text for name in runs[0].figures)
    save({"commit": "abc"}, runs, tmp_path / "link.json")
    document = json.loads((tmp_path / "link.json").read_text())
    assert document["commit"] == "abc"
    assert [run["figures"] for run in document["runs"]] == [run.figures for run in runs]
    assert document["runs"][0]["truth_bytes_per_second"] == [[0.0, 20 * MBIT]]
    draw([STEADY], runs, tmp_path / "link.png")
    assert (tmp_path / "link.png").read_bytes().startswith(b"\x89PNG")
