"""Traffic that is not arpd's on a link in virtual time: an upload through our own interface, and another station."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from arpd.adapters.sim.schedule import RateSchedule, RateStep

if TYPE_CHECKING:
    from collections.abc import Sequence

    from arpd.adapters.sim.link import SimulatedLink
    from arpd.adapters.sim.timeline import Timeline

_PACKET_BYTES = 1514


@dataclass(frozen=True, kw_only=True, slots=True)
class ForeignFlow:
    """From the robot over the link, in full packets, whatever the link makes of it.

    Parameters
    ----------
    start_s, end_s : run time of the first packet, and from when on there are none (s)
    rate_bytes_per_second : wire bytes offered to the link (bytes/s)
    """

    start_s: float
    end_s: float
    rate_bytes_per_second: float

    def play(self, timeline: Timeline, link: SimulatedLink, *, origin_s: float) -> None:
        """Plan the first packet; each plans the next."""
        packets = 0

        def send() -> None:
            nonlocal packets
            link.send(_PACKET_BYTES, 1, lambda: None)
            packets += 1
            next_s = self.start_s + packets * _PACKET_BYTES / self.rate_bytes_per_second
            if next_s < self.end_s:
                timeline.at(origin_s + next_s, send)

        timeline.at(origin_s + self.start_s, send)


@dataclass(frozen=True, kw_only=True, slots=True)
class Contention:
    """Another station that sends on our channel: its bytes are in no counter of ours, its air time is gone.

    Parameters
    ----------
    start_s, end_s : run time from which and until which it sends (s)
    share : of the air time it takes, 0..1
    """

    start_s: float
    end_s: float
    share: float

    def __post_init__(self) -> None:
        if not 0.0 <= self.start_s < self.end_s:
            raise ValueError(
                f"contention from {self.start_s} s to {self.end_s} s: it must start at 0 or later, and end"
            )
        if not 0.0 <= self.share <= 1.0:
            raise ValueError(f"contention share {self.share}: must be from 0 to 1")


def contended(schedule: RateSchedule, stations: Sequence[Contention]) -> RateSchedule:
    """Return what other stations leave of a schedule: the rate that the link gives us while they send.

    It is their air time that goes, so our rate falls in proportion, whatever the bytes they send in it. The overhead of
    our own transmissions (`arpd.adapters.sim.link.LinkModel`) is not stretched by it.
    """
    starts_s = {step.start_s for step in schedule.steps}
    starts_s.update(moment for station in stations for moment in (station.start_s, station.end_s))
    return RateSchedule(
        steps=tuple(
            RateStep(start_s=start_s, rate_bytes_per_second=schedule.rate_at(start_s) * _left(stations, start_s))
            for start_s in sorted(starts_s)
            if start_s < math.inf
        )
    )


def _left(stations: Sequence[Contention], t_s: float) -> float:
    taken = sum(station.share for station in stations if station.start_s <= t_s < station.end_s)
    return max(0.0, 1.0 - taken)
