"""The sides of `adapt.py`: what a user can do about a link that changes."""

from __future__ import annotations

import math
from statistics import fmean
from typing import TYPE_CHECKING

from arpd.adapters.config.load import load_settings
from arpd.govern.what_if import OfflinePlanner
from arpd.model.wire import DATA_BYTES, ETHERNET_BYTES, IPV4_BYTES, MTU_BYTES, UDP_BYTES
from arpd.solve.eq4 import Eq4Problem, rate_of
from arpd.solve.topics import assumed_traffic
from scripts.robot.manner import RCLPY_DEFAULTS, WITH_ARPD, Manner
from scripts.robot.run import CONFIG, PREFIX

if TYPE_CHECKING:
    from pathlib import Path

    from scripts.bench.adapt_links import Link

#: Name and description of every side.
SIDES = {
    "defaults": "rclpy's defaults, KEEP_LAST 10",
    "keep-last-1": "KEEP_LAST 1",
    "keep-last-5000": "KEEP_LAST 5000",
    "paper": "the paper's optimum, computed once for the rate at the start",
    "throttle": "every topic throttled by hand, by what `arpd solve` gives for the link's mean rate",
    "arpd": "arpd, with its Fast DDS profile (heartbeats every 50 ms; the sides above have the default, 3 s)",
    "oracle": "arpd, told the mean of the link's next 0.2 s at every tick; price, pacing and governor are the same",
}
DEFAULTS, PAPER, ARPD, ORACLE = "defaults", "paper", "arpd", "oracle"


def label(side: str) -> str:
    """Return the name of a side for people: the oracle is the bound."""
    return "bound" if side == ORACLE else side


def manner(side: str, link: Link, truth: Path) -> Manner:
    """Return how the robot publishes.

    Parameters
    ----------
    side : one of SIDES
    link : its course; "paper" and "throttle" use it beforehand
    truth : file that tells the oracle the course of the link
    """
    if side == "paper":
        return papers_optimum(link.rates.rate_at(0.0))
    if side == "throttle":
        return throttle(link.mean_bytes_per_second)
    return {
        "defaults": RCLPY_DEFAULTS,
        "keep-last-1": Manner(depth=1),
        "keep-last-5000": Manner(depth=5000),
        "arpd": WITH_ARPD,
        "oracle": Manner(daemon=("scripts.robot.oracle", "--truth", str(truth))),
    }[side]


def papers_optimum(capacity_bytes_per_second: float) -> Manner:
    """Return Eq. (4)'s one R and one D for all topics.

    Rmax, "the maximum rate when only one topic is used", is computed for a message of the topics' mean size: all N
    topics at Rmax/N fill the link exactly. Acknowledgements are left out: a few bytes every three seconds.
    """
    traffic = assumed_traffic(load_settings(CONFIG, interfaces=None))
    mean_bytes = fmean(plain_wire_bytes(topic.payload_bytes) for topic in traffic)
    problem = Eq4Problem(max_rate_hz=capacity_bytes_per_second / mean_bytes, topics=len(traffic))
    if refusal := problem.refusal():
        raise ValueError(f"Eq. (4) has no solution at {capacity_bytes_per_second:g} B/s: {refusal}")
    deadline_ns, depth = problem.applied(problem.vertex()[0])
    return Manner(
        depth=depth,
        deadline_ns=deadline_ns,
        rates_hz={topic.topic.removeprefix(PREFIX): rate_of(deadline_ns) for topic in traffic},
    )


def plain_wire_bytes(payload_bytes: float) -> float:
    """Return the wire bytes of a sample of plain rclpy: a datagram of up to 64 kB, in fragments of IP."""
    datagram = UDP_BYTES + DATA_BYTES + payload_bytes
    return datagram + math.ceil(datagram / (MTU_BYTES - IPV4_BYTES)) * (ETHERNET_BYTES + IPV4_BYTES)


def throttle(mean_bytes_per_second: float) -> Manner:
    """Return the rates that `arpd solve` prints for a capacity, with rclpy's depth."""
    settings = load_settings(CONFIG, interfaces=None)
    plan = OfflinePlanner(settings, assumed_traffic(settings)).plan(mean_bytes_per_second)
    return Manner(rates_hz={row.topic.name.removeprefix(PREFIX): row.rate_hz for row in plan.topics})
