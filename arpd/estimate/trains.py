"""Capacity of the link and overhead of a packet, as probe trains show them."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING

from arpd.estimate.parameters import TRAIN_MEMORY_S

if TYPE_CHECKING:
    from arpd.model.probing import Train

_FRESH_S, _SURPRISE = 2.5, 0.2  # a train that differs by more from the capacity is confirmed at once
_SENDER_LIMITED = 0.7  # a train that arrives nearly as it left: the link takes no longer than that
_SMALL = 0.5  # of the size of a large packet
_PAIR_S = 1.0  # a small and a large train this close together saw the same link
_PAIRS = 15
_LEAST_PAIRS = 5
_SETTLED = 8  # large trains that show the capacity, also in the light of an overhead that was just found
_SLOWER = 2.0  # a pair counts up to this multiple of the present packet time
_MOST_OVERHEAD = 0.8
_LATE = 3  # large trains whose fastest one counts
# Jitter alone reads as less than these; 802.11 spends at least 100 us on a packet.
_LEAST_OVERHEAD_S = 50e-6
_LEAST_OVERHEAD = 0.03  # of the time a large packet takes


@dataclass(frozen=True, kw_only=True, slots=True)
class _Reading:
    at_s: float
    packet_bytes: float
    packet_s: float


class TrainLog:
    """Readings of trains, newest last.

    A packet of s bytes takes T(s) = t_ovh + s/C of the link's time (docs/design.md, The program). Large packets alone
    cannot separate the two; a train of small ones right after one of large ones can: t_ovh = (T_small·s_large −
    T_large·s_small) / (s_large − s_small). Other traffic between the packets only makes a train longer, so the least
    recent T_large counts. Among the pairs the second least t_ovh counts: a link that changes inside one pair may make
    that pair read too little.
    """

    def __init__(self) -> None:
        self._large: deque[_Reading] = deque()
        self.count = 0  # readings of large packets since `clear`
        self._taken = 0
        self._last_packet_s = 0.0  # of the last large train; outlives `clear`
        # t_ovh s, whether it is that or less, and the time of a large packet then s
        self._overheads: deque[tuple[float, bool, float]] = deque(maxlen=_PAIRS)

    def note(self, train: Train, now_s: float, *, copies: int = 1) -> None:
        """Note a train of a report; each of its packets crossed the link ``copies`` times, once per peer."""
        if train.packets < 1 or train.duration_s <= 0 or train.payload_bytes <= 0:
            return
        reading = _Reading(
            at_s=now_s,
            packet_bytes=train.payload_bytes / train.packets,
            packet_s=train.duration_s / train.packets / copies,
        )
        large = self._large[-1] if self._large else None
        if large is None or reading.packet_bytes > _SMALL * large.packet_bytes:
            self._large.append(reading)
            self.count += 1
            self._last_packet_s = reading.packet_s
            while now_s - self._large[0].at_s > TRAIN_MEMORY_S:
                self._large.popleft()
        elif now_s - large.at_s <= _PAIR_S:
            least = min(each.packet_s for each in list(self._large)[-_LATE:])
            if reading.packet_s > least:
                return  # a small packet is never slower than a large one, so other traffic came in between
            excess = reading.packet_s * large.packet_bytes - least * reading.packet_bytes
            is_bound = train.sent_s >= _SENDER_LIMITED * train.duration_s
            self._overheads.append((excess / (large.packet_bytes - reading.packet_bytes), is_bound, least))

    def take(self, *, packet_overhead_s: float) -> list[float]:
        """Return the capacities that large trains saw since the last call, newest last (bytes/s)."""
        fresh, self._taken = self.count - self._taken, self.count
        return self.capacities(-math.inf, packet_overhead_s=packet_overhead_s)[-fresh:] if fresh else []

    def clear(self) -> None:
        """Forget the capacities; the overhead of a packet depends on the radio, and stays."""
        self._large.clear()
        self.count = self._taken = 0

    @property
    def packet_overhead_s(self) -> float:
        """t_ovh; 0 until it is known, and while jitter may explain it (s)."""
        if len(self._known) < _LEAST_PAIRS:
            return 0.0
        overhead_s, is_bound, _ = sorted(self._known)[1]
        if is_bound or overhead_s < max(_LEAST_OVERHEAD_S, _LEAST_OVERHEAD * self._last_packet_s):
            return 0.0
        return min(overhead_s, _MOST_OVERHEAD * self._last_packet_s)

    @property
    def needs_pairs(self) -> bool:
        """True while too few pairs show the overhead on a link of this speed."""
        return not self._large or len(self._known) < _LEAST_PAIRS

    @property
    def is_settled(self) -> bool:
        """True when enough trains have been read for a link that rests."""
        return self.count >= _SETTLED

    @property
    def _known(self) -> list[tuple[float, bool, float]]:
        """Pairs of a link as fast as now: jitter on a slow link is as long as the overhead on a fast one."""
        return [each for each in self._overheads if each[2] <= _SLOWER * self._last_packet_s]

    @property
    def newest_s(self) -> float:
        """Time of the newest report of a train of large packets (s)."""
        return self._large[-1].at_s if self._large else -math.inf

    def capacities(self, since_s: float, *, packet_overhead_s: float) -> list[float]:
        """Return the capacities that large trains since then saw, newest last: C = s / (T − t_ovh) (bytes/s)."""
        return [
            reading.packet_bytes / max(reading.packet_s - packet_overhead_s, 0.1 * reading.packet_s)
            for reading in self._large
            if reading.at_s >= since_s
        ]

    def surprise(self, now_s: float, *, capacity: float, packet_overhead_s: float) -> float | None:
        """Return what the last train saw, if that is far from the capacity (bytes/s)."""
        last = self.capacities(now_s - _FRESH_S, packet_overhead_s=packet_overhead_s)[-1:]
        return last[0] if last and abs(last[0] / capacity - 1.0) > _SURPRISE else None
