"""`arpd peer`: the receiver on the CEDDP, reporting what reached it ten times a second."""

from __future__ import annotations

import logging
import platform
import threading
import time
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from arpd.host.counters import choose_interface, read_counters
from arpd.logs import configure_logging
from arpd.probing import PeerReport, Train
from arpd.ros.names import PROBE_TOPIC, REPORT_TOPIC
from arpd.ros.runtime import ros_node, spin_until, stop_on_signals
from arpd.systemd import Notifier
from arpd.wire import probe_wire_bytes

if TYPE_CHECKING:
    from arpd.interface import LinkCounters

log = logging.getLogger(__name__)

REPORT_S = 0.1
_PROMPT_S = 0.05  # least time between reports that a ping provokes
_TRAIN_TIMEOUT_S = 1.0


@dataclass(slots=True)
class _OpenTrain:
    packets: int
    first_ns: int
    last_ns: int
    arrived: int = 1
    payload_bytes: int = 0


@dataclass(slots=True)
class Receiver:
    """Collects probe arrivals between two reports; pure bookkeeping, so that a test can drive it.

    A train counts when its first and last packet arrived and at most a tenth of it was lost: the dispersion of what
    came between them then still is the link's.
    """

    delays_s: list[float] = field(default_factory=list)
    trains: list[Train] = field(default_factory=list)
    last_probe: int = 0
    _open: dict[int, _OpenTrain] = field(default_factory=dict)

    def on_probe(
        self, *, train: int, index: int, packets: int, payload_bytes: int, sent_ns: int, received_ns: int
    ) -> None:
        """Note one probe packet with the timestamps of its MessageInfo (ns, two different clocks)."""
        if index == 0:
            self.delays_s.append((received_ns - sent_ns) / 1e9)
            self.last_probe = train
            if packets > 1:
                self._open = {
                    number: waiting
                    for number, waiting in self._open.items()
                    if received_ns - waiting.first_ns < _TRAIN_TIMEOUT_S * 1e9
                }
                self._open[train] = _OpenTrain(packets=packets, first_ns=received_ns, last_ns=received_ns)
            return
        current = self._open.get(train)
        if current is None:
            return
        current.arrived += 1
        current.last_ns = received_ns
        current.payload_bytes += probe_wire_bytes(payload_bytes)
        if index == packets - 1:
            del self._open[train]
            if current.arrived >= 0.9 * packets and current.last_ns > current.first_ns:
                self.trains.append(
                    Train(
                        payload_bytes=current.payload_bytes,
                        duration_s=(current.last_ns - current.first_ns) / 1e9,
                        packets=current.arrived,
                    )
                )

    def take(self) -> tuple[tuple[float, ...], tuple[Train, ...]]:
        """Return what came since the last call."""
        delays, trains = tuple(self.delays_s), tuple(self.trains)
        self.delays_s, self.trains = [], []
        return delays, trains


class Peer:
    """The peer's node: probes in, reports out."""

    def __init__(self, node: Any, *, interface: str, name: str) -> None:
        from rclpy.qos import QoSProfile, QoSReliabilityPolicy  # noqa: PLC0415 - ROS is checked in ros_node
        from std_msgs.msg import UInt8MultiArray  # noqa: PLC0415

        from arpd.ros import report  # noqa: PLC0415

        self._report = report
        self._interface = interface
        self._name = name
        self._receiver = Receiver()
        self._last: tuple[float, LinkCounters] | None = None
        best_effort = QoSProfile(depth=100, reliability=QoSReliabilityPolicy.BEST_EFFORT)
        self._reports = node.create_publisher(UInt8MultiArray, REPORT_TOPIC, best_effort)
        node.create_subscription(UInt8MultiArray, PROBE_TOPIC, self._on_probe, best_effort)
        self._timer = node.create_timer(1.2 * REPORT_S, self._send)

    def _on_probe(self, message: Any, info: Any) -> None:
        try:
            header = self._report.decode_probe(message)
        except ValueError as fault:
            log.debug("ignored a probe: %s", fault)
            return
        self._receiver.on_probe(
            train=header.train,
            index=header.index,
            packets=header.packets,
            payload_bytes=len(message.data),
            sent_ns=info["source_timestamp"],
            received_ns=info["received_timestamp"],
        )
        # A ping's delay is the first sign of a queue: report it now, not at the next period.
        if header.packets == 1 and self._last is not None and time.monotonic() - self._last[0] >= _PROMPT_S:
            self._timer.reset()
            self._send()

    def _send(self) -> None:
        now_s = time.monotonic()
        counters = read_counters(self._interface)
        if counters is None:
            self._last = None  # the interface is gone; the first reading after it returns starts anew
            return
        if self._last is not None and now_s > self._last[0]:
            since_s, before = self._last
            delays_s, trains = self._receiver.take()
            self._reports.publish(
                self._report.encode_report(
                    PeerReport(
                        peer=self._name,
                        received_at_s=now_s,
                        interval_s=min(now_s - since_s, 59.0),
                        rx_bytes=max(0, counters.rx_bytes - before.rx_bytes),
                        rx_packets=max(0, counters.rx_packets - before.rx_packets),
                        delays_s=delays_s,
                        trains=trains,
                        last_probe=self._receiver.last_probe,
                    )
                )
            )
        self._last = (now_s, counters)


def run_peer(*, interface: str, name: str | None, log_level: str) -> int:
    """Run the peer until SIGINT or SIGTERM.

    Parameters
    ----------
    interface : link interface on this host, or ``auto``
    name : what the peer calls itself in reports; the host name by default
    """
    configure_logging(log_level)
    chosen = choose_interface(interface)
    stopping = threading.Event()
    stop_on_signals(stopping)
    notifier = Notifier()
    with ros_node("arpd_peer") as node:
        # MessageInfo callbacks raise SystemError on EventsExecutor in rclpy 7.1.6; this traffic is small.
        from rclpy.executors import SingleThreadedExecutor  # noqa: PLC0415

        executor = SingleThreadedExecutor()
        executor.add_node(node)
        Peer(node, interface=chosen, name=name or platform.node())
        log.info("reporting what arrives on %s", chosen)
        notifier.ready()
        notifier.status(f"reporting what arrives on {chosen}")
        spin_until(executor, stopping)
        notifier.stopping()
    return 0
