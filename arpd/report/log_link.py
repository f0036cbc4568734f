"""Events of the link: outages, the interface, the peers, and the daemon that drives the robot."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from arpd.model.interface import InterfaceState, state_of
from arpd.model.link import LinkState
from arpd.model.quantities import format_duration, format_rate
from arpd.report.event_limits import Episode
from arpd.report.events import EventKind, Said, Severity
from arpd.report.situation import Condition, interface_fault, standing_by
from arpd.report.wording import AT_FLOORS, count, listed

if TYPE_CHECKING:
    from collections.abc import Iterator

    from arpd.report.event_limits import Turn
    from arpd.report.snapshot import Snapshot

_PEER_LOST_S = 10.0  # a peer with nothing to do reports every second or two
_REPORTED_S = 3.0  # over a link that carries again, reports arrive


class LinkLog:
    """Outages: a bad radio may go out every second, and still writes a few lines a minute."""

    def __init__(self) -> None:
        self._outage = Episode()
        self._silent_s = 0.0  # before the estimator knew that it was an outage

    def follow(self, snapshot: Snapshot) -> Iterator[Said]:
        """Return what happened since the snapshot before."""
        is_out = snapshot.link.state is LinkState.OUTAGE
        if is_out and not self._outage.holds:
            self._silent_s = min(snapshot.observation.peer_ages_s.values(), default=0.0)
        if (turn := self._outage.look(snapshot.finished_at_s, holds=is_out)) is not None:
            yield self._out(turn) if turn.holds else self._back(turn, snapshot)

    def _out(self, turn: Turn) -> Said:
        since = f" since {format_duration(self._silent_s)} ago" if self._silent_s and not turn.untold else ""
        return Said(
            EventKind.OUTAGE,
            Condition.OUTAGE.severity,
            f"{_untold(turn)}{Condition.OUTAGE.phrase}{since}: {AT_FLOORS}",
            details={"untold": str(turn.untold)} if turn.untold else {},
        )

    def _back(self, turn: Turn, snapshot: Snapshot) -> Said:
        capacity = snapshot.link.capacity_bytes_per_second
        lasted_s = turn.lasted_s + self._silent_s
        details = {"capacity_bytes_per_second": f"{capacity:.6g}"}
        if turn.untold:
            text = f"{_untold(turn)}the link carries now, at {format_rate(capacity)}"
            details["untold"] = str(turn.untold)
        elif not _is_heard(snapshot):
            # Nothing was measured: the sentence must not claim that the link is well.
            text = f"no longer an outage after {format_duration(lasted_s)}: other hosts answer, only the peer is silent"
        else:
            text = f"the link carries again after {format_duration(lasted_s)}, at {format_rate(capacity)}"
        if not turn.untold:
            details["outage_seconds"] = f"{lasted_s:.3f}"
        return Said(EventKind.RECOVERED, Severity.INFO, text, details=details)


def _is_heard(snapshot: Snapshot) -> bool:
    return min(snapshot.observation.peer_ages_s.values(), default=math.inf) < _REPORTED_S


def _untold(turn: Turn) -> str:
    return f"{count(turn.untold, 'more outage')} in the last minute; " if turn.untold else ""


class InterfaceLog:
    """The state of the link interface, and its name."""

    def __init__(self) -> None:
        self._state: InterfaceState | None = None
        self._name = ""

    def follow(self, snapshot: Snapshot) -> Iterator[Said]:
        """Return what happened since the snapshot before."""
        state, name = state_of(snapshot.observation.counters), snapshot.interface
        if state is self._state and name == self._name:
            return
        state_before, name_before, self._state, self._name = self._state, self._name, state, name
        if state_before is None and state is InterfaceState.UP:
            return
        details = {"interface": name, "state": str(state)}
        fault = interface_fault(snapshot)
        if state is state_before and snapshot.has_interface:
            text = f"the link interface {name_before} is now called {name}"
            yield Said(EventKind.INTERFACE, Severity.INFO, text, details=details)
        elif fault is None:
            yield Said(EventKind.INTERFACE, Severity.INFO, f"{name} is up", details=details)
        else:
            condition, text = fault
            yield Said(EventKind.INTERFACE, condition.severity, text, details=details)


class PeerLog:
    """Peers that come and go. During an outage every peer is silent, so none is lost."""

    def __init__(self) -> None:
        self._known: set[str] = set()
        self._judged_since_s = math.inf

    def follow(self, snapshot: Snapshot) -> Iterator[Said]:
        """Return what happened since the snapshot before."""
        now_s, ages_s = snapshot.finished_at_s, snapshot.observation.peer_ages_s
        if not (ages_s or self._known):
            return
        if snapshot.link.state is LinkState.OUTAGE:
            self._judged_since_s = math.inf
        elif math.isinf(self._judged_since_s):
            self._judged_since_s = now_s
        there = {peer for peer, age_s in ages_s.items() if age_s < _PEER_LOST_S}
        if found := sorted(there - self._known):
            self._known |= there
            yield Said(
                EventKind.PEER_FOUND,
                Severity.INFO,
                f"{_peers(found)} found",
                details={"peers": " ".join(found)},
            )
        has_patience = now_s - self._judged_since_s < _PEER_LOST_S
        if not has_patience and math.isfinite(self._judged_since_s) and (lost := sorted(self._known - there)):
            self._known &= there
            then = f"{count(len(there), 'peer')} left" if there else "nobody reports what the link delivers"
            yield Said(
                EventKind.PEER_LOST,
                Severity.WARNING,
                f"{_peers(lost)} lost, silent for {format_duration(_PEER_LOST_S)}: {then}",
                details={"peers": " ".join(lost)},
            )


def _peers(names: list[str]) -> str:
    return f"peer {listed(names)} is" if len(names) == 1 else f"peers {listed(names)} are"


class LeaderLog:
    """The one of several daemons that drives the robot; two of them are rarely meant."""

    def __init__(self) -> None:
        self._others: tuple[tuple[str, ...], str] = ((), "")

    def follow(self, snapshot: Snapshot) -> Iterator[Said]:
        """Return what happened since the snapshot before."""
        observation = snapshot.observation
        if (others := (observation.other_daemons, observation.active_daemon)) == self._others:
            return
        _, active_before = self._others
        self._others = others
        details = {"other_daemons": " ".join(observation.other_daemons)}
        if (other := standing_by(snapshot)) is not None:
            if observation.active_daemon != active_before:
                yield Said(EventKind.STANDING_BY, other.condition.severity, other.phrase, details=details)
        elif observation.other_daemons:
            text = f"in charge; another arpd daemon stands by, on {listed(observation.other_daemons)}"
            yield Said(EventKind.IN_CHARGE, Severity.WARNING, text, details=details)
        else:
            yield Said(EventKind.IN_CHARGE, Severity.INFO, "in charge; no other arpd daemon is left", details=details)
