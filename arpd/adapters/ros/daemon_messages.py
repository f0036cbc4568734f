"""What a daemon sends to the nodes: the price of the link for all, and a plan for each."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from rclpy.qos import QoSDurabilityPolicy, QoSProfile, QoSReliabilityPolicy
from rclpy.serialization import deserialize_message
from std_msgs.msg import Float64MultiArray, String

from arpd.adapters.ros.names import PRICE_TOPIC, plan_topic
from arpd.adapters.ros.plan_message import crc_of, decode_plan
from arpd.adapters.ros.price_message import decode_price
from arpd.adapters.ros.raw_reader import RawReader, ReadingThread

if TYPE_CHECKING:
    from collections.abc import Callable

    from rclpy.node import Node

    from arpd.adapters.ros.plan_message import NodePlan
    from arpd.adapters.ros.raw_reader import Sample
    from arpd.model.price import Price

_NEWEST = QoSProfile(depth=1, reliability=QoSReliabilityPolicy.BEST_EFFORT)


class Taker(Protocol):
    """The publishers of a node."""

    def take_price(self, price: Price) -> None:
        """Take the price of the link."""

    def take_plan(self, plan: NodePlan, crc: int) -> None:
        """Take the rows that concern it, or none of them, and answer."""

    def refuse_plan(self, crc: int, words: str) -> None:
        """Answer that a message is no plan."""


def plan_qos() -> QoSProfile:
    """Return the QoS of plans: the last one of a node is kept for it."""
    return QoSProfile(
        depth=1, reliability=QoSReliabilityPolicy.RELIABLE, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL
    )


class DaemonMessages:
    """Reads the price and the plans of a node, in a thread of arpd's own: no callback of the application delays them.

    The writer keeps the last plan, so a node that starts later than its daemon receives it too.

    Parameters
    ----------
    node : node of the application
    taker : takes them, in that thread
    warn : says what is wrong with a price
    """

    def __init__(self, node: Node, taker: Taker, *, warn: Callable[[str], None]) -> None:
        self._taker, self._warn = taker, warn
        thread = ReadingThread.of(node.context)
        plans = plan_topic(node.get_fully_qualified_name())
        self._readers = (
            RawReader(node, Float64MultiArray, PRICE_TOPIC, _NEWEST, deliver=self._on_price, thread=thread),
            RawReader(node, String, plans, plan_qos(), deliver=self._on_plan, thread=thread),
        )

    def destroy(self) -> None:
        """Read no more."""
        for reader in self._readers:
            reader.destroy()

    def _on_price(self, sample: Sample) -> None:
        try:
            price = decode_price(deserialize_message(sample.data, Float64MultiArray).data)
        except ValueError as fault:
            self._warn(f"a price is ignored: {fault}")
            return
        self._taker.take_price(price)

    def _on_plan(self, sample: Sample) -> None:
        text = deserialize_message(sample.data, String).data
        crc = crc_of(text)
        try:
            plan = decode_plan(text)
        except ValueError as fault:
            self._taker.refuse_plan(crc, str(fault))
            return
        self._taker.take_plan(plan, crc)
