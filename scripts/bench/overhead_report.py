"""The results of `overhead.py` for docs/results.md, and its targets."""

from __future__ import annotations

from statistics import median
from typing import TYPE_CHECKING, Any

from scripts.bench.record import described
from scripts.bench.report import markdown_table, percent

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

TARGET_TOPICS = 12
MOST_CPU_SHARE, MOST_RSS_BYTES, MOST_LINK_SHARE = 0.03, 110 * 2**20, 0.01
_CONTROL = ("run", "peer")
_PHASES = {"rest": "at rest", "load": "all carried", "paced": "paced"}
_MIB = 2**20


def markdown(document: dict[str, Any]) -> str:
    """Return the block of docs/results.md: the cost of arpd, its reaction times, and its targets."""
    rates = document["rates_bytes_per_second"]
    parts = [
        (
            f"`scripts/bench/overhead.py` ({described(document)}); CPU in percent of one core, median (worst) of "
            f"the spans; link {_mbit(rates['fast'])}, in *paced* {_mbit(rates['slow'])} Mbit/s; "
            "link bytes of run and peer, both ways."
        ),
        "",
        *markdown_table("rllr", _COST_HEAD, _cost_rows(document)),
        "",
        _robots(document),
    ]
    if reactions := _reaction_rows(document):
        table_of = markdown_table("rlr", _REACTION_HEAD, reactions)
        parts += ["", "Seconds from the change of the link, median (worst):", "", *table_of]
    failed = [f"Not measured: {failure['why']}." for failure in document.get("failures", ())]
    sentences = [*verdicts(document), *_unsettled(document), *failed, _without(document)]
    return "\n".join([*parts, "", *(f"- {sentence}" for sentence in sentences)])


def verdicts(document: dict[str, Any]) -> list[str]:
    """Return for every target whether twelve topics meet it; for a missed one, its parts, the largest first."""
    found = [case for case in document["cases"] if case["topics"] == TARGET_TOPICS]
    if not found:
        return [f"No target is judged: no robot had {TARGET_TOPICS} topics."]
    (case,) = found
    cpu, link = [], []
    for phase, words in _PHASES.items():
        if spans := _spans(case, phase):
            what = f"CPU of run and peer with {TARGET_TOPICS} topics, {words}"
            used = median(_cpu(span, *_CONTROL) for span in spans)
            parts = {name: median(span["cpu_share"][name] for span in spans) for name in _CONTROL}
            cpu.append(_judged(what, used, MOST_CPU_SHARE, "{:.1%} of a core", parts, part="{:.1%}"))
            what = f"Bytes of run and peer on the link with {TARGET_TOPICS} topics, {words}"
            share = median(_control(span) / span["link_bytes_per_second"] for span in spans)
            form = f"{{:.2%}} of {_mbit(spans[0]['link_bytes_per_second'])} Mbit/s"
            link.append(_judged(what, share, MOST_LINK_SHARE, form, _by_kind(spans), part="{:.1f} kB/s"))
    managed = [span for span in case["spans"] if "run" in span["cpu_share"]]
    mib = {name: max(span["rss_bytes"][name] for span in managed) / _MIB for name in _CONTROL}
    most = MOST_RSS_BYTES / _MIB
    memory = _judged(
        "RSS of run and of peer, each", max(mib.values()), most, "at most {:.0f} MiB", mib, part="{:.0f} MiB"
    )
    has_cvxpy = any(span["has_cvxpy"] for case in document["cases"] for span in case["spans"])
    cvxpy = "cvxpy: loaded in a process; missed." if has_cvxpy else "cvxpy: loaded in no process; met."
    return [*cpu, memory, cvxpy, *link]


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
            groups = [*([name] for name in _CONTROL), [n for n in spans[0]["cpu_share"] if n.startswith("relay")]]
            memory = (max(max(span["rss_bytes"][n] for n in names) for span in spans) for names in groups)
            offered = f"{case['offered_hz']:.0f} Hz, {_mbit(case['offered_bytes_per_second'])} Mbit/s"
            is_first = phase == next(iter(_PHASES))
            rows.append(
                [
                    *([str(case["topics"]), offered] if is_first else ["", ""]),
                    words,
                    *(_spread([_cpu(span, *names) for span in spans], percent) for names in groups),
                    ", ".join(f"{size / _MIB:.0f}" for size in memory),
                    _spread([_control(span) for span in spans], lambda rate: f"{rate / 1e3:.1f}"),
                    f"{100 * median(_control(span) / span['link_bytes_per_second'] for span in spans):.2f}",
                    _of_topics(spans),
                ]
            )
    return rows


