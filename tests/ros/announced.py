"""What publishers announce, as the daemon puts it together from statuses and numbers, for tests without a daemon."""

import threading
import time

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.qos import QoSProfile
from std_msgs.msg import UInt8MultiArray

from arpd.adapters.ros.announcement import from_status, tag_of
from arpd.adapters.ros.counters import decode_counters
from arpd.adapters.ros.names import COUNTERS_TOPIC, PUBLISHERS_TOPIC
from arpd.observe.registry import Endpoints


class Announced:
    """Hears all announcements of publishers.

    Parameters
    ----------
    node : rclpy node; its owner spins it
    on_news : called with the states of one node when it has told something
    """

    def __init__(self, node, on_news=lambda _states: None):
        self._endpoints = Endpoints(3.5)
        self._endpoints.see(lambda _node, _topic: True, 0.0)
        self._lock = threading.Lock()
        self._on_news = on_news
        self.answers = {}
        self.bytes = self.statuses = 0
        node.create_subscription(DiagnosticArray, PUBLISHERS_TOPIC, self._on_statuses, QoSProfile(depth=100))
        node.create_subscription(UInt8MultiArray, COUNTERS_TOPIC, self._on_counters, QoSProfile(depth=100))

    @property
    def states(self):
        """All live publishers."""
        with self._lock:
            return self._endpoints.live(time.monotonic())

    @property
    def last(self):
        """The only publisher there is, None before it is heard."""
        return next(iter(self.states), None)

    def shows(self, **values):
        state = self.last
        return state is not None and all(getattr(state, key) == value for key, value in values.items())

    def _on_statuses(self, message):
        with self._lock:
            for status in message.status:
                state = from_status(status)
                self._endpoints.note(state, time.monotonic(), tag_of(status))
                self.statuses += 1
        self._tell(state.node)

    def _on_counters(self, message):
        counters = decode_counters(bytes(message.data))
        self.answers[counters.node] = counters.answer
        common = {"generation": counters.answer.generation, "lease_s": counters.lease_s}
        with self._lock:
            self._endpoints.note_rows(
                counters.node, counters.incarnation, counters.rows, common=common, now_s=time.monotonic()
            )
        self._tell(counters.node)

    def _tell(self, node):
        self._on_news([state for state in self.states if state.node == node])
