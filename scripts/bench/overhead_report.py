"""The results of `overhead.py` for docs/results.md."""

from __future__ import annotations

from statistics import median
from typing import TYPE_CHECKING, Any

from scripts.bench.overhead_sides import AFTER, BEFORE
from scripts.bench.overhead_targets import (
    CONTROL,
    DEMO_TOPICS,
    MANY,
    MIB,
    PHASES,
    bytes_for_all,
    control,
    cpu,
    discovery_bytes,
    fitted,
    runs_of,
    spans_of,
    spread,
    verdicts,
)
from scripts.bench.record import described
from scripts.bench.report import markdown_table, percent

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from scripts.bench.overhead_targets import Run, Span

_COST_HEAD = [
    *("topics", "offered", "", "run CPU %", "peer CPU %", "relay CPU %", "run, peer, relay MiB"),
    *("link kB/s", "% of link"),
]
_PLAN_HEAD = [
    *("topics", "found", "planned", "confirmed", "price s", "plan s", "confirmed s"),
    *("swaps", "discovery kB", "to one process kB", "kB for all"),
]


def markdown(document: dict[str, Any]) -> str:
    """Return the block of docs/results.md: the cost of arpd, its plans, and its targets."""
    rates = document["rates_bytes_per_second"]
    sizes = sorted({run["topics"] for run in document["runs"]})
    rounds = max((len(runs_of(document, AFTER, topics)) for topics in sizes), default=0)
    sides = f"{document['before'][:12]} → this tree, by turns; " if document["before"] else ""
    return "\n".join(
        [
            (
                f"`scripts/bench/overhead.py` ({described(document)}); {sides}median (worst) of {rounds} rounds; CPU "
                f"in percent of one core; link {_mbit(rates['fast'])}, in *paced* {_mbit(rates['slow'])} Mbit/s; link "
                "bytes of run and peer, both ways."
            ),
            "",
            *markdown_table("rllr", _COST_HEAD, [row for topics in sizes for row in _costs(document, topics)]),
            "",
            _robots(document),
            "",
            (
                "Publishers that arpd finds, plans and confirms in the worst run, and when all are (found: from the "
                "start of run and peer; the others: from the first message). Then the seconds from the change of the "
                f"link, {_mbit(rates['fast'])} → {_mbit(rates['slow'])} Mbit/s. Discovery of a plan: all of the link, "
                "and what one process of the robot receives; for all: by the bytes per swap, if every topic is swapped."
            ),
            "",
            *markdown_table("r", _PLAN_HEAD, [_plans(document, topics) for topics in sizes]),
            "",
            *(f"- {sentence}" for sentence in [*verdicts(document), *_others(document)]),
        ]
    )


def _both(document: dict[str, Any], topics: int, say: Callable[[list[Run]], str]) -> str:
    """Return what both sides have; one of which every run failed has nothing."""
    said = []
    for side in (BEFORE, AFTER):
        runs = runs_of(document, side, topics)
        if runs:
            said.append(say(runs) or "–")
    return " → ".join(said) if set(said) != {"–"} else "–"


def _costs(document: dict[str, Any], topics: int) -> list[list[str]]:
    def cells(say: Callable[[list[Span]], str], phase: str) -> str:
        def of(runs: list[Run]) -> str:
            spans = spans_of(runs, phase)
            return say(spans) if spans else ""

        return _both(document, topics, of)

    def used(name: str) -> Callable[[list[Span]], str]:
        return lambda spans: spread([cpu(span, name) for span in spans], percent)

    rows = []
    run = next(run for run in document["runs"] if run["topics"] == topics)
    offered = f"{run['offered_hz']:.0f} Hz, {_mbit(run['offered_bytes_per_second'])} Mbit/s"
    for phase, words in PHASES.items():
        is_first = phase == next(iter(PHASES))
        rows.append(
            [
                *([str(topics), offered] if is_first else ["", ""]),
                words,
                *(cells(used(name), phase) for name in (*CONTROL, "relay")),
                cells(_memory, phase),
                cells(lambda spans: spread([control(span) for span in spans], _kilo), phase),
                cells(lambda spans: f"{100 * median(_of_link(span) for span in spans):.2f}", phase),
            ]
        )
    return rows


