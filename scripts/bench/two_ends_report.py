"""The results of `two_ends.py` as tables for docs/results.md."""

from __future__ import annotations

from statistics import median
from typing import TYPE_CHECKING, Any

from scripts.bench.record import described
from scripts.bench.report import markdown_table

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

_HEAD = (
    "writer",
    "sent",
    "received",
    "withheld by pacing",
    "while the near end was dead",
    "while the far end was dead",
    "lost",
    "doubled",
    "out of order",
    "flows again after",
)


def markdown(document: dict[str, Any]) -> str:
    """Return the conditions, and a table of the samples and of all other figures."""
    if "addresses" in document:
        return _addresses(document)
    parts = [f"{document['minutes']:g} minutes ({described(document)}): {_events(document['events'])}."]
    parts += ["", *markdown_table("lrrrrrrrrr", [*_HEAD], list(_streams(document)))]
    rows = [*_sets(document["sets"]), *_demand(document["demand"]), *_latched(document["latched"])]
    rows += [row for kind, one in document["calls"].items() for row in _calls(kind, one)]
    rows += [("processes that ended themselves", "; ".join(document["ended_themselves"]) or "none"), _logs(document)]
    return "\n".join([*parts, "", *markdown_table("l", ["", ""], rows)])


def _addresses(document: dict[str, Any]) -> str:
    rows = []
    for one in document["addresses"]:
        ended = ", ".join(f"{name} {at_s:.1f} s" for name, at_s in one["ended_s"].items()) or "none"
        after = one.get("after_nodes")
        rows.append(
            (one["host"], ended, _again(one), "yes" if one["is_visible"] else "no", _again(after) if after else "")
        )
    head = [
        "new address of the",
        "processes that ended themselves, after",
        "all topics flow again after",
        "a new plain process sees its host's nodes",
        "with these nodes started again, all topics flow after",
    ]
    return "\n".join([f"{described(document)}:", "", *markdown_table("llrlr", head, rows)])


def _again(one: dict[str, Any]) -> str:
    return "not: " + ", ".join(one["silent"]) if one["again_s"] is None else f"{one['again_s']:.1f} s"


def _events(events: dict[str, int]) -> str:
    return ", ".join(f"{count} × {kind}" for kind, count in events.items())


def _streams(document: dict[str, Any]) -> Iterable[tuple[str, ...]]:
    for topic, one in document["topics"].items():
        for each in one["writers"]:
            yield _row(each["writer"], each, one, is_only=len(one["writers"]) == 1)
        if len(one["writers"]) > 1:
            yield (f"{topic}, together", "", "", str(one["withheld"]), "", "", str(one["lost"]), "", "", "")
    yield _row("sets of three", document["sets"], document["sets"], is_only=True)


def _row(name: str, each: dict[str, Any], one: dict[str, Any], *, is_only: bool) -> tuple[str, ...]:
    again = f"{max(each['again_s']):.1f} s" if each["again_s"] else "–"
    if each["never_again"]:
        again += f", {each['never_again']} × not"
    return (
        name,
        f"{each['sent']:,}",
        f"{each['received']:,}",
        str(one["withheld"]) if is_only else "",
        str(each["while_near_dead"]),
        str(each["while_far_dead"]),
        str(one["lost"]) if is_only else "",
        str(each["doubled"]),
        str(each["reordered"]),
        again,
    )


def _sets(sets: dict[str, Any]) -> list[tuple[str, str]]:
    text = f"{sets['incomplete']} of {sets['received'] + sets['incomplete']:,} incomplete"
    if sets["incomplete"]:
        text += f", {sets['incomplete_beside_a_death']} of these as an end died"
    return [("sets with one stamp that arrived", text)]


def _demand(visits: Sequence[dict[str, Any]]) -> list[tuple[str, str]]:
    groups = {
        "no loss": [visit for visit in visits if not visit["meanwhile"] and not visit["is_lossy"]],
        "1 % loss": [visit for visit in visits if not visit["meanwhile"] and visit["is_lossy"]],
        "an outage or a kill meanwhile or up to 5 s before": [visit for visit in visits if visit["meanwhile"]],
    }
    rows = []
    for words, group in groups.items():
        waited = sorted(visit["waited_s"] for visit in group if visit["waited_s"] is not None)
        value = f"median {median(waited):.2f} s, longest {waited[-1]:.2f} s of {len(group)}" if waited else "–"
        if len(waited) < len(group):
            value += f"; {len(group) - len(waited)} without a sample in 15 s"
        rows.append((f"first sample of a topic that nobody read before, {words}", value))
    return rows


def _latched(visits: Sequence[dict[str, Any]]) -> list[tuple[str, str]]:
    lacking = [visit for visit in visits if visit["lacks"]]
    value = f"{len(visits) - len(lacking)} of {len(visits)}"
    if lacking:
        meanwhile = sum(bool(visit["meanwhile"]) for visit in lacking)
        value += f"; {meanwhile} of the others beside an outage or a kill"
    return [("late readers of a latched topic that got the newest sample of both its writers", value)]


def _calls(kind: str, one: dict[str, Any]) -> list[tuple[str, str]]:
    words = {"calls": "service calls", "goals": "action goals"}[kind]
    value = f"{one['answered']} answered, {one['failed']} failed ({one['failed_meanwhile']} of these "
    value += f"begun as the ends did not hear each other), {one['both']} both, {one['neither']} neither"
    if one["median_s"] is not None:
        value += f"; median {one['median_s']:.2f} s, longest {one['longest_s']:.1f} s"
    faults = ("answered_twice", "wrong", "ran_twice", "answered_but_never_ran")
    found = ", ".join(f"{one[fault]} {fault.replace('_', ' ')}" for fault in faults)
    return [
        (f"{one['made']:,} {words} from the CEDDP", value),
        (f"the same {words}, faults", f"{found}; {one['failed_but_ran']} of the failed ones ran"),
    ]


def _logs(document: dict[str, Any]) -> tuple[str, str]:
    counts = {name: sum(lines.values()) for name, lines in document["log"].items()}
    return ("log lines at WARNING and above", ", ".join(f"{name} {count}" for name, count in counts.items()))
