"""Metrics of counts and durations since the daemon started; attempts and failures are counted apart."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

from prometheus_client.core import CounterMetricFamily

from arpd.model.settings import Backend
from arpd.report.events import EventKind
from arpd.web.families import counter_by, histogram, histogram_by

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from prometheus_client.metrics_core import Metric

    from arpd.report.durations import Distribution
    from arpd.report.snapshot import Totals

_OK = "ok"

# Known label values start at zero, so that rate() sees their first increase.
_CAUSES = ("budget", "demand", "down", "memory", "readers", "reload", "start", "takeover", "topics", "up")
_REASONS = ("budget", "dwell")
_NOT_APPLIED = ("refused", "timeout")
_OUTCOMES = ("disagreed", "failed", "solved")
_EFFECTS = ("awaiting_restart", "in_force")

_COUNTERS: tuple[tuple[str, str, Callable[[Totals], float]], ...] = (
    (
        "arpd_ticks",
        "Ticks: each observes, estimates and sends the price; two a second also plan.",
        lambda t: t.ticks + t.ticks_failed,
    ),
    (
        "arpd_tick_failures",
        "Ticks that raised an error; the plan in force stays and the journal has the error.",
        lambda t: t.ticks_failed,
    ),
    ("arpd_ticks_late", "Ticks that began more than half a period late.", lambda t: t.ticks_late),
    (
        "arpd_cross_check_disagreements",
        "Answers of a solver that missed the budget by more than a millionth; the closed form answered instead.",
        lambda t: t.cross_check_disagreements,
    ),
    ("arpd_probes", "Probe trains and pings sent over the link.", lambda t: t.probes),
    ("arpd_probe_bytes", "Wire bytes of the probes.", lambda t: t.probe_bytes),
    ("arpd_peer_reports", "Reports of peers that arrived.", lambda t: t.reports),
    ("arpd_applies", "Plans sent to nodes, repeats included.", lambda t: sum(t.applies_by_result.values())),
    ("arpd_config_reloads", "Attempts to reload the configuration.", lambda t: sum(t.reloads_by_result.values())),
    (
        "arpd_config_reload_failures",
        "Reloads refused because the file was wrong or unreadable; the old configuration stayed in force.",
        lambda t: sum(_failed(t.reloads_by_result).values()),
    ),
)

_COUNTERS_BY: tuple[tuple[str, str, str, tuple[str, ...], Callable[[Totals], Mapping[str, int]]], ...] = (
    ("arpd_events", "Lines of the decision log.", "event", tuple(EventKind), lambda t: t.events_by_kind),
    ("arpd_plans", "Plans made.", "cause", _CAUSES, lambda t: t.plans_by_cause),
    (
        "arpd_refusals",
        "Plans and swaps that were due and had to wait.",
        "reason",
        _REASONS,
        lambda t: t.refusals_by_reason,
    ),
    (
        "arpd_apply_failures",
        "Plans that a node refused or did not answer; arpd repeats them.",
        "reason",
        _NOT_APPLIED,
        lambda t: _failed(t.applies_by_result),
    ),
    (
        "arpd_config_changed_keys",
        "Keys that reloads changed, in force at once or after a restart.",
        "effect",
        _EFFECTS,
        lambda t: t.changed_keys_by_effect,
    ),
    (
        "arpd_solves",
        "Solves of the program, one for the link and one for memory; closed_form answers when another back end fails.",
        "backend",
        tuple(Backend),
        lambda t: _solves(t, *_OUTCOMES),
    ),
    (
        "arpd_solve_failures",
        "Solves without an answer; the closed form answered instead.",
        "backend",
        tuple(Backend),
        lambda t: _solves(t, "failed"),
    ),
)

_HISTOGRAMS: tuple[tuple[str, str, Callable[[Totals], Distribution]], ...] = (
    ("arpd_tick_duration_seconds", "Duration of finished ticks.", lambda t: t.durations.ticks),
    (
        "arpd_tick_lateness_seconds",
        "Delay after the planned time at which ticks began; above 0.05 counts as late.",
        lambda t: t.durations.lateness,
    ),
    (
        "arpd_solve_duration_seconds",
        "Duration of solves of the whole program; a tick that brings nothing new needs none.",
        lambda t: t.durations.solves,
    ),
)


def total_metrics(totals: Totals) -> Iterator[Metric]:
    """Yield the families in a fixed order, their series sorted by label."""
    for name, text, read in _COUNTERS:
        yield CounterMetricFamily(name, text, value=read(totals))
    for name, text, label, known, read_by in _COUNTERS_BY:
        yield counter_by(name, text, label, known, (({}, read_by(totals)),))
    for name, text, read_distribution in _HISTOGRAMS:
        yield histogram(name, text, read_distribution(totals))
    yield histogram_by(
        "arpd_swap_phase_duration_seconds",
        "Time that finished writer swaps of all publishers spent in each phase they entered.",
        "phase",
        totals.durations.swap_phases,
    )


def _failed(counts: Mapping[str, int]) -> Counter[str]:
    return Counter({result: count for result, count in counts.items() if result != _OK})


def _solves(totals: Totals, *outcomes: str) -> Counter[str]:
    counts: Counter[str] = Counter()
    for (backend, outcome), count in totals.solves_by_outcome.items():
        if outcome in outcomes:
            counts[backend] += count
    return counts
