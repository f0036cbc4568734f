"""Parameter calls that apply transitions: one atomic call per node, repeated with back-off, without waiting."""

from __future__ import annotations

import logging
from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from rcl_interfaces.srv import SetParametersAtomically
from rclpy.parameter import Parameter

from arpd.adapters.ros.names import (
    DEADLINE,
    DEPTH,
    GENERATION_PARAMETER,
    LEASE_PARAMETER,
    MIN_RATE,
    PACKETS,
    RATE,
    READERS_GENERATION_PARAMETER,
    READERS_LEASE_PARAMETER,
    WEIGHT,
    WIRE_BYTES,
    parameter_name,
    reader_parameter_name,
)

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from arpd.model.plan import ReaderPlan, TopicPlan, Transition

log = logging.getLogger(__name__)

_TIMEOUT_S = 2.0
_FIRST_BACKOFF_S = 1.5  # longer than one announcement takes
_MAX_BACKOFF_S = 12.0
_MOST_NODES = 500  # clients kept; the one used longest ago goes
_MOST_REASON = 300  # characters of a node's answer
_ACCEPTED_S = 6.0  # an accepted call leads to a swap of three to four seconds, and then an announcement


@dataclass(slots=True)
class _Node:
    client: Any
    generation: int = -1
    future: Any = None
    sent_at_s: float = 0.0
    next_at_s: float = 0.0
    backoff_s: float = _FIRST_BACKOFF_S
    sent: dict[str, TopicPlan | ReaderPlan] = field(default_factory=dict)  # by topic, under this generation


class ParameterApplier:
    """Sends transitions and remembers the calls under way, per node.

    The caller repeats a transition at every tick until the node announces its settings; this class decides when to send
    it again. A new row is sent at once, an unconfirmed one after a growing back-off. A node's publishers and readers
    have separate calls, so a refusal of one kind does not hold the other.

    Parameters
    ----------
    node : rclpy node of the clients; its executor runs the callbacks of the answers
    """

    def __init__(self, node: Any) -> None:
        self._ros = node
        self._nodes: dict[tuple[str, bool], _Node] = {}  # by name, and whether it is about readers
        self._results: Counter[str] = Counter()

    @property
    def results(self) -> Mapping[str, int]:
        """Calls so far, by result: ``ok``, ``refused``, ``timeout``, ``unreachable``, ``failed``."""
        return dict(self._results)

    def apply(self, transitions: Iterable[Transition], *, now_s: float) -> None:
        """Send what is new or due again; returns at once."""
        for transition in transitions:
            key = transition.node, bool(transition.readers)
            node = self._nodes.pop(key, None) or self._new(transition.node)
            self._nodes[key] = node  # the one used last at the end
            rows: dict[str, TopicPlan | ReaderPlan] = {**transition.topics, **transition.readers}
            is_newer = transition.generation > node.generation
            if is_newer or any(node.sent.get(topic) != row for topic, row in rows.items()):
                # The newest plan goes out now, and the answer of an older call does not matter.
                self._forget(node)
                node.generation = transition.generation
                node.next_at_s, node.backoff_s = now_s, _FIRST_BACKOFF_S
                node.sent = rows if is_newer else {**node.sent, **rows}
            self._expire(transition.node, node, now_s)
            if node.future is None and now_s >= node.next_at_s:
                node.sent_at_s, node.next_at_s = now_s, now_s + node.backoff_s
                node.backoff_s = min(2 * node.backoff_s, _MAX_BACKOFF_S)
                self._send(transition, node)

    def _new(self, name: str) -> _Node:
        while len(self._nodes) >= _MOST_NODES:
            forgotten = self._nodes.pop(next(iter(self._nodes)))
            self._forget(forgotten)
            self._ros.destroy_client(forgotten.client)
        return _Node(client=self._ros.create_client(SetParametersAtomically, f"{name}/set_parameters_atomically"))

    def _send(self, transition: Transition, node: _Node) -> None:
        if not node.client.service_is_ready():
            self._results["unreachable"] += 1
            log.info("%s does not offer its parameter service yet", transition.node)
            return
        request = SetParametersAtomically.Request(parameters=[p.to_parameter_msg() for p in _parameters(transition)])
        node.future = node.client.call_async(request)
        node.future.add_done_callback(lambda future: self._on_answer(transition, node, future))

    def _on_answer(self, transition: Transition, node: _Node, future: Any) -> None:
        if node.future is future:
            node.future = None
        if future.cancelled():
            return
        if future.exception() is not None:
            self._results["failed"] += 1
            log.warning("%s: parameter call failed: %s", transition.node, future.exception())
            return
        result = future.result().result
        self._results["ok" if result.successful else "refused"] += 1
        if result.successful and node.generation == transition.generation:
            node.next_at_s = max(node.next_at_s, node.sent_at_s + _ACCEPTED_S)
        if not result.successful:
            reason = result.reason[:_MOST_REASON]
            log.warning("%s refused plan %d: %r", transition.node, transition.generation, reason)

    @staticmethod
    def _forget(node: _Node) -> None:
        if node.future is not None:
            node.client.remove_pending_request(node.future)
            node.future.cancel()
            node.future = None

    def _expire(self, name: str, node: _Node, now_s: float) -> None:
        if node.future is not None and now_s - node.sent_at_s > _TIMEOUT_S:
            self._results["timeout"] += 1
            log.warning("%s did not answer a parameter call within %.0f s", name, _TIMEOUT_S)
            self._forget(node)


def _parameters(transition: Transition) -> list[Any]:
    if transition.readers:
        generation, lease = READERS_GENERATION_PARAMETER, READERS_LEASE_PARAMETER
    else:
        generation, lease = GENERATION_PARAMETER, LEASE_PARAMETER
    return [
        *(parameter for topic, row in transition.topics.items() for parameter in _of_publisher(topic, row)),
        *(parameter for topic, row in transition.readers.items() for parameter in _of_reader(topic, row)),
        Parameter(generation, value=transition.generation),
        Parameter(lease, value=float(transition.lease_s)),
    ]


def _of_reader(topic: str, row: ReaderPlan) -> list[Any]:
    values = {DEPTH: row.depth, DEADLINE: row.deadline_ns}
    return [Parameter(reader_parameter_name(topic, setting), value=value) for setting, value in values.items()]


def _of_publisher(topic: str, row: TopicPlan) -> list[Any]:
    values: dict[str, int | float] = {
        DEPTH: row.depth,
        DEADLINE: row.deadline_ns,
        RATE: float(row.rate_hz),
        MIN_RATE: float(row.min_rate_hz),
        WEIGHT: float(row.weight),
        WIRE_BYTES: float(row.wire_bytes),
        PACKETS: row.packets,
    }
    return [Parameter(parameter_name(topic, setting), value=value) for setting, value in values.items()]
