"""Traffic that is not arpd's on a link in virtual time: an upload of constant rate."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from arpd.sim.link import SimulatedLink, Timeline

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
