"""What the decision log says of the link: outages, the interface, the peers, and who is in charge."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from arpd.model.interface import InterfaceState, state_of
from arpd.model.link import LinkState
from arpd.model.settings import AUTO
from arpd.report.events import EventKind, Severity
from arpd.report.wording import Episode, Said, count, duration, listed, rate

if TYPE_CHECKING:
    from collections.abc import Iterator

    from arpd.report.snapshot import Snapshot
    from arpd.report.wording import Turn

_PEER_LOST_S = 10.0  # a peer with nothing to do reports every second or two
_REPORTED_S = 3.0  # an outage of its own ends with a report


class LinkLog:
    """Outages: a bad radio may go out every second, and still writes a few lines a minute."""

    def __init__(self) -> None:
        self._outage = Episode()
        self._silent_s = 0.0  # before it was known to be an outage

    def follow(self, snapshot: Snapshot) -> Iterator[Said]:
        """Return what happened since the snapshot before."""
        is_out = snapshot.link.state is LinkState.OUTAGE
        if is_out and not self._outage.holds:
            self._silent_s = min(snapshot.observation.peer_ages_s.values(), default=0.0)
        if (turn := self._outage.look(snapshot.finished_at_s, holds=is_out)) is not None:
            yield self._out(turn) if turn.holds else self._back(turn, snapshot)

    def _out(self, turn: Turn) -> Said:
        since = f" since {duration(self._silent_s)} ago" if self._silent_s and not turn.untold else ""
        return Said(
            EventKind.OUTAGE,
            Severity.WARNING,
            f"{_untold(turn)}the link carries nothing{since}: floors only",
            details={"untold": str(turn.untold)} if turn.untold else {},
        )

    def _back(self, turn: Turn, snapshot: Snapshot) -> Said:
        capacity = snapshot.link.capacity_bytes_per_second
        lasted_s = turn.lasted_s + self._silent_s
        details = {"capacity_bytes_per_second": f"{capacity:.6g}"}
        if turn.untold:
            text = f"{_untold(turn)}the link carries now, at {rate(capacity)}"
            details["untold"] = str(turn.untold)
        elif not _is_heard(snapshot):
            # Nothing was measured: what is told must not sound as if the link were known to be well.
            text = f"silence is no outage any more, after {duration(lasted_s)}: no peer reports, but others are heard"
        else:
            text = f"the link carries again after {duration(lasted_s)}, at {rate(capacity)}"
        if not turn.untold:
            details["outage_seconds"] = f"{lasted_s:.3f}"
        return Said(EventKind.RECOVERED, Severity.INFO, text, details=details)


def _is_heard(snapshot: Snapshot) -> bool:
    ages_s = snapshot.observation.peer_ages_s
    return bool(ages_s) and min(ages_s.values()) < _REPORTED_S


def _untold(turn: Turn) -> str:
    return f"{count(turn.untold, 'more outage')} in the last minute; " if turn.untold else ""


class InterfaceLog:
    """The state of the link interface, and the name it is found under."""

    def __init__(self) -> None:
        self._state: InterfaceState | None = None
        self._name = ""
        self._was_there = False

    def follow(self, snapshot: Snapshot) -> Iterator[Said]:
        """Return what happened since the snapshot before."""
        state, name = state_of(snapshot.observation.counters), snapshot.interface
        if state is self._state and name == self._name:
            return
        was, called, self._state, self._name = self._state, self._name, state, name
        was_there, self._was_there = self._was_there, self._was_there or state is not InterfaceState.GONE
        if was is None and state is InterfaceState.UP:
            return
        details = {"interface": name, "state": str(state)}
        if not (was_there or self._was_there):
            text = "no link interface is there yet" if name == AUTO else f"{name} is not there yet"
            yield Said(EventKind.INTERFACE, Severity.WARNING, text, details=details)
        elif state is was:
            text = f"the link interface {called} is now called {name}"
            yield Said(EventKind.INTERFACE, Severity.INFO, text, details=details)
        elif state is InterfaceState.UP:
            yield Said(EventKind.INTERFACE, Severity.INFO, f"{name} is up", details=details)
        else:
            yield Said(EventKind.INTERFACE, Severity.ERROR, f"{name} {state.fault}", details=details)


class PeerLog:
    """Peers that come and go. While the link is out nobody can be told from the link, so nobody is lost."""

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
                f"{_peers(found)} {_is(found)} found",
                details={"peers": " ".join(found)},
            )
        has_patience = now_s - self._judged_since_s < _PEER_LOST_S
        if not has_patience and math.isfinite(self._judged_since_s) and (lost := sorted(self._known - there)):
            self._known &= there
            then = "nobody reports what the link delivers" if not there else f"{count(len(there), 'peer')} left"
            yield Said(
                EventKind.PEER_LOST,
                Severity.WARNING,
                f"{_peers(lost)} {_is(lost)} lost, nothing heard for {duration(_PEER_LOST_S)}: {then}",
                details={"peers": " ".join(lost)},
            )


def _peers(names: list[str]) -> str:
    return f"{'peer' if len(names) == 1 else 'peers'} {listed(names)}"


def _is(names: list[str]) -> str:
    return "is" if len(names) == 1 else "are"


class LeaderLog:
    """Which of several daemons drives the robot; two of them are rarely meant."""

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
        if observation.active_daemon:
            if observation.active_daemon != active_before:
                text = f"another arpd daemon, on {observation.active_daemon}, has run for longer: standing by"
                yield Said(EventKind.STANDING_BY, Severity.WARNING, text, details=details)
        elif observation.other_daemons:
            text = f"in charge; another arpd daemon stands by, on {listed(observation.other_daemons)}"
            yield Said(EventKind.IN_CHARGE, Severity.WARNING, text, details=details)
        else:
            yield Said(EventKind.IN_CHARGE, Severity.INFO, "no other arpd daemon is left: in charge", details=details)
