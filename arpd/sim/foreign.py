"""Other traffic in virtual time: an upload from the robot, a download of the peer, and another station."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from typing import Self

    from arpd.sim.link import SimulatedLink
    from arpd.sim.timeline import Timeline

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