def _memory(spans: Sequence[Span]) -> str:
    """Return the most memory of run, of peer, and of any relay (MiB)."""
    most = (
        max(size for span in spans for name, size in span["rss_bytes"].items() if name.startswith(kind))
        for kind in (*CONTROL, "relay")
    )
    return ", ".join(f"{size / MIB:.0f}" for size in most)


def _of_link(span: Span) -> float:
    return control(span) / float(span["link_bytes_per_second"])


def _plans(document: dict[str, Any], topics: int) -> list[str]:
    def counted(what: str) -> str:
        def of(runs: list[Run]) -> str:
            number = min(run.get(what, 0) for run in runs)
            after = spread([run.get(f"{what}_s") for run in runs], "{:.1f} s".format)
            return f"{number}, {after}" if number >= topics else str(number)

        return _both(document, topics, of)

    def fall(key: str, form: str) -> str:
        def of(runs: list[Run]) -> str:
            found = [plan[key] for run in runs for plan in run["plans"] if plan["cause"] == "fall"]
            return spread(found, form.format)

        return _both(document, topics, of)

    def spent(where: str) -> str:
        def of(runs: list[Run]) -> str:
            return spread([discovery_bytes(run, plan, where) for run in runs for plan in run["plans"]], _kilo)

        return _both(document, topics, of)

    def for_all(runs: list[Run]) -> str:
        found = bytes_for_all(runs)
        return "" if found is None else _kilo(found)

    return [
        str(topics),
        *map(counted, ("found", "planned", "confirmed")),
        fall("price_s", "{:.2f}"),
        fall("plan_s", "{:.1f}"),
        fall("confirmed_s", "{:.1f}"),
        _both(
            document,
            topics,
            lambda runs: spread([float(plan["swaps"]) for run in runs for plan in run["plans"]], "{:.0f}".format),
        ),
        spent("discovery_bytes"),
        spent("listener_bytes"),
        _both(document, topics, for_all),
    ]


def _others(document: dict[str, Any]) -> list[str]:
    """Return the plans and swaps while nothing changes, the exponent before, failures and doubts."""
    said = []
    spans = [span for run in document["runs"] if run["side"] == AFTER for span in run["spans"]]
    busy = [span for span in spans if span["phase"] != "rest"]
    plans, swaps = (sum(span[key] for span in busy) for key in ("plans", "swaps"))
    said.append(f"Within the {len(busy)} measured spans under load: {plans} plans, {swaps:.0f} swaps.")
    for side in (AFTER, BEFORE):
        slopes = {"all": fitted(document, side), f"from {MANY} on": fitted(document, side, least_topics=MANY)}
        words = [f"{slope:.2f} ({which})" for which, slope in slopes.items() if slope is not None]
        if words:
            said.append(f"Exponents over the numbers of topics, {side}: {', '.join(words)}.")
    for run in [*document["runs"], *filter(None, [document.get("steady")])]:
        where = f"{run['topics']} topics, {run['side']}"
        if "failed" in run:
            said.append(f"{where}: failed: {run['failed']}.")
        said += [f"{where}: failed: {complaint}." for complaint in run.get("complaints", ())]
    return list(dict.fromkeys(said))


def _robots(document: dict[str, Any]) -> str:
    """Return what the robots publish."""
    kinds = {run["topics"]: run for run in document["runs"]}
    alike = [
        f"{run['topics']} of {run['least_payload_bytes']} B at {run['offered_hz'] / run['topics']:g} Hz"
        for _, run in sorted(kinds.items())
        if run["topics"] != DEMO_TOPICS
    ]
    others = f" The others: {', '.join(alike)} each." if alike else ""
    most = max(kinds.values(), key=lambda run: run["relays"])
    relays = (
        f" {most['topics']} topics take {most['relays']} relays, whose CPU is added; memory is that of the largest."
        if most["relays"] > 1
        else ""
    )
    return f"{DEMO_TOPICS} topics are the demo robot's.{others}{relays}"


def _kilo(value: float) -> str:
    return f"{value / 1e3:.1f}"


def _mbit(bytes_per_second: float) -> str:
    return f"{bytes_per_second * 8e-6:.3g}"
