"""What `two_ends.py` found, from what each process and arpd's status said, and its report for docs/results.md."""

from __future__ import annotations

from dataclasses import dataclass, field
from statistics import median
from typing import TYPE_CHECKING, Any

from scripts.bench.record import described
from scripts.bench.reliability_figures import loud_lines
from scripts.bench.report import paragraphs, table
from scripts.bench.two_ends_account import Death, Reading, gaps, reachable, row, sets_of, unfolded
from scripts.bench.two_ends_calls import summary
from scripts.bench.two_ends_nodes import DEMAND, LATCHED, SET_TOPICS, STREAMS, VISIT_S

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    Readings = Mapping[tuple[str, str], Sequence[Reading]]  # by topic and host


_SERVICES_S = 1.0  # a call before a kill may be under way that long, and services may follow topics that late


@dataclass(slots=True)
class Course:
    """Everything that happened in a run.

    Parameters
    ----------
    deaths : kills of both ends
    disturbed : name, begin and end of each kill and outage (monotonic s)
    lossy_from_s : when the link began to lose packets (monotonic s)
    ended : processes that ended themselves
    """

    deaths: list[Death] = field(default_factory=list)
    disturbed: list[tuple[str, float, float]] = field(default_factory=list)
    lossy_from_s: float = float("inf")
    ended: list[str] = field(default_factory=list)

    def lasting_deaths(self) -> list[Death]:
        """Return the deaths, each until the other end could be reached again."""
        outages = [(begin_s, over_s) for what, begin_s, over_s in self.disturbed if what == "outage"]
        return [reachable(death, outages) for death in self.deaths]


def topics_of(found: dict[str, Any], readings: Readings, deaths: Sequence[Death]) -> dict[str, dict[str, Any]]:
    """Return what became of the samples of each topic, by topic and the writers' host."""
    other = {"robot": "ceddp", "ceddp": "robot"}
    rows = {}
    for topic, host in dict.fromkeys((stream.topic, stream.host) for stream in STREAMS):
        names = [stream.name for stream in STREAMS if (stream.topic, stream.host) == (topic, host)]
        noted = found[other[host]]["streams"]
        writers = [(name, found[host]["sent_s"][name], noted[name]) for name in names]
        rows[f"{topic} from the {host}"] = row(writers, readings[topic, host], deaths, host=host)
    return rows


def sets_of_three(found: dict[str, Any], readings: Readings, deaths: Sequence[Death]) -> dict[str, Any]:
    """Return what became of the sets, as of the samples of one writer."""
    noted = [found["ceddp"]["sets"][topic] for topic in SET_TOPICS]
    sent_s = found["robot"]["sets_s"]
    complete, partial = sets_of([unfolded(each["spans"]) for each in noted])
    of_sets = readings[SET_TOPICS[0], "robot"]
    as_one = {"spans": [[number, number] for number in sorted(complete)], "doubled": 0, "late": 0}
    one = row([("sets", sent_s, as_one)], of_sets, deaths, host="robot")
    (whole,) = one.pop("writers")
    whole["doubled"] = sum(each["doubled"] for each in noted)
    whole["reordered"] = sum(each["late"] for each in noted)
    around = gaps(sent_s, complete, deaths, "robot")
    beside = [n for n in partial if any(gap.begin_s < sent_s[n] < gap.over_s for gap in around)]
    return {**one, **whole, "incomplete": len(partial), "incomplete_beside_a_death": len(beside)}


def calls_of(found: dict[str, Any], course: Course) -> dict[str, Any]:
    """Return what became of the calls and of the goals."""
    made, ran = found["caller"], found["server"]
    deaf = [(begin_s, over_s) for what, begin_s, over_s in course.disturbed if what == "outage"]
    for stream in STREAMS:
        arrived = unfolded(found["ceddp" if stream.host == "robot" else "robot"]["streams"][stream.name]["spans"])
        around = gaps(found[stream.host]["sent_s"][stream.name], arrived, course.lasting_deaths(), stream.host)
        deaf += [(gap.begin_s - _SERVICES_S, gap.over_s + _SERVICES_S) for gap in around]
    return {kind: summary(made[kind], ran[kind], deaf) for kind in ("calls", "goals")}


def _visits(visits: list[dict[str, Any]], course: Course) -> list[dict[str, Any]]:
    """Return of each reader on demand what it waited for its first sample, and what happened meanwhile."""
    found = []
    for visit in visits:
        at_s, first_s = visit["at_s"], visit["first_s"]
        until_s = at_s + VISIT_S if first_s is None else first_s
        meanwhile = [what for what, begin_s, over_s in course.disturbed if begin_s <= until_s and over_s >= at_s - 5.0]
        found.append(
            {
                "waited_s": None if first_s is None else first_s - at_s,
                "is_lossy": at_s >= course.lossy_from_s,
                "meanwhile": meanwhile,
            }
        )
    return found


def demand_of(found: dict[str, Any], course: Course) -> list[dict[str, Any]]:
    """Return of each reader on demand what it waited for, and how old its first sample was."""
    (sent_s,) = (times for name, times in found["robot"]["sent_s"].items() if name.startswith(f"{DEMAND} "))
    visits = found["ceddp"]["demand"]
    for visit, each in zip(visits, rows := _visits(visits, course), strict=True):
        each["age_s"] = None if visit["first_s"] is None else visit["first_s"] - sent_s[visit["first_number"]]
    return rows


