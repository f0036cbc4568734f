"""What became of every sample: latency, age, loss, and what came twice, torn, out of order or after a gap."""

from __future__ import annotations

import math
from collections import defaultdict
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from arpd.sim.result import percentile
from scripts.bench.samples import Topic, sources_of

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from scripts.bench.sides import Robot

GROUPS = ("commands", "small", "paired", "large")
_MS = 1e-6  # of a nanosecond
_S = 1e-9
AGE_S = 0.05  # between two looks at the age


class Account:
    """What became of a robot's samples.

    Parameters
    ----------
    found : what each process noted
    from_s, until_s : the time that counts (monotonic s)
    withheld : samples of each topic that arpd did not send on purpose, and so has not lost
    """

    def __init__(
        self,
        robot: Robot,
        found: dict[str, dict[str, Any]],
        from_s: float,
        until_s: float,
        *,
        withheld: Mapping[str, int],
    ) -> None:
        self.withheld = withheld
        self._topics = {topic.name: topic for topic in robot.topics}
        self._sources: dict[str, dict[int, Topic]] = defaultdict(dict)
        for number, topic in enumerate(sources_of(robot.topics)):
            self._sources[topic.name][number] = topic
        self._groups = robot.groups
        self.noted = {int(number): one for each in found.values() for number, one in each["sources"].items()}
        self.arrivals = {name: rows for each in found.values() for name, rows in each["arrivals"].items()}
        self.writers = {name: many for each in found.values() for name, many in each["writers"].items()}
        self.calls = [call for each in found.values() for call in each["calls"]]
        self.ran = {number: many for each in found.values() for number, many in each["ran"].items()}
        self.swaps = sum(each["swaps"] for each in found.values())
        self.from_s, self.until_s = from_s, until_s
        self._latencies_ms: dict[str, list[float]] = {}
        self.ages_s: dict[str, list[float]] = {}  # of the newest sample at the reader, each `AGE_S`
        self.topics = {name: self._topic(name) for name, topic in self._topics.items() if not topic.answers}

    def _topic(self, name: str) -> dict[str, Any]:
        seconds = self.until_s - self.from_s
        by_source: dict[int, list[Any]] = defaultdict(list)
        for row in self.arrivals[name]:
            by_source[row[0]].append(row)
        parts = [self._source(number, by_source[number]) for number in self._sources[name]]
        latencies = [latency for part in parts for latency in part.pop("latencies_ms")]
        self._latencies_ms[name] = latencies
        self.ages_s[name] = [age for part in parts for age in part.pop("ages_s")]
        offered = round(sum(topic.rate_hz for topic in self._sources[name].values()) * seconds)
        arrived = sum(part.pop("arrived") for part in parts)
        first = self._topics[name]
        return {
            "group": first.group,
            "bytes": first.size,
            "offered": offered,
            **{key: sum(part[key] for part in parts) for key in ("published", "delivered", "doubled", "out_of_order")},
            "torn": sum(not row[4] for row in self.arrivals[name]),
            "per_second": arrived / seconds,
            "p50_ms": percentile(latencies, 0.5),
            "p99_ms": percentile(latencies, 0.99),
            "max_ms": max(latencies, default=None),
            "age_p50_s": percentile(self.ages_s[name], 0.5),
            "age_p99_s": percentile(self.ages_s[name], 0.99),
            "gap_s": max(part["gap_s"] for part in parts),
        }

    def _source(self, source: int, rows: list[Any]) -> dict[str, Any]:
        noted = self.noted[source]
        numbers = [row[1] for row in rows]
        doubled = len(numbers) - len(set(numbers))
        newest, out_of_order = -1, 0
        for number in dict.fromkeys(numbers):
            out_of_order += number < newest
            newest = max(newest, number)
        counted: dict[int, float] = {}
        for _, number, sent_ns, arrived_ns, _ in rows:
            if noted["first"] is not None and number >= noted["first"]:
                counted.setdefault(number, (arrived_ns - sent_ns) * _MS)
        times_s = sorted({row[3] * _S for row in rows if self.from_s <= row[3] * _S < self.until_s})
        gap_s = max(after - before for before, after in pairwise([self.from_s, *times_s, self.until_s]))
        return {
            "published": noted["published"],
            "delivered": len(counted),
            "latencies_ms": list(counted.values()),
            "ages_s": self._ages(rows),
            "arrived": len(times_s),
            "doubled": doubled,
            "out_of_order": out_of_order,
            "gap_s": gap_s,
        }

    def _ages(self, rows: list[Any]) -> list[float]:
        """Return the age of the newest sample at the reader, 20 times a second; before the first, since the start."""
        looks_s = np.arange(self.from_s + AGE_S, self.until_s, AGE_S)
        if not rows:
            return list(looks_s - self.from_s)
        ordered = sorted(rows, key=lambda row: row[3])
        newest_s = np.maximum.accumulate([row[2] * _S for row in ordered])
        known = np.searchsorted([row[3] * _S for row in ordered], looks_s) - 1
        ages: list[float] = (looks_s - np.where(known >= 0, newest_s[known], self.from_s)).tolist()
        return ages

    def groups(self) -> dict[str, Any]:
        """Return the figures of each class of topics."""
        found = {}
        for group in GROUPS:
            members = {name: each for name, each in self.topics.items() if each["group"] == group}
            if not members:
                continue
            latencies = [latency for name in members for latency in self._latencies_ms[name]]
            offered = sum(each["offered"] for each in members.values())
            found[group] = {
                "delivered_percent": min(100.0, 100.0 * sum(each["delivered"] for each in members.values()) / offered),
                "worst_delivered_percent": min(
                    100.0 * min(1.0, each["delivered"] / each["offered"]) for each in members.values()
                ),
                "p99_ms": percentile(latencies, 0.99),
                "max_ms": max(latencies, default=None),
                "age_p99_s": max(each["age_p99_s"] for each in members.values()),
                "gap_over_period_s": max(
                    each["gap_s"] - max(topic.period_s for topic in self._sources[name].values())
                    for name, each in members.items()
                ),
                "per_second": sum(each["per_second"] for each in members.values()),
            }
        return found

    def lost(self, name: str) -> int:
        """Return how many samples of a topic neither came nor were withheld."""
        topic = self.topics[name]
        return max(0, int(topic["published"] - topic["delivered"] - self.withheld.get(name, 0)))

    def sets_per_second(self) -> float:
        """Return how many samples of one number came whole on all topics of the robot's group."""
        first = max(self.noted[source]["first"] or 0 for name in self._groups for source in self._sources[name])
        until_ns = self.until_s / _S
        came = [
            {row[1] for row in self.arrivals[name] if row[1] >= first and row[3] < until_ns} for name in self._groups
        ]
        return len(set.intersection(*came)) / (self.until_s - self.from_s)

    def faults(self) -> dict[str, int]:
        """Return how many samples came twice, torn, or after a later one of their source."""
        return {key: sum(each[key] for each in self.topics.values()) for key in ("doubled", "torn", "out_of_order")}

    def missing(self, name: str, breaks: Iterable[tuple[float, float]]) -> dict[str, Any]:
        """Return what did not come of a topic: beside breaks, and otherwise; and how long it took to flow again (s).

        A break lasts from the last sample that came before it to the first one that came after it.

        Parameters
        ----------
        breaks : begin of each, and when samples could cross again (monotonic s)
        """
        beside, otherwise, again_s, never_again = 0, 0, [0.0], 0
        for source in self._sources[name]:
            sent = {number: at_s for number, at_s in self.noted[source]["sent"] if at_s < self.until_s}
            came = {row[1] for row in self.arrivals[name] if row[0] == source}
            crossed_s = np.array(sorted(at_s for number, at_s in sent.items() if number in came) or [-math.inf])
            spans = []
            for begin_s, over_s in breaks:
                before, after = np.searchsorted(crossed_s, begin_s), np.searchsorted(crossed_s, over_s)
                until_s = crossed_s[after] if after < len(crossed_s) else math.inf
                spans.append((crossed_s[before - 1] if before else -math.inf, until_s))
                never_again += math.isinf(until_s)
                again_s += [until_s - over_s] if math.isfinite(until_s) else []
            for number, at_s in sent.items():
                if number not in came:
                    is_beside = any(begin_s < at_s < over_s for begin_s, over_s in spans)
                    beside, otherwise = beside + is_beside, otherwise + (not is_beside)
        missing = {"missing beside a break": beside, "missing otherwise": otherwise}
        return {**missing, "flows again s": max(again_s), "never again": never_again}
