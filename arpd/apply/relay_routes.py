"""How one topic is relayed, decided from who publishes it: pure."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable


@dataclass(frozen=True, kw_only=True, slots=True)
class TopicWriter:
    """One writer of a topic to be relayed: its node, its type, the QoS policies that decide who hears it."""

    node: str
    type_name: str
    is_reliable: bool
    is_latched: bool


@dataclass(frozen=True, kw_only=True, slots=True)
class Route:
    """How to carry a topic.

    Parameters
    ----------
    type_name : message type
    is_reliable, is_latched : what the relay's reader requests
    ignored : writers of another type, in words, empty if there are none
    """

    type_name: str
    is_reliable: bool
    is_latched: bool
    ignored: str = ""


@dataclass(frozen=True, kw_only=True, slots=True)
class RouteRefusal:
    """Why a topic is not carried, in words."""

    reason: str


def own_output(topic: str, *, prefix: str, output: str) -> RouteRefusal | None:
    """Refuse a topic that is relayed already, by its name: carried again it would nest, ``/link/link/…``.

    Parameters
    ----------
    output : what the topic would be carried to, remapping rules applied
    """
    if output == topic:
        return RouteRefusal(reason="a remapping rule carries it to itself")
    if topic == prefix or topic.startswith(f"{prefix}/"):
        return RouteRefusal(reason=f"it already carries the prefix {prefix}; name the topic without it")
    return None


def choose_route(
    sources: Iterable[TopicWriter],
    *,
    carrier: str,
    output: str,
    output_readers: Collection[str],
    in_force: Route | None,
) -> Route | RouteRefusal | None:
    """Tell how to carry a topic that these writers publish, None while nobody does.

    Parameters
    ----------
    carrier : node that carries
    output : topic it would be carried to
    output_readers : nodes that read it
    in_force : how it is carried now
    """
    sources = tuple(sources)
    if not sources:
        return None
    nodes = {source.node for source in sources}
    if carrier in nodes:
        return RouteRefusal(reason=f"{carrier} publishes it itself, so its output would be its own input")
    if circle := ", ".join(sorted(nodes.intersection(output_readers))):
        return RouteRefusal(reason=f"{circle} reads {output} and publishes it, so messages would go round in circles")
    types = {source.type_name for source in sources}
    # A stray writer of another type must not take away what already flows.
    kept = in_force.type_name if in_force is not None and in_force.type_name in types else None
    if kept is None and len(types) > 1:
        return RouteRefusal(reason=f"it has more than one type: {_by_type(sources)}")
    type_name = kept or types.pop()
    same = [source for source in sources if source.type_name == type_name]
    return Route(
        type_name=type_name,
        # A reliable reader does not hear a best-effort writer, so the weakest writer decides.
        is_reliable=all(source.is_reliable for source in same),
        # Latched topics (/map, /tf_static) stay latched, or late joiners on the far side would never see them. Once
        # carried as volatile a topic stays so: a latched reader would be sent everything again.
        is_latched=all(source.is_latched for source in same) and (kept is None or _is_latched(in_force)),
        ignored=_by_type(source for source in sources if source.type_name != type_name),
    )


def _is_latched(route: Route | None) -> bool:
    return route is not None and route.is_latched


def _by_type(sources: Iterable[TopicWriter]) -> str:
    return ", ".join(sorted({f"{source.type_name} from {source.node}" for source in sources}))
