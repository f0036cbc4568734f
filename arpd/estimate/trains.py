"""Capacity of the link and overhead of a packet, as probe trains show them."""

from __future__ import annotations

import math
from collections import deque
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from arpd.model.probing import Train

_SENDER_LIMITED = 0.7  # a train that arrives nearly as it left: the link takes no longer than that
_SMALL = 0.5  # of the size of a large packet
_PAIR_S = 1.0  # a small and a large train this close together saw the same link
_PAIRS, _LEAST_PAIRS = 15, 5
_SLOWER = 2.0  # a pair counts up to this multiple of the present packet time
_MOST_OVERHEAD = 0.8
_LATE = 3  # large trains whose fastest one counts
_LEAP = 2.0  # times what is believed: a receiver that slept stamps the packets it finds at its own pace
# Jitter alone reads as less than these; 802.11 spends at least 100 us on a packet.
_LEAST_OVERHEAD_S = 50e-6
_LEAST_OVERHEAD = 0.03  # of the time a large packet takes


class Seen(NamedTuple):
    """Capacity that a train saw (bytes/s), and whether that is its sender's pace, which the link carries at least."""

    rate: float
    is_bound: bool


class _Reading(NamedTuple):
    at_s: float
    packet_bytes: float
    packet_s: float
    is_bound: bool


class _Pair(NamedTuple):
    overhead_s: float
    is_bound: bool  # it is that or less
    packet_s: float  # of a large packet then


class TrainLog:
    """Readings of trains.

    A packet of s bytes takes T(s) = t_ovh + s/C of the link's time (docs/design.md, The program). Large packets alone
    cannot separate the two; a train of small ones right after one of large ones can: t_ovh = (T_small·s_large −
    T_large·s_small) / (s_large − s_small). Other traffic between the packets only makes a train longer, so the least
    recent T_large counts. Among the pairs the second least t_ovh counts: a link that changes inside one pair may make
    that pair read too little.

    Attributes
    ----------
    count : readings of large packets since `clear`
    newest_s : time of the newest of them (s)
    leap : bound that the newest of them saw, while it is far above what was believed, and the next has to confirm it
    """

    def __init__(self) -> None:
        self._large: deque[_Reading] = deque(maxlen=_LATE)
        self._fresh: list[_Reading] = []
        self._last_packet_s = 0.0  # of the last large train; outlives `clear`
        self._pairs: deque[_Pair] = deque(maxlen=_PAIRS)
        self.count, self.newest_s = 0, -math.inf
        self.leap: Seen | None = None

    def note(self, train: Train, now_s: float, *, copies: int = 1) -> None:
        """Note a train of a report; each of its packets crossed the link ``copies`` times, once per peer."""
        if train.packets < 1 or train.duration_s <= 0 or train.payload_bytes <= 0:
            return
        is_bound = train.sent_s >= _SENDER_LIMITED * train.duration_s
        packet_bytes, packet_s = train.payload_bytes / train.packets, train.duration_s / train.packets / copies
        reading = _Reading(now_s, packet_bytes, packet_s, is_bound)
        large = self._large[-1] if self._large else None
        if large is None or reading.packet_bytes > _SMALL * large.packet_bytes:
            self._large.append(reading)
            self._fresh.append(reading)
            self.count += 1
            self.newest_s, self._last_packet_s = now_s, reading.packet_s
        elif now_s - large.at_s <= _PAIR_S:
            least_s = min(each.packet_s for each in self._large)
            if reading.packet_s > least_s:
                return  # a small packet is never slower than a large one, so other traffic came in between
            excess = reading.packet_s * large.packet_bytes - least_s * reading.packet_bytes
            self._pairs.append(_Pair(excess / (large.packet_bytes - reading.packet_bytes), is_bound, least_s))

    def take(self, *, packet_overhead_s: float, believed: float) -> list[Seen]:
        """Return what large trains saw since the last call, C = s / (T − t_ovh).

        Parameters
        ----------
        believed : capacity; a bound far above it counts once the next train has seen so, too (bytes/s)
        """
        fresh, self._fresh = self._fresh, []
        taken: list[Seen] = []
        for each in fresh:
            free_s = max(each.packet_s - packet_overhead_s, 0.1 * each.packet_s)
            seen, before, self.leap = Seen(each.packet_bytes / free_s, each.is_bound), self.leap, None
            if not seen.is_bound or seen.rate <= _LEAP * believed:
                taken.append(seen)
            elif before is None:
                self.leap = seen
            else:
                taken += [before, seen]
        return taken

    def clear(self) -> None:
        """Forget the capacities; the overhead of a packet depends on the radio, and stays."""
        self._large.clear()
        self._fresh.clear()
        self.count, self.newest_s, self.leap = 0, -math.inf, None

    @property
    def packet_overhead_s(self) -> float:
        """t_ovh; 0 until it is known, and while jitter may explain it (s)."""
        if len(known := self._known()) < _LEAST_PAIRS:
            return 0.0
        pair = sorted(known)[1]
        if pair.is_bound or pair.overhead_s < max(_LEAST_OVERHEAD_S, _LEAST_OVERHEAD * self._last_packet_s):
            return 0.0
        return min(pair.overhead_s, _MOST_OVERHEAD * self._last_packet_s)

    @property
    def needs_pairs(self) -> bool:
        """True while too few pairs show the overhead on a link of this speed."""
        return not self._large or len(self._known()) < _LEAST_PAIRS

    def _known(self) -> list[_Pair]:
        """Return pairs of a link as fast as now: jitter on a slow link is as long as the overhead on a fast one."""
        return [pair for pair in self._pairs if pair.packet_s <= _SLOWER * self._last_packet_s]
