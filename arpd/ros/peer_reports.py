"""Admission of receiver reports: which are believed, and how far."""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from typing import TYPE_CHECKING

from arpd.model.observation import MessageRefusal

if TYPE_CHECKING:
    from arpd.model.probing import PeerReport

_MOST_PEERS = 32
_SILENT_S = 10.0  # then another peer may take the place of a silent one
_NUMBERS = 2**32  # of probe numbers, on the wire
_LATELY = 1000  # probes: 100 s and more
_MOST_BYTES_PER_SECOND = 100e9 / 8  # no robot has a faster network interface
_RADIO_S = 60.0
_RADIO_MARGIN = 2.0


class Ceiling:
    """Upper bound on the rate of this host's link; no report may exceed it (bytes/s).

    A wired interface states its speed. The bit rate of a radio changes with every packet and is low while it idles, so
    twice the best of the last minute is the bound.
    """

    def __init__(self) -> None:
        self._interface: float | None = None
        self._radio: deque[tuple[float, float]] = deque()

    def note(self, now_s: float, *, interface: float | None, radio: float | None) -> None:
        """Note the rates that both state now; None = nothing (bytes/s)."""
        self._interface = interface
        if radio is not None:
            self._radio.append((now_s, radio))
        while self._radio and now_s - self._radio[0][0] > _RADIO_S:
            self._radio.popleft()

    @property
    def bytes_per_second(self) -> float:
        """Upper bound now."""
        radio = max((rate for _, rate in self._radio), default=None)
        stated = (self._interface, None if radio is None else _RADIO_MARGIN * radio)
        return min([_MOST_BYTES_PER_SECOND, *(rate for rate in stated if rate)])


class PeerAdmission:
    """Admits reports that answer a probe of this daemon, from no more peers than the graph shows.

    Probe numbers start at a random number, so only a receiver of the probes can answer them. While none was sent,
    because the capacity is pinned, there is nothing to answer.

    Parameters
    ----------
    base : the random number, below 2^32
    """

    def __init__(self, base: int) -> None:
        self._base = base
        self._newest = 0
        self._heard_s: dict[str, float] = {}
        self._peers: int | None = None

    def number(self, probe: int) -> int:
        """Return the number of a probe on the wire; reports may answer it from now on."""
        self._newest = max(self._newest, probe)
        return (self._base + probe) % _NUMBERS

    def see(self, peers: int) -> None:
        """Note how many peers the graph shows; so many names are admitted, known ones first."""
        self._peers = peers

    def check(self, report: PeerReport, now_s: float, *, ceiling: float) -> PeerReport | MessageRefusal:
        """Return the part of a report to believe, with our own number of its probe, or why it is refused.

        Parameters
        ----------
        ceiling : upper bound on the rate of the link (bytes/s)
        """
        answered = (report.last_probe - self._base) % _NUMBERS
        is_answer = 0 < answered <= self._newest and self._newest - answered <= _LATELY
        if self._newest and not (is_answer and report.last_probe):
            return MessageRefusal.UNANSWERED
        if not self._has_room(report.peer, now_s):
            return MessageRefusal.QUOTA
        return replace(
            report,
            last_probe=answered if is_answer else 0,
            rx_bytes=min(report.rx_bytes, int(ceiling * report.interval_s)),
            trains=tuple(
                replace(train, duration_s=max(train.duration_s, train.payload_bytes / ceiling))
                for train in report.trains
            ),
        )

    def _has_room(self, name: str, now_s: float) -> bool:
        self._heard_s = {peer: at_s for peer, at_s in self._heard_s.items() if now_s - at_s <= _SILENT_S}
        most = _MOST_PEERS if self._peers is None else min(_MOST_PEERS, max(1, self._peers))
        if name not in self._heard_s and len(self._heard_s) >= most:
            return False
        self._heard_s[name] = now_s
        return True
