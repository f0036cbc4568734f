"""What `overhead.py` measured, as tables, and whether it is what it must be."""

from __future__ import annotations

from statistics import median
from typing import TYPE_CHECKING, Any

from scripts.bench.record import described

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

TARGET_TOPICS = 12
MOST_CPU_SHARE, MOST_RSS_BYTES, MOST_LINK_SHARE = 0.03, 110 * 2**20, 0.01
_CONTROL = ("run", "peer")
_PHASES = {"rest": "at rest", "load": "all carried", "paced": "paced"}
_MIB = 2**20


def table(document: dict[str, Any]) -> str:
    """Return everything as text, for a terminal."""
    rows = [_COST_HEAD, *_cost_rows(document)]
    lines = _aligned([[cell.replace("`", "") for cell in row] for row in rows])
    if reactions := _reaction_rows(document):
        lines += ["", *_aligned([_REACTION_HEAD, *reactions])]
    return "\n".join([*lines, "", *verdicts(document), *_unsettled(document), _without(document)])


def markdown(document: dict[str, Any]) -> str:
    """Return the block of docs/results.md: what arpd costs, how soon a plan follows the link, and what falls short."""
    rates = document["rates_bytes_per_second"]
    parts = [
        (
            f"`scripts/bench/overhead.py` ({described(document)}); CPU in percent of one core, median (worst) of "
            f"the spans; link {_mbit(rates['fast'])}, in *paced* {_mbit(rates['slow'])} Mbit/s; "
            "link bytes of run and peer, both ways."
        ),
        "",
        *_markdown([_COST_HEAD, *_cost_rows(document)], words=3),
        "",
        _robots(document),
    ]
    if reactions := _reaction_rows(document):
        parts += [
            "",
            "Seconds from the change of the link, median (worst):",
            "",
            *_markdown([_REACTION_HEAD, *reactions], words=2),
        ]
    said = [*verdicts(document), *_unsettled(document), *_failed(document), _without(document)]
    return "\n".join([*parts, "", *(f"- {sentence}" for sentence in said)])


def _failed(document: dict[str, Any]) -> list[str]:
    """Say which robots could not be measured, and why."""
    return [f"Not measured: {failure['why']}." for failure in document.get("failures", ())]


def verdicts(document: dict[str, Any]) -> list[str]:
    """Say of every target whether it is met with twelve topics, and what takes the most where it is not."""
    found = [case for case in document["cases"] if case["topics"] == TARGET_TOPICS]
    if not found:
        return [f"No target is judged: none of the robots had {TARGET_TOPICS} topics."]
    (case,) = found
    said = [
        _judged(
            f"CPU of run and peer with {TARGET_TOPICS} topics, {words}",
            median(_cpu(span, *_CONTROL) for span in spans),
            MOST_CPU_SHARE,
            lambda share: f"{share:.1%} of a core",
            why=_most({name: median(span["cpu_share"][name] for span in spans) for name in _CONTROL}, "{:.1%}"),
        )
        for phase, words in _PHASES.items()
        if (spans := _spans(case, phase))
    ]
    memory = {name: max(s["rss_bytes"][name] for s in _managed(case)) for name in _CONTROL}
    said.append(
        _judged(
            "RSS of run and of peer, each",
            max(memory.values()),
            MOST_RSS_BYTES,
            lambda size: f"at most {size / _MIB:.0f} MiB",
            why=_most({name: size / _MIB for name, size in memory.items()}, "{:.0f} MiB"),
        )
    )
    loaded = any(span["has_cvxpy"] for case in document["cases"] for span in case["spans"])
    said.append("cvxpy: loaded in a process; missed." if loaded else "cvxpy: loaded in no process; met.")
    said += [
        _judged(
            f"Bytes of run and peer on the link with {TARGET_TOPICS} topics, {words}",
            median(_control(span) / span["link_bytes_per_second"] for span in spans),
            MOST_LINK_SHARE,
            lambda share: f"{share:.2%} of {_mbit(spans[0]['link_bytes_per_second'])} Mbit/s",
            why=_most(_by_kind(spans), "{:.1f} kB/s"),
        )
        for phase, words in _PHASES.items()
        if (spans := _spans(case, phase))
    ]
    return said


_COST_HEAD = [
    *("topics", "offered", "", "run CPU %", "peer CPU %", "relay CPU %", "run, peer, relay MiB"),
    *("link kB/s", "% of link", "% of topics"),
]
_REACTION_HEAD = ["topics", "link", "gate", "plan", "last publisher confirmed", "plans"]


def _cost_rows(document: dict[str, Any]) -> list[list[str]]:
    rows = []
    for case in document["cases"]:
        for phase, words in _PHASES.items():
            spans = _spans(case, phase)
            if not spans:
                continue
            relays = [name for name in spans[0]["cpu_share"] if name.startswith("relay")]
            memory = (max(max(span["rss_bytes"][n] for n in names) for span in spans) for names in _groups(relays))
            is_first = phase == next(iter(_PHASES))
            rows.append(
                [
                    str(case["topics"]) if is_first else "",
                    f"{case['offered_hz']:.0f} Hz, {_mbit(case['offered_bytes_per_second'])} Mbit/s"
                    if is_first
                    else "",
                    words,
                    *(
                        _spread([_cpu(span, *names) for span in spans], lambda share: f"{100 * share:.1f}")
                        for names in _groups(relays)
                    ),
                    ", ".join(f"{size / _MIB:.0f}" for size in memory),
                    _spread([_control(span) for span in spans], lambda rate: f"{rate / 1e3:.1f}"),
                    f"{100 * median(_control(span) / span['link_bytes_per_second'] for span in spans):.2f}",
                    _of_topics(spans),
                ]
            )
    return rows


