"""`arpd peer`: answers probes on the CEDDP, and reports what arrives there."""

from __future__ import annotations

import logging
import math
import platform
import threading
import time
from typing import TYPE_CHECKING, Any

from arpd.adapters.config.domain import local_domain
from arpd.adapters.config.load import load_settings
from arpd.adapters.host.addresses import Addresses
from arpd.adapters.host.interface import InterfaceReader, hardware_address
from arpd.adapters.ros.names import PROBE_TOPIC, REPORT_TOPIC
from arpd.adapters.ros.runtime import best_executor, control_node, serve_until, stop_on_signals
from arpd.adapters.systemd.journal import configure_logging
from arpd.adapters.systemd.notify import Notifier, Watchdog
from arpd.model.probing import PeerReport
from arpd.observe.receiver import BUSY_S, Receiver, ReportSchedule

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from arpd.model.interface import LinkCounters

log = logging.getLogger(__name__)

_LONGEST_S = 59.0  # covered by one report
_MOST_PROBES_HZ = 1000.0  # packets; a daemon sends ten pings and at most a dozen trains of 24 a second
_QUIET_S = 5.0  # a daemon sends several probes in this time, in an outage too


class Peer:
    """Receives probes, and sends reports.

    While the interface is gone a report has no byte counts; delays and trains that arrived another way are reported.

    Parameters
    ----------
    node : rclpy node; a single thread spins it
    reader : reads the link interface of this host
    name : name of the peer in its reports
    clock : monotonic clock (s)
    """

    def __init__(
        self, node: Any, *, reader: InterfaceReader, name: str, clock: Callable[[], float] = time.monotonic
    ) -> None:
        from rclpy.clock import Clock  # noqa: PLC0415 - ROS is checked in control_node
        from rclpy.clock_type import ClockType  # noqa: PLC0415
        from rclpy.qos import QoSProfile, QoSReliabilityPolicy  # noqa: PLC0415
        from std_msgs.msg import UInt8MultiArray  # noqa: PLC0415

        from arpd.adapters.ros import events, probe_messages, raw_subscription  # noqa: PLC0415

        self._octets = raw_subscription.octets
        self._messages = probe_messages
        self._reader = reader
        self._name = name
        self._clock = clock
        self._receiver = Receiver()
        self._schedule = ReportSchedule(clock())
        self._counters = reader.read()
        best_effort = QoSProfile(depth=100, reliability=QoSReliabilityPolicy.BEST_EFFORT)
        self._reports = node.create_publisher(
            UInt8MultiArray, REPORT_TOPIC, best_effort, event_callbacks=events.no_publisher_events()
        )
        self._subscription = raw_subscription.RawSubscription(
            node,
            UInt8MultiArray,
            PROBE_TOPIC,
            best_effort,
            most_bytes=probe_messages.MOST_PROBE_BYTES,
            take=self._on_probe,
            refuse=lambda: log.debug("ignored a message that is longer than any probe"),
            calm_hz=_MOST_PROBES_HZ,
            clock=clock,
        )
        # Steady time, so that reports continue when this host's clock is set back.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._timer = node.create_timer(BUSY_S, self._look, clock=steady)
        self._armed_s = math.inf
        self.probed_s = -math.inf  # when the last probe arrived
        self._arm(self._schedule.look_s)

    def _on_probe(self, data: bytes, info: Any) -> None:
        try:
            packet = self._octets(data)
            header = self._messages.decode_probe(packet)
        except ValueError as fault:
            log.debug("ignored a probe: %s", fault)
            return
        self.probed_s = self._clock()
        self._receiver.on_probe(
            train=header.train,
            index=header.index,
            packets=header.packets,
            payload_bytes=len(packet),
            sent_ns=info["source_timestamp"],
            received_ns=info["received_timestamp"],
        )
        self._schedule.note_probe(packets=header.packets, quiet_s=header.quiet_s)
        if self._schedule.due_s < self._armed_s:
            self._arm(self._schedule.due_s)

    def _arm(self, when_s: float) -> None:
        """Call `_look` at that time, or now if it has passed."""
        self._armed_s = when_s
        if (wait_s := when_s - self._clock()) <= 0:
            self._look()
            return
        self._timer.timer_period_ns = max(1, round(wait_s * 1e9))
        self._timer.reset()

    def _look(self) -> None:
        """Send a report if one is due, and arm the next call."""
        schedule, before = self._schedule, self._counters
        after = self._reader.read() or before
        grown = after.rx_bytes - before.rx_bytes if after and before else 0
        schedule.note_traffic(grown)
        if self._clock() < schedule.due_s:
            self._arm(schedule.due_s)
            return
        self._send(before, after)
        self._arm(schedule.look_s)

    def _send(self, before: LinkCounters | None, after: LinkCounters | None) -> None:
        now_s = self._clock()
        interval_s = now_s - self._schedule.sent_at_s
        self._counters = after
        delays_s, trains = self._receiver.take()
        if interval_s > 0:
            self._reports.publish(
                self._messages.encode_report(
                    PeerReport(
                        peer=self._name,
                        received_at_s=now_s,
                        interval_s=min(interval_s, _LONGEST_S),
                        rx_bytes=after.rx_bytes - before.rx_bytes if after and before else 0,
                        rx_packets=after.rx_packets - before.rx_packets if after and before else 0,
                        delays_s=delays_s,
                        trains=trains,
                        last_probe=self._receiver.last_probe,
                        probe_packets=self._receiver.packets_before,
                    )
                )
            )
        self._schedule.note_sent(now_s)


