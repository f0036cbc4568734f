"""What `two_ends.py` found, from what each process and arpd's status said."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from scripts.bench.two_ends_account import Death, Reading, gaps, reachable, row, sets_of, unfolded
from scripts.bench.two_ends_calls import summary
from scripts.bench.two_ends_nodes import DEMAND, LATCHED, SET_TOPICS, STREAMS, VISIT_S

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

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