def _groups(relays: Sequence[str]) -> list[list[str]]:
    return [*([name] for name in _CONTROL), list(relays)]


def _of_topics(spans: Sequence[dict[str, Any]]) -> str:
    """Return the control plane's bytes in percent of what else is on the link; nothing is at rest."""
    if not all(span["sent"] for span in spans):
        return ""
    shares = [_control(span) / (span["interface_bytes_per_second"] - _control(span)) for span in spans]
    return f"{100 * median(shares):.2f}"


def _reaction_rows(document: dict[str, Any]) -> list[list[str]]:
    rows = []
    for case in document["cases"]:
        for is_fall in (True, False):
            found = [r for r in case["reactions"] if (r["to_bytes_per_second"] < r["from_bytes_per_second"]) == is_fall]
            if not found:
                continue
            ends = (found[0][key] for key in ("from_bytes_per_second", "to_bytes_per_second"))
            rows.append(
                [
                    str(case["topics"]) if is_fall else "",
                    " → ".join(map(_mbit, ends)),
                    # A rise needs no gate: what holds the topics back is the plan.
                    _spread([r["gate_s"] for r in found], lambda s: f"{s:.2f}") if is_fall else "",
                    *(_spread([r[key] for r in found], lambda s: f"{s:.1f}") for key in ("plan_s", "confirmed_s")),
                    _spread([float(r["plans"]) for r in found], lambda count: f"{count:.0f}"),
                ]
            )
    return rows


def _unsettled(document: dict[str, Any]) -> list[str]:
    """Name the robots of which no plan was confirmed by everybody."""
    found = [str(case["topics"]) for case in document["cases"] if case["settled_s"] is None]
    many = " and ".join(found)
    return [f"With {many} topics no plan was ever confirmed by all publishers: no reaction times."] if found else []


def _robots(document: dict[str, Any]) -> str:
    """Say what the robots publish."""
    alike = [
        f"{case['topics']} of {case['least_payload_bytes']} B at {case['offered_hz'] / case['topics']:g} Hz"
        for case in document["cases"]
        if case["topics"] != TARGET_TOPICS
    ]
    others = f" The others: {', '.join(alike)} each." if alike else ""
    most = max(document["cases"], key=lambda case: case["relays"])
    relays = (
        f" {most['topics']} topics take {most['relays']} relays, whose CPU is added; memory is that of the largest."
        if most["relays"] > 1
        else ""
    )
    return f"{TARGET_TOPICS} topics are the demo robot's.{others}{relays}"


def _without(document: dict[str, Any]) -> str:
    """Hold what was attributed to run and peer at rest against what the interface carries without them."""
    said = []
    for case in document["cases"]:
        without, rest = _spans(case, "rest without"), _spans(case, "rest")
        if without and rest:
            rates = (without[0]["interface_bytes_per_second"], rest[0]["interface_bytes_per_second"])
            more, attributed = rates[1] - rates[0], _control(rest[0])
            said.append(f"{case['topics']} topics {more / 1e3:.1f} and {attributed / 1e3:.1f}")
    return (
        "At rest, kB/s that the interfaces carry more than without run and peer, and that are attributed to them: "
        + "; ".join(said)
        + "."
    )


def _spans(case: dict[str, Any], phase: str) -> list[dict[str, Any]]:
    return [span for span in case["spans"] if span["phase"] == phase]


def _managed(case: dict[str, Any]) -> list[dict[str, Any]]:
    return [span for span in case["spans"] if "run" in span["cpu_share"]]


def _cpu(span: dict[str, Any], *names: str) -> float:
    return float(sum(span["cpu_share"][name] for name in names))


def _control(span: dict[str, Any]) -> float:
    return float(sum(span["control_bytes_per_second"].values()))


def _by_kind(spans: Sequence[dict[str, Any]]) -> dict[str, float]:
    kinds = spans[0]["control_bytes_per_second"]
    return {kind: median(span["control_bytes_per_second"][kind] for span in spans) / 1e3 for kind in kinds}


def _judged(what: str, value: float, most: float, show: Callable[[float], str], *, why: str) -> str:
    if value <= most:
        return f"{what}: {show(value)}; met."
    return f"{what}: {show(value)}; missed ({why})."


def _most(parts: dict[str, float], form: str) -> str:
    ranked = sorted(parts.items(), key=lambda part: -part[1])
    return ", ".join(f"{name} {form.format(value)}" for name, value in ranked)


def _spread(values: Sequence[float | None], show: Callable[[float], str]) -> str:
    """Median and worst; what never came is worse than anything."""
    known = sorted(value for value in values if value is not None)
    if len(known) < len(values):
        return f"never in {len(values) - len(known)} of {len(values)}"
    middle, worst = show(median(known)), show(known[-1])
    return middle if len(known) == 1 or middle == worst else f"{middle} ({worst})"


def _mbit(bytes_per_second: float) -> str:
    return f"{bytes_per_second * 8e-6:.3g}"


def _markdown(rows: Sequence[Sequence[str]], *, words: int) -> list[str]:
    """Return a table whose first columns, but for the very first, are words."""
    head, *body = rows
    rule = "|" + "|".join("---" if 0 < k < words else "---:" for k in range(len(head))) + "|"
    return [f"| {' | '.join(head)} |", rule, *(f"| {' | '.join(row)} |" for row in body)]


def _aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return ["  ".join(f"{cell:>{width}}" for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]
