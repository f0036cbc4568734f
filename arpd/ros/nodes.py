"""Nodes that tell of their publishers, as far as the graph shows them; pure, in seconds of one monotonic clock."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from arpd.model.endpoints import MOST_PUBLISHERS, NodeSnapshot, PublisherState
from arpd.ros.crossing import Graph

if TYPE_CHECKING:
    from collections.abc import Mapping

    from arpd.model.plan import PlanAnswer
    from arpd.model.relay import RelaySummary

MOST_NODES = 500
SILENT_S = 4.5  # four snapshots missed: the node is gone


@dataclass(slots=True)
class _Node:
    snapshot: NodeSnapshot
    at_s: float
    shown: set[str] = field(default_factory=set)  # topics that the graph has shown it to write
    is_real: bool = False  # whether the graph has shown any
    states: list[PublisherState] | None = None  # made of all this when somebody asks


class Nodes:
    """Last snapshot of every node, by the GUID of the writer that sent it: a node that restarts has another one.

    A publisher counts once the graph has shown its node on the topic, so an invented one never counts. Publishers are
    bounded in all: of the node that comes last, those count that it made first.
    """

    def __init__(self) -> None:
        self._nodes: dict[bytes, _Node] = {}  # the one heard last at the end
        self._live: tuple[PublisherState, ...] | None = None  # None when something changed since
        self._live_until_s = -math.inf  # until then time alone changes nothing
        self._graph = Graph()

    @property
    def pending(self) -> int:
        """Number of publishers that the graph has not shown."""
        return sum(len(node.snapshot.publishers) - len(node.shown) for node in self._nodes.values())

    @property
    def topics(self) -> frozenset[str]:
        """Topics of all publishers; for any thread."""
        return frozenset(row["topic"] for node in [*self._nodes.values()] for row in node.snapshot.publishers)

    @property
    def left_out(self) -> Mapping[str, int]:
        """Number of publishers for which a node's snapshot, or this list of all, has no room, by node."""
        told = {node.snapshot.node: node.snapshot.left_out for node in self._nodes.values() if node.is_real}
        return {node: many for node, many in told.items() if many}

    @property
    def answers(self) -> Mapping[str, PlanAnswer]:
        """Answers to plans, by node."""
        return {node.snapshot.node: node.snapshot.answer for node in self._nodes.values()}

    def note(self, writer: bytes, snapshot: NodeSnapshot, now_s: float) -> bool:
        """Note a snapshot; return False when there is no room for it, or for all its publishers."""
        before, node = self._nodes.pop(writer, None), _Node(snapshot, now_s)
        if before is not None and before.snapshot.node == snapshot.node:
            node.shown = before.shown.intersection(row["topic"] for row in snapshot.publishers)
            node.is_real = before.is_real
        self._live = None
        self._look(node)
        if node.is_real and (self._room < len(snapshot.publishers) or len(self._nodes) >= MOST_NODES):
            # What the graph never showed gives way.
            self._nodes = {other: each for other, each in self._nodes.items() if each.is_real}
        if len(self._nodes) >= MOST_NODES:
            return False
        self._nodes[writer] = node
        if (beyond := -self._room) <= 0:
            return True
        fitting = snapshot.publishers[: len(snapshot.publishers) - beyond]
        node.snapshot = replace(snapshot, publishers=fitting, left_out=snapshot.left_out + beyond)
        node.shown.intersection_update(row["topic"] for row in fitting)
        return False

    @property
    def _room(self) -> int:
        return MOST_PUBLISHERS - sum(len(node.snapshot.publishers) for node in self._nodes.values())

    def see(self, graph: Graph) -> None:
        """Note what the graph shows now; the same object again is no change."""
        if graph is self._graph:
            return
        self._graph, self._live = graph, None
        for node in self._nodes.values():
            node.states = None
            self._look(node)

    def live(self, now_s: float) -> tuple[PublisherState, ...]:
        """Return the publishers of the nodes heard lately, sorted by node and topic.

        It is the same tuple until something arrives, expires, or the graph changes.
        """
        if self._live is not None and now_s <= self._live_until_s:
            return self._live
        self._nodes = {writer: node for writer, node in self._nodes.items() if now_s - node.at_s <= SILENT_S}
        found: dict[tuple[str, str], PublisherState] = {}
        for node in sorted(self._nodes.values(), key=lambda node: node.at_s):
            if node.states is None:
                node.states = [
                    # 4 µs; `dataclasses.replace` takes twice that.
                    PublisherState(**{**row, "announced_at_s": node.at_s, **self._graph.fields_of(row["topic"])})
                    for row in node.snapshot.publishers
                    if row["topic"] in node.shown
                ]
            # Of a node that restarted, and its predecessor, what was told last counts.
            found.update(((state.node, state.topic), state) for state in node.states)
        self._live_until_s = min((node.at_s for node in self._nodes.values()), default=math.inf) + SILENT_S
        self._live = tuple(state for _, state in sorted(found.items(), key=lambda pair: pair[0]))
        return self._live

    def _look(self, node: _Node) -> None:
        topics = {row["topic"] for row in node.snapshot.publishers} - node.shown
        if new := {topic for topic in topics if self._graph.shows_writer(node.snapshot.node, topic)}:
            node.shown |= new
            node.is_real = True
            node.states = self._live = None

    def relay(self, now_s: float) -> RelaySummary | None:
        """Return the newest summary of a relay, None when none was told lately."""
        recent = (node for node in self._nodes.values() if node.snapshot.relay and now_s - node.at_s <= SILENT_S)
        newest = max(recent, key=lambda node: node.at_s, default=None)
        return None if newest is None else newest.snapshot.relay
