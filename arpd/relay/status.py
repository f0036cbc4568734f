"""Status lines of the relay."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping

    from arpd.relay.offers import EndState

MOST_NAMED = 3  # in one part of the line


def status_line(
    *,
    is_far: bool,
    fault: str,
    state: EndState | None,
    is_reachable: bool,
    is_shared: bool,
    offered: int,
    carried: int,
    wanted: int,
    second_ends: Collection[str],
    others: Collection[str],
    refused: Mapping[str, str],
    differ: Mapping[str, str],
) -> str:
    """Return one line for ``systemctl status``.

    Parameters
    ----------
    is_far : whether this is the base computer's end
    fault : of the other end's messages, empty if there is none
    state, is_reachable : of the other end
    is_shared : whether both ends are in one ROS domain
    offered, carried, wanted : topics that may leave, that leave, and of the other side that somebody reads here
    second_ends : hosts of further ends on the other side
    others : nodes in the link domain that are not arpd's
    refused, differ : topics that do not enter, or have another type here, and the reason
    """
    here, there = ("base computer", "robot") if is_far else ("robot", "base computer")
    if fault:
        return f"the {there}'s end is not understood: {fault}"
    if state is None:
        return f"waiting for the {there}'s end; {offered} topics of the {here} could cross"
    if is_shared:
        return (
            "nothing crosses: both ends are in one ROS domain and see each other there; give the two sides different "
            "ROS_DOMAIN_IDs, or the ends ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST"
        )
    line = f"{carried} of {offered} topics cross to the {there}, {wanted} of {len(state.topics)} to the {here}"
    if not is_reachable:
        line = f"the {there}'s end is silent; {line}"
    if others:
        line += f"; the link domain has other nodes ({', '.join(others)}): only arpd's may live there"
    if second_ends:
        line += f"; ignored another {there}'s end on {', '.join(second_ends)}: one robot has one"
    line += _named("refused", refused) + _named(f"the {there}'s end refuses", state.refused)
    return line + _named("two types of", differ)


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
