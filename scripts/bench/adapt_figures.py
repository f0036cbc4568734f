"""The figures of a run of `adapt.py`, per topic and for all, from the notes of its readers; and over all rounds."""

from __future__ import annotations

import math
from statistics import median
from typing import TYPE_CHECKING, Any

import numpy as np

from arpd.adapters.sim.demo import COMMAND_TOPIC
from scripts.robot.sensors import SENSORS
from scripts.robot.stamped import AGE_PERIOD_S

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from arpd.adapters.sim.result import TopicResult

FIRST_SWAPS = 12  # the first plan swaps every topic's publisher
LATE_S = 0.1  # a command later than this is late
TIMELINE_S = 0.5
_LARGE = ("/scan/front", "/scan/rear", "/camera/image/compressed", "/points")  # samples of several packets
#: Topics by class.
CLASSES = {
    "commands": (COMMAND_TOPIC,),
    "small": tuple(topic for topic in SENSORS if topic not in _LARGE),
    "large": _LARGE,
}


def pooled(samples: Sequence[tuple[Sequence[float], int]], q: float) -> float | None:
    """Return a percentile over all topics in which every topic has the same weight; None = never.

    Parameters
    ----------
    samples : per topic the values, and how many samples were due: the missing ones count as never
    q : 0..1
    """
    values = np.array([value for known, _ in samples for value in known])
    weights = np.array([1.0 / max(all_, len(known)) for known, all_ in samples for _ in known])
    topics = sum(1 for known, all_ in samples if all_ or known)
    order = np.argsort(values)
    reached = np.cumsum(weights[order])
    rank = int(np.searchsorted(reached, q * topics - 1e-9))
    return round(float(values[order[rank]]), 4) if rank < len(values) else None


def due(topic: TopicResult) -> int:
    """Return the number of samples that should arrive: those offered and not withheld, even if the robot lost them."""
    return max(topic.sent, topic.offered - topic.withheld, topic.received)


def document(
    topics: Sequence[TopicResult], samples: Mapping[str, Mapping[str, Sequence[float]]], duration_s: float
) -> dict[str, Any]:
    """Return a run's figures for JSON; None = never.

    Parameters
    ----------
    samples : per topic every latency (``latencies_s``) and every age (``ages_s``) that its reader noted
    duration_s : time that the sources published (s)
    """
    return {
        "all": _all(topics, samples, duration_s),
        "classes": {
            name: _shared([topic for topic in topics if topic.topic in members], samples, duration_s)
            for name, members in CLASSES.items()
        },
        "topics": {topic.topic: _topic(topic, samples, duration_s) for topic in topics},
        "ages_over_time_s": over_time([samples[topic.topic]["ages_s"] for topic in topics]),
    }


def over_time(ages_s: Sequence[Sequence[float]]) -> list[float]:
    """Return the mean age over all topics in each TIMELINE_S (s)."""
    per_bin = round(TIMELINE_S / AGE_PERIOD_S)
    bins = min(map(len, ages_s), default=0) // per_bin
    return [
        round(float(np.mean([np.mean(ages[k * per_bin : (k + 1) * per_bin]) for ages in ages_s])), 4)
        for k in range(bins)
    ]


def beyond_period(ages_s: Sequence[float], source_rate_hz: float) -> list[float]:
    """Return each age above one period of the source: 0 on a perfect link (s)."""
    return [max(0.0, age_s - 1.0 / source_rate_hz) for age_s in ages_s]


def late_share(latencies_s: Sequence[float], sent: int) -> float:
    """Return the share of samples later than LATE_S; a lost one is late."""
    return 1.0 - _ratio(sum(latency_s <= LATE_S for latency_s in latencies_s), sent)


def _all(
    topics: Sequence[TopicResult], samples: Mapping[str, Mapping[str, Sequence[float]]], duration_s: float
) -> dict[str, Any]:
    survivors = [(samples[topic.topic]["latencies_s"], 0) for topic in topics]
    beyond = [(beyond_period(samples[topic.topic]["ages_s"], topic.source_rate_hz), 0) for topic in topics]
    commands = next(topic for topic in topics if topic.topic == COMMAND_TOPIC)
    return {
        **_shared(topics, samples, duration_s),
        "survivors_max_s": pooled(survivors, 1.0),
        "beyond_p99_s": pooled(beyond, 0.99),
        "command_late_share": late_share(samples[COMMAND_TOPIC]["latencies_s"], due(commands)),
    }


