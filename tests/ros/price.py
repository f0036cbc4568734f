"""The price of the link, as `arpd run` sends it."""

import math

from std_msgs.msg import Float64MultiArray

from arpd.model.price import Price
from arpd.ros.names import PRICE_TOPIC
from arpd.ros.price_message import encode_price
from tests.waiting import eventually

FREE = Price(share_per_weight=math.inf, capacity_bytes_per_second=1e6)
TERMS = {"weight": 1.0, "wire_bytes": 1000.0, "packets": 1}


def costing(rate_hz, **fields):
    """Return the price at which a publisher of these terms may publish at this rate."""
    return Price(share_per_weight=rate_hz * 1e-3, capacity_bytes_per_second=1e6, **fields)


class PriceSender:
    """Sends prices on the topic."""

    def __init__(self, node):
        self._publisher = node.create_publisher(Float64MultiArray, PRICE_TOPIC, 1)

    def __call__(self, price=FREE):
        self._publisher.publish(Float64MultiArray(data=encode_price(price)))

    def until(self, price, what, condition):
        """Send a price again and again, because its topic is best effort, until a condition holds."""
        eventually("somebody listens to the price", self._publisher.get_subscription_count)
        eventually(what, lambda: self(price) or condition())
