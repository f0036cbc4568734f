"""What the peers report, as far as it is believed."""

from __future__ import annotations

import math
import threading
from collections import deque
from dataclasses import replace
from typing import TYPE_CHECKING

from arpd.estimate.peer_clocks import PeerClocks
from arpd.model.observation import MessageRefusal

if TYPE_CHECKING:
    from collections.abc import Mapping

    from arpd.model.probing import ClockOffset, PeerReport

_MOST_PEERS = 32
_SILENT_S, FORGOTTEN_S = 10.0, 60.0  # then another peer may take its place; a scrape or two must see its age grow
_NUMBERS = 2**32  # of probe numbers, on the wire
_LATELY = 1000  # probes: 100 s and more
_ASKS_S = 5.0  # since the last probe; pings leave more often


class PeerReports:
    """Keeps the reports that answer a probe of this daemon, from no more peers than the graph shows; for any thread.

    Probe numbers start at a random number, so only a receiver of the probes can answer them. While none leaves,
    because the capacity is pinned, there is nothing to answer.

    Parameters
    ----------
    base : the random number, below 2^32
    """

    def __init__(self, base: int) -> None:
        self._lock = threading.Lock()
        self._base = base
        self._newest, self._asked_s = 0, -math.inf  # the last probe, and when it left
        self._most_peers = _MOST_PEERS
        self._heard_s: dict[str, float] = {}  # when each reported last
        self._clocks = PeerClocks()
        self._waiting: deque[PeerReport] = deque(maxlen=200)  # for a tick

    def number(self, probe: int, now_s: float) -> int:
        """Return the number of a probe on the wire; reports may answer it from now on."""
        with self._lock:
            self._newest, self._asked_s = max(self._newest, probe), now_s
            return (self._base + probe) % _NUMBERS

    def see(self, peers: int) -> None:
        """Note how many peers the graph shows; so many names are admitted, known ones first."""
        self._most_peers = min(_MOST_PEERS, max(1, peers))

    def note(self, report: PeerReport, *, must_answer: bool = True) -> MessageRefusal | None:
        """Keep a report, with our own number of its probe, or return why it is refused.

        It need not answer while another daemon sends the probes.
        """
        with self._lock:
            answered = (report.last_probe - self._base) % _NUMBERS
            is_answer = 0 < answered <= self._newest and self._newest - answered <= _LATELY
            now_s = report.received_at_s
            is_asking = now_s - self._asked_s < _ASKS_S
            if must_answer and is_asking and not (is_answer and report.last_probe):
                return MessageRefusal.UNANSWERED
            lately = [peer for peer, at_s in self._heard_s.items() if now_s - at_s <= _SILENT_S]
            if report.peer not in lately and len(lately) >= self._most_peers:
                return MessageRefusal.QUOTA
            self._heard_s[report.peer] = now_s
            believed = replace(report, last_probe=answered if is_answer else 0)
            self._waiting.append(believed)
            self._clocks.note(believed)
        return None

    def take(self, now_s: float) -> tuple[tuple[PeerReport, ...], Mapping[str, float], Mapping[str, ClockOffset]]:
        """Return the reports since the last call, the time since each peer's last one (s), and the peers' clocks."""
        with self._lock:
            reports = tuple(self._waiting)
            self._waiting.clear()
            self._heard_s = {peer: at_s for peer, at_s in self._heard_s.items() if now_s - at_s <= FORGOTTEN_S}
            ages_s = {peer: max(0.0, now_s - at_s) for peer, at_s in sorted(self._heard_s.items())}
            return reports, ages_s, self._clocks.offsets(now_s)
