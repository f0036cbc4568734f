"""The plan on its way to the nodes: one message for all, sent again until their snapshots show it."""

from __future__ import annotations

import logging
import math
from collections import Counter
from typing import TYPE_CHECKING, Any

from std_msgs.msg import UInt8MultiArray

from arpd.model.plan import NO_PLAN, PlanAnswer, QosPlan, TopicPlan
from arpd.ros.cdr import wrap
from arpd.ros.names import PLAN_TOPIC
from arpd.ros.plan_message import PLAN_QOS, encode_plan
from arpd.ros.rcl import NO_EVENTS

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping

log = logging.getLogger(__name__)

# The middleware repeats what is lost, so a message is sent again mostly for a swap that failed: after the three to four
# seconds that a swap takes, and its snapshot.
_AGAIN_S, _MOST_AGAIN_S = 6.0, 12.0
_LEAST_S = 0.2  # between two messages


class PlanSender:
    """Sends the plan when it is new, and while nodes do not show it, after a growing time.

    A node that starts later finds the last plan, which the writer keeps.

    Attributes
    ----------
    results : answers of nodes so far, by result: ``ok``, ``refused``, ``timeout``
    """

    def __init__(self, node: Any) -> None:
        self._ros = node
        self._writer: Any = None
        self._sent: tuple[int, Mapping[str, TopicPlan], float] | None = None  # generation, rows and lease
        self._sent_s = -math.inf
        self._again_s = _AGAIN_S
        # Of the nodes that did not show it when it was sent: what their answers count as, empty while they owe one.
        self._answers: dict[str, str] = {}
        self.results: Counter[str] = Counter()

    def apply(
        self,
        plan: QosPlan,
        *,
        lease_s: float,
        missing: Collection[str],
        answers: Mapping[str, PlanAnswer],
        now_s: float,
    ) -> None:
        """Send the plan if it is new or due again, because nodes do not show it; returns at once."""
        self._read(answers)
        if not missing:
            return
        wanted = plan.generation, plan.topics, lease_s
        is_new = wanted != self._sent
        if now_s - self._sent_s < (_LEAST_S if is_new else self._again_s):
            return
        if not is_new and (silent := sorted(node for node, result in self._answers.items() if not result)):
            self.results["timeout"] += len(silent)
            log.warning("%s did not answer plan %d within %.0f s", ", ".join(silent), plan.generation, self._again_s)
        self._again_s = _AGAIN_S if is_new else min(2 * self._again_s, _MOST_AGAIN_S)
        self._sent, self._sent_s = wanted, now_s
        self._answers = {node: _result(plan.generation, answers.get(node, NO_PLAN)) for node in missing}
        if self._writer is None:
            self._writer = self._ros.create_publisher(UInt8MultiArray, PLAN_TOPIC, PLAN_QOS, event_callbacks=NO_EVENTS)
        self._writer.publish(wrap(encode_plan(generation=plan.generation, lease_s=lease_s, topics=plan.topics)))

    def forget(self) -> None:
        """Take the plan back: its writer goes, with what it kept for nodes that start later."""
        if self._writer is not None:
            self._ros.destroy_publisher(self._writer)
        self._writer = self._sent = None
        self._answers.clear()

    def _read(self, answers: Mapping[str, PlanAnswer]) -> None:
        if self._sent is None:
            return
        generation = self._sent[0]
        for node, before in self._answers.items():
            answer = answers.get(node, NO_PLAN)
            if (result := _result(generation, answer)) in {"", before}:
                continue
            self._answers[node] = result
            self.results[result] += 1
            if result == "refused":
                log.warning("%s refused plan %d: %r", node, generation, answer.refusal)


def _result(generation: int, answer: PlanAnswer) -> str:
    """Return what a node's answer to this plan counts as, empty if it has given none."""
    if answer.refusal and answer.refused == generation:
        return "refused"
    return "ok" if answer.generation == generation else ""