def latched_of(found: dict[str, Any], course: Course) -> list[dict[str, Any]]:
    """Return of each late joiner whether it got the newest sample of every writer, or a newer one."""
    sent = {
        int(name.rsplit(" ", 1)[1]): times
        for name, times in found["robot"]["sent_s"].items()
        if name.startswith(f"{LATCHED} ")
    }
    visits = found["ceddp"]["latched"]
    for visit, each in zip(visits, rows := _visits(visits, course), strict=True):
        newest = {int(writer): one for writer, one in visit["newest"].items()}
        due = {writer: sum(at_s <= visit["at_s"] for at_s in times) - 1 for writer, times in sent.items()}
        each["lacks"] = sorted(
            writer for writer, number in due.items() if number >= 0 and newest.get(writer, [-1, 0])[0] < number
        )
        each["complete_s"] = max((at_s for _, at_s in newest.values()), default=visit["at_s"]) - visit["at_s"]
    return rows


def report(document: dict[str, Any]) -> str:
    if "addresses" in document:
        return _addresses(document)
    events = ", ".join(f"{count} × {kind}" for kind, count in document["events"].items())
    return paragraphs(
        f"{document['minutes']:g} minutes ({described(document)}): {events}.",
        table(
            _streams(document),
            ("writer", "writer"),
            ("sent", "sent", "{:,}"),
            ("received", "received", "{:,}"),
            ("withheld by pacing", lambda row: row.get("withheld", "")),
            ("while the near end was dead", "while_near_dead"),
            ("while the far end was dead", "while_far_dead"),
            ("lost", lambda row: row.get("lost", "")),
            ("doubled", "doubled"),
            ("out of order", "reordered"),
            ("flows again after s, at most", lambda row: max(row["again_s"], default=None), "{:.1f}"),
            ("not again", "never_again"),
        ),
        table(
            document["calls"].items(),
            ("from the CEDDP", lambda row: {"calls": "service calls", "goals": "action goals"}[row[0]]),
            *((what, lambda row, key=key: row[1][key], "{:,}") for what, key in _CALLS.items()),
            ("median s", lambda row: row[1]["median_s"], "{:.2f}"),
            ("longest s", lambda row: row[1]["longest_s"], "{:.1f}"),
        )
        if document["calls"]
        else "",
        table(_others(document), ("", 0), ("", 1)),
    )


_CALLS = {
    "made": "made",
    "answered": "answered",
    "failed": "failed",
    "of these begun as the ends did not hear each other": "failed_meanwhile",
    "failed but ran": "failed_but_ran",
    "answered and failed": "both",
    "neither": "neither",
    "answered twice": "answered_twice",
    "wrong": "wrong",
    "ran twice": "ran_twice",
    "answered but never ran": "answered_but_never_ran",
}


def _addresses(document: dict[str, Any]) -> str:
    def again(one: dict[str, Any] | None) -> str:
        if one is None:
            return ""
        return f"not: {', '.join(one['silent'])}" if one["again_s"] is None else f"{one['again_s']:.1f} s"

    return paragraphs(
        f"{described(document)}:",
        table(
            document["addresses"],
            ("new address of the", "host"),
            ("processes that ended themselves, after", lambda one: _listed(one["ended_s"])),
            ("all topics flow again after", again),
            ("a new plain process sees its host's nodes", lambda one: "yes" if one["is_visible"] else "no"),
            ("with these nodes started again, all topics flow after", lambda one: again(one.get("after_nodes"))),
        ),
    )


def _listed(ended_s: dict[str, float]) -> str:
    return ", ".join(f"{name} {at_s:.1f} s" for name, at_s in ended_s.items()) or "none"


def _streams(document: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Yield a row for each writer; what only the topic's counters know stands in the row of its last writer."""
    for one in document["topics"].values():
        *others, last = one["writers"]
        yield from others
        together = f"{last['writer']} (withheld, lost: of all)" if others else last["writer"]
        yield {**last, "writer": together, "withheld": one["withheld"], "lost": one["lost"]}
    yield {**document["sets"], "writer": "sets of three"}


def _others(document: dict[str, Any]) -> Iterator[tuple[str, str]]:
    sets = document["sets"]
    of = f"{sets['incomplete']} of {sets['received'] + sets['incomplete']:,} incomplete"
    yield "sets with one stamp that arrived", f"{of}, {sets['incomplete_beside_a_death']} of these as an end died"
    for words, group in {
        "no loss": [visit for visit in document["demand"] if not visit["meanwhile"] and not visit["is_lossy"]],
        "1 % loss": [visit for visit in document["demand"] if not visit["meanwhile"] and visit["is_lossy"]],
        "an outage or a kill meanwhile or up to 5 s before": [v for v in document["demand"] if v["meanwhile"]],
    }.items():
        waited = [visit["waited_s"] for visit in group if visit["waited_s"] is not None]
        value = f"median {median(waited):.2f} s, longest {max(waited):.2f} s; " if waited else ""
        value += f"{len(waited)} of {len(group)} came"
        yield f"first sample of a topic that nobody read before, {words}", value
    latched = document["latched"]
    lacking = [visit for visit in latched if visit["lacks"]]
    value = f"{len(latched) - len(lacking)} of {len(latched)}"
    if lacking:
        value += f"; {sum(bool(visit['meanwhile']) for visit in lacking)} of the others beside an outage or a kill"
    yield "late readers of a latched topic that got the newest sample of both its writers", value
    yield "processes that ended themselves", "; ".join(document["ended_themselves"]) or "none"
    yield loud_lines(document)
