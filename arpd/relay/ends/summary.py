"""Summary of the relay, which the robot's end tells the daemon with its node's snapshots: pure."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from arpd.model.relay import RelaySummary, RelayTopics
from arpd.relay.offers import EndState

if TYPE_CHECKING:
    from arpd.relay.ends.calls import Calls
    from arpd.relay.ends.incoming import Incoming
    from arpd.relay.ends.link_thread import LinkThread
    from arpd.relay.ends.outgoing import Outgoing

_NOBODY = EndState(session="", number=0)


def summary(
    here: EndState, there: EndState | None, *, counted: tuple[Incoming, Outgoing, Calls, LinkThread], **known: Any
) -> RelaySummary:
    """Return the summary.

    Parameters
    ----------
    here, there : states of the robot's end and the other
    counted : parts of the robot's end that count
    known : further fields of the summary, which only the end knows
    """
    there = there or _NOBODY
    incoming, outgoing, calls, link = counted
    return RelaySummary(
        other_host=there.host,
        to_base=topics_of(here, there),
        to_robot=topics_of(there, here),
        received=incoming.received,
        doubled=incoming.doubled,
        unknown=incoming.unknown,
        outdated=incoming.outdated,
        link_bytes=link.link_bytes,
        incomplete=outgoing.incomplete,
        calls_failed=dict(calls.failures),
        **known,
    )


def topics_of(sender: EndState, receiver: EndState) -> RelayTopics:
    """Return the topics of one direction.

    An end mostly refuses what would enter its side; only a name that nobody offers there has to leave it.
    """
    entering = {*sender.topics, *sender.services}
    leaving = {*receiver.topics, *receiver.services}
    refused = {name: reason for name, reason in sender.refused.items() if name not in leaving}
    refused |= {name: reason for name, reason in receiver.refused.items() if name in entering}
    return RelayTopics(offered=len(sender.topics), wanted=len(sender.topics.keys() & receiver.wants), refused=refused)
