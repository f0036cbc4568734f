"""What the relay says of itself: status lines, and the topics of each direction for its summary."""

from __future__ import annotations

from typing import TYPE_CHECKING

from arpd.model.relay import RelaySummary, RelayTopics
from arpd.ros.names import is_arpds

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping

    from arpd.relay.ends.offers import EndState

MOST_NAMED = 3  # in one part of the line
ONE_DOMAIN = (
    "both ends are in one ROS domain and see each other there; give the two sides different ROS_DOMAIN_IDs, or "
    "nodes and ends ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST, no ROS_STATIC_PEERS and no shared ROS_DISCOVERY_SERVER"
)


def topics_of(sender: EndState, receiver: EndState) -> RelayTopics:
    """Return the topics of one direction; those that only arpd's nodes write are none that a user waits for.

    An end mostly refuses what would enter its side; only a name that nobody offers there has to leave it.
    """
    entering = {*sender.topics, *sender.services}
    leaving = {*receiver.topics, *receiver.services}
    refused = {name: _said(sender, reason) for name, reason in sender.refused.items() if name not in leaving}
    refused |= {name: _said(receiver, reason) for name, reason in receiver.refused.items() if name in entering}
    wanted = sender.topics.keys() & receiver.wants
    users = {name for name, offer in sender.topics.items() if not all(is_arpds(each.node) for each in offer.writers)}
    return RelayTopics(offered=len(users | wanted), wanted=len(wanted), refused=refused)


def status_line(relay: RelaySummary, *, is_far: bool, is_met: bool, second_ends: Collection[str]) -> str:
    """Return one line for ``systemctl status``.

    Parameters
    ----------
    is_far : whether this is the base computer's end
    is_met : whether it knows the other end
    second_ends : hosts of further ends on the other side
    """
    here, there, leaving, entering = "robot", "base computer", relay.to_base, relay.to_robot
    if is_far:
        here, there, leaving, entering = there, here, entering, leaving
    if relay.fault:
        return f"the {there}'s end cannot be used: {relay.fault}"
    if not is_met:
        return f"waiting for the {there}'s end; {leaving.offered} topics of the {here} could cross"
    cross = "cross" if relay.is_reachable else "wait to cross"
    line = (
        f"{leaving.wanted} of {leaving.offered} topics {cross} to the {there}, "
        f"{entering.wanted} of {entering.offered} to the {here}"
    )
    if not relay.is_reachable:
        line = f"the {there}'s end is silent; {line}"
    if relay.strangers:
        line += f"; the link domain has other nodes ({', '.join(relay.strangers)}): only arpd's may live there"
    if second_ends:
        line += f"; ignored another {there}'s end on {', '.join(second_ends)}: one robot has one"
    return line + _named("refused", {**leaving.refused, **entering.refused})


def _said(end: EndState, reason: str) -> str:
    """Return a reason with the host that its "here" means: the daemon and the other end name it, too."""
    return f"on {end.host}: {reason}"


def prefix_line(*, topics: int, silent: Collection[str], refused: Mapping[str, str], ignored: Mapping[str, str]) -> str:
    """Return the same for a relay with one end.

    Parameters
    ----------
    topics : number of those that it shall carry
    silent : those without a publisher
    refused, ignored : those that it cannot carry, and the reason; those of which writers are ignored, and their types
    """
    line = f"relaying {topics - len(silent) - len(refused)} of {topics} topics"
    if silent:
        line += f"; not published: {', '.join(silent)}"
    return line + _named("refused", refused) + _named("ignored on", ignored)


def _named(what: str, reasons: Mapping[str, str]) -> str:
    """Return the first of them with its reason, and the names of some others; empty if there are none."""
    if not reasons:
        return ""
    first, *more = sorted(reasons)
    named = ", ".join(more[:MOST_NAMED]) + (f" and {len(more) - MOST_NAMED} more" if len(more) > MOST_NAMED else "")
    return f"; {what} {first}: {reasons[first]}" + (f"; also {named}" if more else "")