def _of_topics(spans: Sequence[dict[str, Any]]) -> str:
    """Return the control plane's bytes in percent of all others on the link; empty at rest."""
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
                    # A rise needs no gate: the plan limits the topics.
                    _spread([r["gate_s"] for r in found], lambda s: f"{s:.2f}") if is_fall else "",
                    *(_spread([r[key] for r in found], lambda s: f"{s:.1f}") for key in ("plan_s", "confirmed_s")),
                    _spread([float(r["plans"]) for r in found], lambda count: f"{count:.0f}"),
                ]
            )
    return rows


def _unsettled(document: dict[str, Any]) -> list[str]:
    """Name the robots whose publishers never all confirmed a plan."""
    many = " and ".join(str(case["topics"]) for case in document["cases"] if case["settled_s"] is None)
    return [f"With {many} topics the publishers never all confirmed a plan: no reaction times."] if many else []


def _robots(document: dict[str, Any]) -> str:
    """Return what the robots publish."""
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
    """Compare the bytes attributed to run and peer at rest with those that the interfaces carry more with them."""
    cases = []
    for case in document["cases"]:
        without, rest = _spans(case, "rest without"), _spans(case, "rest")
        if without and rest:
            rates = (without[0]["interface_bytes_per_second"], rest[0]["interface_bytes_per_second"])
            more, attributed = rates[1] - rates[0], _control(rest[0])
            cases.append(f"{case['topics']} topics {more / 1e3:.1f} and {attributed / 1e3:.1f}")
    return (
        "At rest, kB/s that the interfaces carry more than without run and peer, and that are attributed to them: "
        f"{'; '.join(cases)}."
    )


def _spans(case: dict[str, Any], phase: str) -> list[dict[str, Any]]:
    return [span for span in case["spans"] if span["phase"] == phase]


def _cpu(span: dict[str, Any], *names: str) -> float:
    return float(sum(span["cpu_share"][name] for name in names))


def _control(span: dict[str, Any]) -> float:
    return float(sum(span["control_bytes_per_second"].values()))


def _by_kind(spans: Sequence[dict[str, Any]]) -> dict[str, float]:
    kinds = spans[0]["control_bytes_per_second"]
    return {kind: median(span["control_bytes_per_second"][kind] for span in spans) / 1e3 for kind in kinds}


def _judged(what: str, value: float, most: float, form: str, parts: dict[str, float], *, part: str) -> str:
    """Judge a value, written as ``form`` has it; a missed target names its parts, the largest first."""
    ranked = sorted(parts.items(), key=lambda part: -part[1])
    why = ", ".join(f"{name} {part.format(size)}" for name, size in ranked)
    return f"{what}: {form.format(value)}; {'met' if value <= most else f'missed ({why})'}."


def _spread(values: Sequence[float | None], show: Callable[[float], str]) -> str:
    """Return median and worst; a value that never came is the worst."""
    known = sorted(value for value in values if value is not None)
    if len(known) < len(values):
        return f"never in {len(values) - len(known)} of {len(values)}"
    middle, worst = show(median(known)), show(known[-1])
    return middle if len(known) == 1 or middle == worst else f"{middle} ({worst})"


def _mbit(bytes_per_second: float) -> str:
    return f"{bytes_per_second * 8e-6:.3g}"
