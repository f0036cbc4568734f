"""The plans that arrive for one node."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rclpy.qos import QoSDurabilityPolicy, QoSProfile, QoSReliabilityPolicy
from std_msgs.msg import String

from arpd.adapters.ros.events import no_subscription_events
from arpd.adapters.ros.names import plan_topic
from arpd.adapters.ros.plan_message import crc_of, decode_plan

if TYPE_CHECKING:
    from typing import Protocol

    from rclpy.node import Node

    from arpd.adapters.ros.plan_message import NodePlan

    class PlanTaker(Protocol):
        """The publishers of a node."""

        def take_plan(self, plan: NodePlan, crc: int) -> None:
            """Take the rows that concern it, or none of them, and answer."""

        def refuse_plan(self, crc: int, words: str) -> None:
            """Answer that a message is no plan."""


def plan_qos() -> QoSProfile:
    """Return the QoS of plans: the last one of a node is kept for it."""
    return QoSProfile(
        depth=1, reliability=QoSReliabilityPolicy.RELIABLE, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL
    )


class PlanListener:
    """Receives the plans of a node, and gives each to its publishers, in the node's executor.

    The writer keeps the last plan, so a node that starts later than its daemon receives it too.

    Parameters
    ----------
    node : node of the application
    taker : takes the plans
    """

    def __init__(self, node: Node, taker: PlanTaker) -> None:
        self._taker = taker
        topic = plan_topic(node.get_fully_qualified_name())
        node.create_subscription(String, topic, self._on_plan, plan_qos(), event_callbacks=no_subscription_events())

    def _on_plan(self, message: Any) -> None:
        crc = crc_of(message.data)
        try:
            plan = decode_plan(message.data)
        except ValueError as fault:
            self._taker.refuse_plan(crc, str(fault))
            return
        self._taker.take_plan(plan, crc)
