"""The plan for all nodes, as `arpd run` sends it."""

from array import array
from dataclasses import replace

from std_msgs.msg import UInt8MultiArray

from arpd.ros.documents import pack, unpack
from arpd.ros.names import PLAN_TOPIC
from arpd.ros.plan_message import PLAN_QOS, encode_plan


class Plans:
    """Sends plans on the topic, and keeps the last one for who starts later."""

    def __init__(self, node):
        self._publisher = node.create_publisher(UInt8MultiArray, PLAN_TOPIC, PLAN_QOS)

    def __call__(self, generation, topics, *, lease_s=0.0, spoilt=None):
        """Send a plan.

        Parameters
        ----------
        spoilt : topic → what stands for its row instead
        """
        data = encode_plan(generation=generation, lease_s=lease_s, topics=topics)
        if spoilt:
            plan = unpack(data, most_bytes=2**20)
            data = pack({**plan, "rows": {**plan["rows"], **spoilt}})
        self._publisher.publish(UInt8MultiArray(data=array("B", data)))


def retune(publisher, **changes):
    """Change some settings of one publisher, as a plan does."""
    publisher._shared._retune(publisher, replace(publisher.plan, **changes))
