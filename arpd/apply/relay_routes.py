"""Topics that a relay with one end must not carry: pure."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Collection


def own_output(topic: str, *, prefix: str, output: str) -> str:
    """Return why a topic is the relay's own output, in words; empty if it is not.

    Relayed again, its name would nest, ``/link/link/…``.

    Parameters
    ----------
    output : name under which the topic would be republished, remapping rules applied
    """
    if output == topic:
        return "a remapping rule gives its output the same name; remove the rule"
    if topic == prefix or topic.startswith(f"{prefix}/"):
        return f"it already carries the prefix {prefix}; name the topic without it"
    return ""


def circle(sources: Collection[str], *, carriers: Collection[str], output: str, output_readers: Collection[str]) -> str:
    """Return how messages of a topic would go round, in words; empty if they would not.

    Parameters
    ----------
    sources : nodes that publish it
    carriers : the relay's nodes
    output, output_readers : name under which it is republished, and the nodes that read that
    """
    if own := ", ".join(sorted(set(sources).intersection(carriers))):
        return f"{own} publishes it itself, so its output would be its own input"
    if loop := ", ".join(sorted(set(sources).intersection(output_readers))):
        return f"{loop} reads {output} and publishes it, so messages would loop"
    return ""
