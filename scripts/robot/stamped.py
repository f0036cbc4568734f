"""Reads the stamp of a sample without deserializing it."""

from __future__ import annotations

import struct
import time
from dataclasses import dataclass, field

from arpd.sim.arrivals import Arrivals

_HEADER = struct.Struct("<iII")  # std_msgs/Header in CDR: seconds, nanoseconds, length of frame_id
_ENCAPSULATION_BYTES = 4
AGE_PERIOD_S = 0.05


def read_stamp(sample: bytes) -> tuple[float, int]:
    """Return source stamp (Unix s) and sequence number (``frame#123`` in frame_id) of a serialized stamped message."""
    seconds, nanoseconds, length = _HEADER.unpack_from(sample, _ENCAPSULATION_BYTES)
    start = _ENCAPSULATION_BYTES + _HEADER.size
    frame = sample[start : start + length - 1].decode()
    return seconds + nanoseconds * 1e-9, int(frame.rpartition("#")[2])


@dataclass(slots=True)
class StampedArrivals(Arrivals):
    """The counts of one rclpy reader, with recent arrivals for the live table.

    Parameters
    ----------
    renewals : time of each sample that was newer than all before, and its stamp (Unix s, Unix s)
    recent, recent_worst_s : count and worst latency since the live table's last question
    number : number of the newest sample at its writer, counted from 1
    """

    renewals: list[tuple[float, float]] = field(default_factory=list)
    recent: int = 0
    recent_worst_s: float = 0.0
    number: int = 0

    def on_sample(self, sample: bytes, info: dict[str, int]) -> None:
        """Note a raw sample with its MessageInfo; it arrived when the DDS thread received it."""
        stamp_s, sequence = read_stamp(sample)
        latency_s = info["received_timestamp"] * 1e-9 - stamp_s
        self.on_arrival(sequence, latency_s)
        before_s = self.newest_stamp_s
        self.on_delivery(sequence, stamp_s, len(sample))
        if self.newest_stamp_s > before_s:
            self.renewals.append((time.time(), stamp_s))
        self.number = max(self.number, info["publication_sequence_number"])
        self.recent += 1
        self.recent_worst_s = max(self.recent_worst_s, latency_s)

    def sample_ages(self, began_s: float, ended_s: float) -> None:
        """Sample the age at 20 Hz between two times (Unix s), from the log: it grows even if the reader itself hangs.

        Before the first sample, the age is the time since the start.
        """
        self.ages_s.clear()
        newest_s, upcoming = began_s, 0
        for k in range(1, int((ended_s - began_s) / AGE_PERIOD_S) + 1):
            now_s = began_s + k * AGE_PERIOD_S
            while upcoming < len(self.renewals) and self.renewals[upcoming][0] <= now_s:
                newest_s = self.renewals[upcoming][1]
                upcoming += 1
            self.ages_s.append(now_s - newest_s)

    def take_recent(self) -> tuple[int, float]:
        """Return count and worst latency (s) since the last call."""
        recent = self.recent, self.recent_worst_s
        self.recent, self.recent_worst_s = 0, 0.0
        return recent
