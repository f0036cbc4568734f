"""What a daemon sends to all nodes: the price of the link, and the plan."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from rclpy.qos import QoSDurabilityPolicy, QoSProfile, QoSReliabilityPolicy
from rclpy.serialization import deserialize_message
from std_msgs.msg import Float64MultiArray, UInt8MultiArray

from arpd.ros.names import PLAN_TOPIC, PRICE_TOPIC
from arpd.ros.plan_message import decode_plan
from arpd.ros.price_message import decode_price
from arpd.ros.raw_reader import RawReader, ReadingThread, octets

if TYPE_CHECKING:
    from collections.abc import Callable

    from rclpy.node import Node

    from arpd.model.price import Price
    from arpd.ros.plan_message import PlanMessage
    from arpd.ros.raw_reader import Sample

_NEWEST = QoSProfile(depth=1, reliability=QoSReliabilityPolicy.BEST_EFFORT)


class Taker(Protocol):
    """The publishers of a node."""

    def take_price(self, price: Price) -> None:
        """Take the price of the link."""

    def take_plan(self, plan: PlanMessage) -> None:
        """Take the rows that concern it, or none of them; its snapshot has the answer."""


def plan_qos() -> QoSProfile:
    """Return the QoS of plans: the last one is kept for nodes that start later."""
    return QoSProfile(
        depth=1, reliability=QoSReliabilityPolicy.RELIABLE, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL
    )


class DaemonMessages:
    """Reads price and plan for a node, in a thread of arpd's own: no callback of the application delays them.

    Parameters
    ----------
    node : node of the application
    taker : takes them, in that thread
    warn : says what is wrong with one
    """

    def __init__(self, node: Node, taker: Taker, *, warn: Callable[[str], None]) -> None:
        self._taker, self._warn = taker, warn
        thread = ReadingThread.of(node.context)
        self._readers = (
            RawReader(node, Float64MultiArray, PRICE_TOPIC, _NEWEST, deliver=self._on_price, thread=thread),
            RawReader(node, UInt8MultiArray, PLAN_TOPIC, plan_qos(), deliver=self._on_plan, thread=thread),
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
        try:
            plan = decode_plan(octets(sample.data))
        except ValueError as fault:
            self._warn(f"a plan is ignored: {fault}")
            return
        self._taker.take_plan(plan)
