"""The figures of one run of `robots.py`, from what its processes noted."""

from __future__ import annotations

from collections import Counter, defaultdict
from itertools import pairwise
from typing import TYPE_CHECKING, Any

from arpd.adapters.sim.result import percentile
from scripts.bench.robots_sets import sources_of, topics_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from scripts.bench.robots_sets import Topic

GROUPS = ("commands", "small", "paired", "large")
_MS = 1e-6  # of a nanosecond
_S = 1e-9


class Figures:
    """What became of a robot's samples.

    Parameters
    ----------
    sources : what each publisher noted, by its number
    arrivals : of each topic: source, number, times of publishing and arrival (ns), whether it is whole
    from_s, until_s : the time that counts (monotonic s)
    """

    def __init__(
        self, robot: str, sources: dict[int, dict[str, Any]], arrivals: dict[str, Any], from_s: float, until_s: float
    ) -> None:
        self._topics = {topic.name: topic for topic in topics_of(robot)}
        self._sources: dict[str, dict[int, Topic]] = defaultdict(dict)
        for number, topic in enumerate(sources_of(robot)):
            self._sources[topic.name][number] = topic
        self._noted, self._arrivals = sources, arrivals
        self._from_s, self._until_s = from_s, until_s
        self._latencies_ms: dict[str, list[float]] = {}
        self.topics = {name: self._topic(name) for name in self._topics}

    def _topic(self, name: str) -> dict[str, Any]:
        seconds = self._until_s - self._from_s
        parts = [self._source(name, source) for source in self._sources[name]]
        latencies = [latency for part in parts for latency in part.pop("latencies_ms")]
        self._latencies_ms[name] = latencies
        kinds: Counter[str] = sum((part.pop("kinds") for part in parts), Counter())
        offered = round(sum(topic.rate_hz for topic in self._sources[name].values()) * seconds)
        arrived = sum(part.pop("arrived") for part in parts)
        first = self._topics[name]
        return {
            "group": first.group,
            "bytes": first.size,
            "offered": offered,
            **{key: sum(part[key] for part in parts) for key in ("published", "delivered", "doubled", "out_of_order")},
            "torn": sum(not row[4] for row in self._arrivals[name]),
            "per_second": arrived / seconds,
            "p50_ms": percentile(latencies, 0.5),
            "p99_ms": percentile(latencies, 0.99),
            "max_ms": max(latencies, default=None),
            **{key: max(part[key] for part in parts) for key in ("gap_s", "gap_over_period_s")},
            **({"per_second_by_kind": {kind: many / seconds for kind, many in kinds.items()}} if kinds else {}),
            **({"delivered_by_source": [part["delivered"] for part in parts]} if len(parts) > 1 else {}),
        }

    def _source(self, name: str, source: int) -> dict[str, Any]:
        topic, noted = self._sources[name][source], self._noted[source]
        rows = [row for row in self._arrivals[name] if row[0] == source]
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
        times_s = sorted({row[3] * _S for row in rows if self._from_s <= row[3] * _S < self._until_s})
        gap_s = max(after - before for before, after in pairwise([self._from_s, *times_s, self._until_s]))
        kinds = Counter(topic.kinds[number % len(topic.kinds)] for number in counted) if topic.kinds != ("",) else {}
        return {
            "published": noted["published"],
            "delivered": len(counted),
            "latencies_ms": list(counted.values()),
            "arrived": len(times_s),
            "doubled": doubled,
            "out_of_order": out_of_order,
            "gap_s": gap_s,
            "gap_over_period_s": gap_s - 1.0 / topic.rate_hz,
            "kinds": Counter(kinds),
        }

    def groups(self) -> dict[str, Any]:
        """Return the figures of each class of topics; those of the worst topic beside those of all."""
        found = {}
        for group in GROUPS:
            members = {name: each for name, each in self.topics.items() if each["group"] == group}
            if not members:
                continue
            latencies = [latency for name in members for latency in self._latencies_ms[name]]
            shares = {name: 100.0 * min(1.0, each["delivered"] / each["offered"]) for name, each in members.items()}
            worst = min(shares, key=lambda name: shares[name])
            offered = sum(each["offered"] for each in members.values())
            p99s = {name: each["p99_ms"] for name, each in members.items() if each["p99_ms"] is not None}
            found[group] = {
                "delivered_percent": min(100.0, 100.0 * sum(each["delivered"] for each in members.values()) / offered),
                "worst_topic": worst,
                "worst_delivered_percent": shares[worst],
                "p50_ms": percentile(latencies, 0.5),
                "p99_ms": percentile(latencies, 0.99),
                "worst_p99_ms": max(p99s.values(), default=None),
                "max_ms": max(latencies, default=None),
                "gap_s": max(each["gap_s"] for each in members.values()),
                "gap_over_period_s": max(each["gap_over_period_s"] for each in members.values()),
                "whole_per_second": sum(each["per_second"] for each in members.values()),
            }
        return found

    def sets_per_second(self, names: Sequence[str]) -> float:
        """Return how many samples of one number came whole on all of these topics."""
        first = max(self._noted[source]["first"] or 0 for name in names for source in self._sources[name])
        until_ns = self._until_s / _S
        came = [{row[1] for row in self._arrivals[name] if row[1] >= first and row[3] < until_ns} for name in names]
        return len(set.intersection(*came)) / (self._until_s - self._from_s)

    def faults(self) -> dict[str, int]:
        """Return how many samples came twice, torn, or after a later one of their source."""
        return {key: sum(each[key] for each in self.topics.values()) for key in ("doubled", "torn", "out_of_order")}
