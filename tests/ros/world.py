"""What tests with real rclpy share: their domain and nodes, arpd's processes, and what stands for the daemon."""

import math
import os
import subprocess
import sys
import threading
import time
from array import array
from dataclasses import replace
from pathlib import Path

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile, QoSReliabilityPolicy
from std_msgs.msg import Float64MultiArray, UInt8MultiArray

from arpd.endpoint.node_publishers import NodePublishers
from arpd.model.price import Price
from arpd.ros.attached import attached
from arpd.ros.documents import pack, unpack
from arpd.ros.names import PLAN_TOPIC, PRICE_TOPIC, PUBLISHERS_TOPIC
from arpd.ros.nodes import Nodes
from arpd.ros.plan_message import PLAN_QOS, encode_plan
from arpd.ros.price_message import encode_price
from arpd.ros.snapshot_decoder import decode_snapshot
from scripts.bench.child import spinning
from tests.waiting import eventually

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


def start_arpd(*arguments, log=None, **environment):
    """Start a command of arpd in the tests' domain."""
    return subprocess.Popen(
        [sys.executable, "-u", "-m", "arpd.cli", *map(str, arguments)],
        env={**os.environ, "ROS_DOMAIN_ID": str(DOMAIN), **environment},
        stdout=subprocess.PIPE,
        stderr=log.open("w") if log else None,
        text=True,
        cwd=REPO,
    )


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


class Everybody:
    """A graph that shows whatever nodes tell."""

    def shows_writer(self, _node, _topic):
        return True

    def fields_of(self, _topic):
        return {}


class Announced:
    """Hears the snapshots of all nodes, and puts them together as the daemon does.

    Parameters
    ----------
    node : rclpy node; its owner spins it
    on_news : called with the states of one node when it has told something
    """

    def __init__(self, node, on_news=lambda _states: None):
        self._nodes = Nodes()
        self._lock = threading.Lock()
        self._on_news = on_news
        qos = QoSProfile(depth=100, reliability=QoSReliabilityPolicy.BEST_EFFORT)
        node.create_subscription(UInt8MultiArray, PUBLISHERS_TOPIC, self._on_snapshot, qos)

    @property
    def states(self):
        """All live publishers."""
        with self._lock:
            return self._nodes.live(time.monotonic())

    @property
    def answers(self):
        """Answers to plans, by node."""
        with self._lock:
            return self._nodes.answers

    @property
    def last(self):
        """The only publisher there is, None before it is heard."""
        return next(iter(self.states), None)

    def shows(self, **values):
        state = self.last
        return state is not None and all(getattr(state, key) == value for key, value in values.items())

    def _on_snapshot(self, message):
        snapshot = decode_snapshot(bytes(message.data))
        with self._lock:
            self._nodes.note(snapshot.node.encode(), snapshot, time.monotonic())
            self._nodes.see(Everybody())
        self._on_news([state for state in self.states if state.node == snapshot.node])
