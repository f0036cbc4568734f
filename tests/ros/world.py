"""What tests with real rclpy share: their domain and nodes, and what stands for the daemon."""

import math
import threading
import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile, QoSReliabilityPolicy
from std_msgs.msg import UInt8MultiArray

from arpd.endpoint.node_publishers import NodePublishers
from arpd.model.price import Price
from arpd.ros.cdr import wrap
from arpd.ros.documents import pack, unpack
from arpd.ros.names import PLAN_TOPIC, PUBLISHERS_TOPIC
from arpd.ros.nodes import Nodes
from arpd.ros.plan_message import PLAN_QOS, encode_plan
from arpd.ros.rcl import attached
from arpd.ros.snapshot_decoder import decode_snapshot
from scripts.bench.child import spinning

DOMAIN = 1  # `tests.network` sees to it that no other process is in it
REPO = Path(__file__).resolve().parents[2]
FREE = Price(share_per_weight=math.inf, capacity_bytes_per_second=1e6)
TERMS = {"weight": 1.0, "wire_bytes": 1000.0, "packets": 1}


class Ros:
    """Nodes of one test in one participant, each with its own executor."""

    def __init__(self, stack, domain=DOMAIN):
        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=domain)
        stack.callback(rclpy.try_shutdown, context=self.context)
        self._stack = stack

    def idle_node(self, name, **options):
        """Return a node that nobody spins."""
        node = rclpy.create_node(name, context=self.context, **options)
        self._stack.callback(node.destroy_node)
        return node

    def node(self, name, executor=None, **options):
        node = self.idle_node(name, **options)
        executor = executor or SingleThreadedExecutor(context=self.context)
        executor.add_node(node)
        self._stack.enter_context(spinning(executor))
        return node

    def elsewhere(self, domain=DOMAIN):
        """Return a maker of nodes in a participant of its own, as another process has."""
        return Ros(self._stack, domain)


class SkippingClock:
    """The time of this computer, and what was skipped, so that what takes seconds need not be waited for."""

    def __init__(self):
        self._skipped_s = 0.0

    def __call__(self):
        return time.monotonic() + self._skipped_s

    def skip(self, seconds):
        self._skipped_s += seconds

    def rule(self, node):
        """Let what arpd makes for the publishers of a new node use this clock."""
        attached(node, NodePublishers, lambda: NodePublishers(node, clock=self))
        return node


# -- what stands for the daemon


def costing(rate_hz):
    """Return the price at which a publisher of these terms may publish at this rate."""
    return Price(share_per_weight=rate_hz * 1e-3, capacity_bytes_per_second=1e6)


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
        self._publisher.publish(wrap(data))


def retune(publisher, **changes):
    """Change some settings of one publisher, as a plan does."""
    publisher._shared._retune(publisher, replace(publisher.plan, **changes))


# A graph that shows whatever nodes tell.
EVERYBODY = SimpleNamespace(shows_writer=lambda _node, _topic: True, fields_of=lambda _topic: {})


class Announced:
    """Hears the snapshots of all nodes, and puts them together as the daemon does; the node's owner spins it."""

    def __init__(self, node):
        self.link_bytes = []  # as a relay has told them
        self._nodes = Nodes()
        self._lock = threading.Lock()
        qos = QoSProfile(depth=100, reliability=QoSReliabilityPolicy.BEST_EFFORT)
        node.create_subscription(UInt8MultiArray, PUBLISHERS_TOPIC, self._on_snapshot, qos)

    @property
    def states(self):
        """All live publishers."""
        with self._lock:
            return self._nodes.live(time.monotonic())

    @property
    def snapshots(self):
        """The last one of each node."""
        with self._lock:
            return [node.snapshot for node in self._nodes._nodes.values()]

    @property
    def answers(self):
        """Answers to plans, by node."""
        with self._lock:
            return self._nodes.answers

    def _on_snapshot(self, message):
        snapshot = decode_snapshot(bytes(message.data))
        if snapshot.relay:
            self.link_bytes.append(snapshot.relay.link_bytes)
        with self._lock:
            self._nodes.note(snapshot.node.encode(), snapshot, time.monotonic())
            self._nodes.see(EVERYBODY)
