"""Routes of relayed topics, chosen from their publishers: pure."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable


@dataclass(frozen=True, kw_only=True, slots=True)
class TopicWriter:
    """One writer of a relayed topic: its node, its type, and the QoS policies that decide who hears it."""

    node: str
    type_name: str
    is_reliable: bool
    is_latched: bool


@dataclass(frozen=True, kw_only=True, slots=True)
class Route:
    """Type and QoS by which a topic is relayed.

    Parameters
    ----------
    is_reliable, is_latched : what the relay's reader requests
    ignored : writers of another type, in words; empty if there are none
    """

    type_name: str
    is_reliable: bool
    is_latched: bool
    ignored: str = ""


@dataclass(frozen=True, kw_only=True, slots=True)
class RouteRefusal:
    """Reason why a topic is not relayed, in words."""

    reason: str


def own_output(topic: str, *, prefix: str, output: str) -> RouteRefusal | None:
    """Refuse a topic that is the relay's own output: relayed again, its name would nest, ``/link/link/…``.

    Parameters
    ----------
    output : name under which the topic would be republished, remapping rules applied
    """
    if output == topic:
        return RouteRefusal(reason="a remapping rule gives its output the same name; remove the rule")
    if topic == prefix or topic.startswith(f"{prefix}/"):
        return RouteRefusal(reason=f"it already carries the prefix {prefix}; name the topic without it")
    return None


def choose_route(
    sources: Iterable[TopicWriter],
    *,
    carriers: Collection[str],
    output: str,
    output_readers: Collection[str],
    in_force: Route | None,
) -> Route | RouteRefusal | None:
    """Choose the route of a topic from its writers; None while there are none.

    Parameters
    ----------
    carriers : the relay's nodes
    output : name under which the topic is republished
    output_readers : nodes that read the output
    in_force : its route until now
    """
    sources = tuple(sources)
    if not sources:
        return None
    nodes = {source.node for source in sources}
    if own := ", ".join(sorted(nodes.intersection(carriers))):
        return RouteRefusal(reason=f"{own} publishes it itself, so its output would be its own input")
    if loop := ", ".join(sorted(nodes.intersection(output_readers))):
        return RouteRefusal(reason=f"{loop} reads {output} and publishes it, so messages would loop")
    types = {source.type_name for source in sources}
    # A stray writer of another type must not stop what already flows.
    kept = in_force if in_force is not None and in_force.type_name in types else None
    if kept is None and len(types) > 1:
        return RouteRefusal(reason=f"it has more than one type: {_by_type(sources)}")
    type_name = kept.type_name if kept else types.pop()
    same = [source for source in sources if source.type_name == type_name]
    return Route(
        type_name=type_name,
        # A reliable reader does not hear a best-effort writer, so the weakest writer decides.
        is_reliable=all(source.is_reliable for source in same),
        # Latched topics (/map, /tf_static) stay latched: late joiners on the far side would miss them otherwise. A
        # topic once relayed as volatile stays volatile: a latched reader would receive everything again.
        is_latched=all(source.is_latched for source in same) and (kept is None or kept.is_latched),
        ignored=_by_type(source for source in sources if source.type_name != type_name),
    )


def _by_type(sources: Iterable[TopicWriter]) -> str:
    return ", ".join(sorted({f"{source.type_name} from {source.node}" for source in sources}))
