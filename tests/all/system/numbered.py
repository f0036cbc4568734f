"""An application with numbered samples, which a source publishes on the robot and a sink counts on the base computer.

Usage: python -m numbered source|sink

The source publishes /numbered as a plain rclpy node, and /own with an AdaptivePublisher. The sink reads the relayed
/numbered and /own, and prints its counts as one JSON line several times a second.
"""

from __future__ import annotations

import json
import sys
from typing import Any

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from std_msgs.msg import String

from arpd import AdaptivePublisher

PLAIN, RELAYED, OWN = "/numbered", "/link/numbered", "/own"
RATE_HZ = 25.0
QOS = QoSProfile(depth=2000)  # RELIABLE, KEEP_LAST, 80 s
REPORT_S = 0.25


class Source(Node):
    """Publishes each topic from its first reader on."""

    def __init__(self) -> None:
        super().__init__("numbered_source")
        self._newest: dict[Any, int] = {
            self.create_publisher(String, PLAIN, QOS): 0,
            AdaptivePublisher(self, String, OWN, QOS, overflow="queue"): 0,
        }
        self.create_timer(1.0 / RATE_HZ, self._publish)

    def _publish(self) -> None:
        for publisher, number in self._newest.items():
            if number or publisher.get_subscription_count():
                publisher.publish(String(data=str(number)))
                self._newest[publisher] = number + 1


class Sink(Node):
    """Reads the relayed topic and the node's own."""

    def __init__(self) -> None:
        super().__init__("numbered_sink")
        self._seen = {topic: _Seen() for topic in (RELAYED, OWN)}
        for topic, seen in self._seen.items():
            self.create_subscription(String, topic, seen.on_sample, QOS)
        self.create_timer(REPORT_S, self._report)

    def _report(self) -> None:
        print(json.dumps({topic: seen.take() for topic, seen in self._seen.items()}), flush=True)


class _Seen:
    """Counts of one topic: skipped and repeated numbers."""

    def __init__(self) -> None:
        self._newest: int | None = None
        self._lost = 0
        self._doubled = 0

    def on_sample(self, message: String) -> None:
        number = int(message.data)
        if self._newest is not None:
            self._lost += max(0, number - self._newest - 1)
            self._doubled += number <= self._newest
        self._newest = number if self._newest is None else max(number, self._newest)

    def take(self) -> dict[str, Any]:
        return {"newest": self._newest, "lost": self._lost, "doubled": self._doubled}


def main() -> None:
    rclpy.init()
    executor = SingleThreadedExecutor()
    executor.add_node({"source": Source, "sink": Sink}[sys.argv[1]]())
    while True:
        executor.spin_once(timeout_sec=0.2)


if __name__ == "__main__":
    main()