class ProbeStatus:
    """Status line of a peer for `systemctl status`: whether a daemon's probes arrive, and since when.

    Parameters
    ----------
    task : task of the peer, in words
    tell : called with the line at the start and whenever it changes
    wall_clock : returns the time of day, in words
    """

    def __init__(
        self,
        task: str,
        *,
        tell: Callable[[str], None],
        wall_clock: Callable[[], str] = lambda: time.strftime("%Y-%m-%d %H:%M:%S"),
    ) -> None:
        self._task = task
        self._tell = tell
        self._wall_clock = wall_clock
        self._has_probes = False
        tell(f"{task}; no probes yet: arpd on the robot is not running, not reachable, or in another ROS_DOMAIN_ID")

    def update(self, *, probed_s: float, now_s: float) -> None:
        """Update the line from the time of the last probe (s)."""
        if (has_probes := now_s - probed_s < _QUIET_S) == self._has_probes:
            return
        self._has_probes = has_probes
        self._tell(f"{self._task}; {'probes arrive' if has_probes else 'no probes'} since {self._wall_clock()}")


def default_name(interface: str) -> str:
    """Return a name that no other peer has: the host name, and the end of the interface's Ethernet address.

    Cloned computers have the same host name and machine id, but different addresses. The name is the same after a
    restart of the peer, so the daemon recognises it.
    """
    return "-".join(part for part in (platform.node(), hardware_address(interface)[-4:]) if part) or "peer"


def run_peer(*, interface: str, name: str | None, config_path: Path | None, log_level: str) -> int:
    """Run the peer until SIGINT or SIGTERM.

    Parameters
    ----------
    interface : link interface on this host, or ``auto``
    name : name of the peer in its reports; `default_name` when None
    config_path : YAML configuration, for the link domain of a relay with two ends; None = there is none

    Raises
    ------
    ConfigError
        If the configuration has faults.
    LinkError
        If only a new process can use the link's address.
    """
    configure_logging(log_level, name="arpd-peer")
    link = None
    if config_path is not None:
        link = load_settings(config_path, interfaces=None, local_domain=local_domain()).relay.link(is_far=True)
    stopping = threading.Event()
    stop_on_signals(stopping)
    notifier = Notifier()
    reader = InterfaceReader(interface)
    reader.read()  # finds the interface for ``auto``
    name = name or default_name(reader.name)
    addresses = Addresses(lambda: reader.name)
    with control_node("arpd_peer", link) as node:
        executor = best_executor(node.context, hears_itself=link is None)
        executor.add_node(node)
        peer = Peer(node, reader=reader, name=name)
        log.info("reporting what arrives on %s as %s", reader.name, name)
        notifier.ready()
        status = ProbeStatus(f"reporting what arrives on {reader.name} as {name}", tell=notifier.status)
        serve_until(
            executor,
            stopping,
            heartbeat=Watchdog(notifier),
            addresses=addresses,
            on_turn=lambda: status.update(probed_s=peer.probed_s, now_s=time.monotonic()),
        )
        notifier.stopping()
    return 0