def _topic(
    topic: TopicResult, samples: Mapping[str, Mapping[str, Sequence[float]]], duration_s: float
) -> dict[str, Any]:
    counts = ("source_rate_hz", "expected", "offered", "withheld", "sent", "received")
    return {**{name: getattr(topic, name) for name in counts}, **_shared([topic], samples, duration_s)}


def _shared(
    topics: Sequence[TopicResult], samples: Mapping[str, Mapping[str, Sequence[float]]], duration_s: float
) -> dict[str, Any]:
    """Return the figures that one topic has as well as all together."""
    latencies = [(samples[topic.topic]["latencies_s"], due(topic)) for topic in topics]
    survivors = [(values, 0) for values, _ in latencies]
    ages = [(samples[topic.topic]["ages_s"], 0) for topic in topics]
    has_lost = any(due(topic) > topic.received for topic in topics)
    offered, expected = sum(t.offered for t in topics), sum(t.expected for t in topics)
    return {
        "latency_p50_s": pooled(latencies, 0.5),
        "latency_p99_s": pooled(latencies, 0.99),
        "latency_max_s": None if has_lost else pooled(latencies, 1.0),
        "survivors_p99_s": pooled(survivors, 0.99),
        "age_p50_s": pooled(ages, 0.5),
        "age_p99_s": pooled(ages, 0.99),
        "goodput_bytes_per_second": round(sum(topic.delivered_bytes for topic in topics) / duration_s),
        "loss_ratio": _ratio(sum(due(t) - t.received for t in topics), sum(map(due, topics))),
        "withheld_ratio": _ratio(sum(t.withheld for t in topics), offered),
        "stalled_ratio": _ratio(max(0, expected - offered), expected),
    }


def figures_of(document: Mapping[str, Any]) -> dict[tuple[str, str], dict[str, float]]:
    """Return the medians over the rounds, by link and side; never is infinite."""
    durations_s = {link["name"]: link["duration_s"] for link in document["links"]}
    found: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for run in document["runs"]:
        found.setdefault((run["link"], run["side"]), []).append(_flat(run, durations_s[run["link"]]))
    return {key: _medians(runs) for key, runs in found.items()}


def ranges_of(document: Mapping[str, Any], figure: str) -> dict[tuple[str, str], tuple[float, float]]:
    """Return the least and the largest value of a figure over the rounds, by link and side; never is infinite."""
    found: dict[tuple[str, str], list[float]] = {}
    for run in document["runs"]:
        value = run["all"][figure]
        found.setdefault((run["link"], run["side"]), []).append(math.inf if value is None else float(value))
    return {key: (min(values), max(values)) for key, values in found.items()}


def _flat(run: Mapping[str, Any], duration_s: float) -> dict[str, Any]:
    return {
        **run["all"],
        **{f"cpu_{name}": share for name, share in run["cpu"].items()},
        **{f"{name}/{figure}": value for name, of in run.get("classes", {}).items() for figure, value in of.items()},
        "swaps": run["swaps"],
        "swaps_per_minute": max(0, run["swaps"] - FIRST_SWAPS) * 60.0 / duration_s,
        "unassembled": run["reassembly"]["failed"],
    }


def topics_of(document: Mapping[str, Any], link: str) -> dict[str, dict[str, dict[str, float]]]:
    """Return the medians of every topic on one link, by topic and side."""
    found: dict[str, dict[str, list[dict[str, Any]]]] = {}
    for run in document["runs"]:
        if run["link"] == link:
            for topic, figures in run["topics"].items():
                found.setdefault(topic, {}).setdefault(run["side"], []).append(figures)
    return {topic: {side: _medians(runs) for side, runs in sides.items()} for topic, sides in found.items()}


def _medians(runs: list[dict[str, Any]]) -> dict[str, float]:
    return {name: median([math.inf if one[name] is None else float(one[name]) for one in runs]) for name in runs[0]}


def check(run: Mapping[str, Any]) -> list[str]:
    """Return the faults that make a run worthless."""
    wrong = [f"{name} was never received" for name, topic in run["topics"].items() if not topic["received"]]
    wrong += [f"{name} was never offered" for name, topic in run["topics"].items() if not topic["offered"]]
    if len(run["topics"]) != 12:
        wrong.append(f"{len(run['topics'])} topics instead of 12")
    if not run["ages_over_time_s"]:
        wrong.append("no ages were sampled")
    numbers = [value for value in run["all"].values() if value is not None]
    wrong += ["a figure is not a finite number"] * (not all(map(math.isfinite, numbers)))
    return wrong


def _ratio(part: float, whole: float) -> float:
    return round(part / whole, 5) if whole else 0.0
