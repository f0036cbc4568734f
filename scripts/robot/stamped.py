"""Reading a stamped sample without deserializing it."""

from __future__ import annotations

import struct
from dataclasses import dataclass

from arpd.sim.arrivals import Arrivals

_HEADER = struct.Struct("<iII")  # std_msgs/Header in CDR: seconds, nanoseconds, length of frame_id
_ENCAPSULATION_BYTES = 4


def read_stamp(sample: bytes) -> tuple[float, int]:
    """Return source stamp (Unix s) and sequence number (``frame#123`` in frame_id) of a serialized stamped message."""
    seconds, nanoseconds, length = _HEADER.unpack_from(sample, _ENCAPSULATION_BYTES)
    start = _ENCAPSULATION_BYTES + _HEADER.size
    frame = sample[start : start + length - 1].decode()
    return seconds + nanoseconds * 1e-9, int(frame.rpartition("#")[2])


@dataclass(slots=True)
class StampedArrivals(Arrivals):
    """The books of one rclpy reader, with what came lately for the live table."""

    recent: int = 0
    recent_worst_s: float = 0.0

    def on_sample(self, sample: bytes, info: dict[str, int]) -> None:
        """Take a raw sample with its MessageInfo: it left the wire when the DDS thread received it."""
        stamp_s, sequence = read_stamp(sample)
        latency_s = info["received_timestamp"] * 1e-9 - stamp_s
        self.on_arrival(sequence, latency_s)
        self.on_delivery(sequence, stamp_s, len(sample))
        self.recent += 1
        self.recent_worst_s = max(self.recent_worst_s, latency_s)

    def samples(self) -> dict[str, list[float]]:
        """Return every latency and every age (s), to a tenth of a millisecond."""
        return {
            "latencies_s": [round(seconds, 4) for seconds in self.latencies_s],
            "ages_s": [round(seconds, 4) for seconds in self.ages_s],
        }

    def take_recent(self) -> tuple[int, float]:
        """Count and worst latency since the last call."""
        taken = self.recent, self.recent_worst_s
        self.recent, self.recent_worst_s = 0, 0.0
        return taken
