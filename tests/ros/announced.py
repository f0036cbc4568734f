"""What nodes tell of their publishers, as the daemon puts it together, for tests without a daemon."""

import threading
import time

from rclpy.qos import QoSProfile, QoSReliabilityPolicy
from std_msgs.msg import UInt8MultiArray

from arpd.ros.names import PUBLISHERS_TOPIC
from arpd.ros.nodes import Nodes
from arpd.ros.snapshot_decoder import decode_snapshot


class Everybody:
    """A graph that shows whatever nodes tell."""

    def shows_writer(self, _node, _topic):
        return True

    def fields_of(self, _topic):
        return {}


class Announced:
    """Hears the snapshots of all nodes.

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
