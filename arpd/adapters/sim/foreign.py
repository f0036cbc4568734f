"""Other traffic in virtual time: an upload from the robot, a download of the peer, and another station."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from arpd.adapters.sim.schedule import RateSchedule, RateStep

if TYPE_CHECKING:
    from collections.abc import Sequence
    from typing import Self

    from arpd.adapters.sim.link import SimulatedLink
    from arpd.adapters.sim.timeline import Timeline

PACKET_BYTES = 1514


@dataclass(frozen=True, kw_only=True, slots=True)
class ForeignFlow:
    """A flow of full packets at a fixed rate: an upload from the robot, or a download of the peer.

    Parameters
    ----------
    start_s, end_s : run time of the first packet, and of the end (s)
    rate_bytes_per_second : wire bytes offered to the link (bytes/s)
    """

    start_s: float
    end_s: float
    rate_bytes_per_second: float

    def after(self, origin_s: float) -> Self:
        """Return the flow at times of the timeline, where run time begins at ``origin_s``."""
        return replace(self, start_s=origin_s + self.start_s, end_s=origin_s + self.end_s)

    def offered_bytes(self, t_s: float) -> float:
        """Return the bytes offered by a moment."""
        return self.rate_bytes_per_second * (min(max(t_s, self.start_s), self.end_s) - self.start_s)

    def play(self, timeline: Timeline, link: SimulatedLink, *, origin_s: float) -> None:
        """Plan the first packet; each packet plans the next."""
        packets = 0

        def send() -> None:
            nonlocal packets
            link.send(PACKET_BYTES, 1, lambda: None)
            packets += 1
            next_s = self.start_s + packets * PACKET_BYTES / self.rate_bytes_per_second
            if next_s < self.end_s:
                timeline.at(origin_s + next_s, send)

        timeline.at(origin_s + self.start_s, send)


@dataclass(frozen=True, kw_only=True, slots=True)
class Contention:
    """Another station on the channel: no counter of the robot sees its bytes, but it takes air time.

    Parameters
    ----------
    start_s, end_s : run time of its first and its last transmission (s)
    share : share of the air time that it takes, 0..1
    """

    start_s: float
    end_s: float
    share: float

    def __post_init__(self) -> None:
        if not 0.0 <= self.start_s < self.end_s:
            raise ValueError(f"contention from {self.start_s} s to {self.end_s} s: start it at 0 or later and end it")
        if not 0.0 <= self.share <= 1.0:
            raise ValueError(f"contention share {self.share}: must be from 0 to 1")


def contended(schedule: RateSchedule, stations: Sequence[Contention]) -> RateSchedule:
    """Return the part of a schedule's rate that other stations leave.

    The robot's rate falls in proportion to the air time that they take, independently of their bytes. The overhead of
    the robot's own transmissions (`LinkModel`) stays the same.
    """
    starts_s = {step.start_s for step in schedule.steps}
    starts_s.update(moment for station in stations for moment in (station.start_s, station.end_s))
    return RateSchedule(
        steps=tuple(
            RateStep(start_s=start_s, rate_bytes_per_second=schedule.rate_at(start_s) * _free_share(stations, start_s))
            for start_s in sorted(starts_s)
            if start_s < math.inf
        )
    )


def _free_share(stations: Sequence[Contention], t_s: float) -> float:
    return max(0.0, 1.0 - sum(station.share for station in stations if station.start_s <= t_s < station.end_s))
