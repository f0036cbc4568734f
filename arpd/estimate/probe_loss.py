"""How many of the probe packets never arrive."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from arpd.model.probing import PeerReport, ProbeRequest

_WINDOW_S = 20.0  # 250 packets on a fast link, 50 on a slow one
_LEAST_PACKETS = 20  # fewer tell nothing
_MOST_SENT = 1000  # probes remembered: a minute and more
_OVERTAKING = 32  # packets that may come after the first of a later probe, or twice; more is a peer that started anew
_COUNTS = 2**32  # on the wire


class ProbeLoss:
    """Share of the probe packets of the last seconds that never reached a peer.

    A peer counts the packets of all probes before the last one whose first packet it has. As probes overtake nobody on
    the link, what it lacks of those is lost; what is under way belongs to the last one or to later ones. Counts go on
    and on, so that reports may be lost.
    """

    def __init__(self) -> None:
        self._sent = 0  # packets so far
        self._sent_before: dict[int, int] = {}  # by number of the probe: packets of all before it
        self._marks: dict[str, deque[tuple[float, int, int]]] = {}  # by peer: when s, packets sent, packets it has

    def note_sent(self, request: ProbeRequest) -> None:
        """Note a probe that leaves."""
        self._sent_before[request.number] = self._sent
        self._sent += request.packets
        while len(self._sent_before) > _MOST_SENT:
            del self._sent_before[next(iter(self._sent_before))]

    def digest(self, report: PeerReport) -> None:
        """Note what a report counts; one of a peer that does not count says nothing."""
        sent = self._sent_before.get(report.last_probe)
        if sent is None or report.probe_packets is None:
            return
        marks = self._marks.setdefault(report.peer, deque())
        if marks:
            _, sent_then, received_then = marks[-1]
            received = (report.probe_packets - received_then) % _COUNTS
            if received > sent - sent_then + _OVERTAKING:
                marks.clear()
            elif sent <= sent_then:
                return  # nothing new, or overtaken by a later report
        marks.append((report.received_at_s, sent, report.probe_packets))

    def ratio(self, now_s: float) -> float | None:
        """Return the share that was lost, of all peers together; None when too few packets were sent to tell."""
        sent = received = 0
        for peer, marks in tuple(self._marks.items()):
            while marks and now_s - marks[0][0] > _WINDOW_S:
                marks.popleft()
            if not marks:
                del self._marks[peer]
                continue
            sent += marks[-1][1] - marks[0][1]
            received += (marks[-1][2] - marks[0][2]) % _COUNTS
        return max(0.0, 1.0 - received / sent) if sent >= _LEAST_PACKETS else None
