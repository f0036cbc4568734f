"""`arpd peer`: answers probes on the base computer, and reports what arrives there."""

from __future__ import annotations

import logging
import math
import platform
import time
from contextlib import contextmanager
from functools import partial
from typing import TYPE_CHECKING, Any

from rclpy.qos import QoSProfile, QoSReliabilityPolicy
from std_msgs.msg import UInt8MultiArray

from arpd.estimate.receiver import Receiver
from arpd.host.addresses import Addresses, own_address
from arpd.host.config.load import load_settings, local_domain
from arpd.host.interface import InterfaceReader, hardware_address
from arpd.host.journal import configure_logging
from arpd.host.kernel import interface_of_link, link_interface
from arpd.host.notify import Notifier
from arpd.model.settings import AUTO, RelaySettings
from arpd.ros.cdr import octets, wrap
from arpd.ros.names import PROBE_TOPIC, REPORT_TOPIC
from arpd.ros.probe_messages import decode_probe, encode_report
from arpd.ros.raw_reader import REST_S, RawReader, ReadingThread, Sample
from arpd.ros.runtime import ros_node, send_without_waiting, serve_until, stop_on_signals

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

log = logging.getLogger(__name__)

_QUIET_S = 5.0  # a daemon sends several probes in this time, in an outage too


class Peer:
    """Takes probes, and sends reports; `serving` reads for it.

    While the interface is gone a report has no byte counts; delays and trains that arrived another way are reported.
    """

    def __init__(
        self,
        publish: Callable[[bytes], None],
        *,
        reader: InterfaceReader,
        name: str,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._publish, self._reader, self._clock = publish, reader, clock
        self._receiver = Receiver(name, clock(), self._counted())
        self.probed_s = -math.inf  # when the last probe arrived

    def hear(self, sample: Sample) -> None:
        """Take a probe."""
        try:
            packet = octets(sample.data)
            header = decode_probe(packet)
        except ValueError as fault:
            log.debug("ignored a probe: %s", fault)
            return
        self.probed_s = self._clock()
        self._receiver.on_probe(header, len(packet), sent_ns=sample.sent_ns, received_ns=sample.received_ns)

    def step(self) -> float:
        """Send a report if one is due; return when to call again at the latest (s)."""
        now_s = self._clock()
        if now_s >= self._receiver.due_s and (report := self._receiver.look(now_s, self._counted())):
            self._publish(wrap(encode_report(report)))
        return self._receiver.due_s

    def _counted(self) -> tuple[int, int] | None:
        counters = self._reader.read()
        return (counters.rx_bytes, counters.rx_packets) if counters else None


@contextmanager
def serving(node: Any, *, reader: InterfaceReader, name: str) -> Iterator[tuple[Peer, ReadingThread]]:
    """Run a peer in a node, in a thread of its own; nobody needs to spin the node."""
    best_effort = QoSProfile(depth=100, reliability=QoSReliabilityPolicy.BEST_EFFORT)
    reports = node.create_publisher(UInt8MultiArray, REPORT_TOPIC, best_effort)
    peer = Peer(reports.publish, reader=reader, name=name)
    thread = ReadingThread(step=peer.step, rest_s=REST_S)
    probes = RawReader(node, UInt8MultiArray, PROBE_TOPIC, best_effort, deliver=peer.hear, thread=thread)
    try:
        yield peer, thread
    finally:
        probes.destroy()
        thread.stop()


class ProbeStatus:
    """Status line of a peer for `systemctl status`: whether a daemon's probes arrive, and since when."""

    def __init__(self, task: Callable[[], str], *, tell: Callable[[str], None]) -> None:
        self._task, self._tell = task, tell
        self._seen = "no probes yet: arpd on the robot is not running, not reachable, or in another ROS domain"
        self._has_probes = False
        self.update(-math.inf)

    def update(self, probed_s: float) -> None:
        """Tell the line, by the time of the last probe (monotonic clock, s)."""
        if (has_probes := time.monotonic() - probed_s < _QUIET_S) != self._has_probes:
            self._has_probes = has_probes
            self._seen = f"{'probes arrive' if has_probes else 'no probes'} since {time.strftime('%Y-%m-%d %H:%M:%S')}"
        self._tell(f"{self._task()}; {self._seen}")


def default_name(interface: str) -> str:
    """Return a name that no other peer has: the host name, and the end of the interface's Ethernet address.

    Cloned computers have the same host name and machine id, but different addresses. The name is the same after a
    restart of the peer, so the daemon recognises it.
    """
    return "-".join(part for part in (platform.node(), hardware_address(interface)[-4:]) if part) or "peer"


def run_peer(*, interface: str, name: str | None, config_path: Path | None, log_level: str) -> int:
    """Run the peer until SIGINT or SIGTERM; raises ConfigError, and LinkError if only a new process can use the link.

    Parameters
    ----------
    interface : link interface on this host, or ``auto``
    name : name of the peer in its reports; `default_name` when None
    config_path : YAML configuration, for the link domain of a relay with two ends; None = there is none
    """
    configure_logging(log_level, name="arpd-peer")
    relay = RelaySettings()
    if config_path is not None:
        relay = load_settings(config_path, interfaces=None, local_domain=local_domain()).relay
    link = relay.link(is_far=True)
    stopping = stop_on_signals()
    notifier = Notifier()
    reader = InterfaceReader(interface, route=partial(interface_of_link, relay.robot, relay.base))
    reader.read()  # finds the interface for ``auto``
    name = name or default_name(reader.name)
    own = own_address(config_path, link, is_far=True)
    addresses = Addresses(partial(link_interface, interface, relay.robot, relay.base), own=own)
    send_without_waiting()

    def task() -> str:
        why = "no interface looks like the link yet" if reader.name == AUTO else f"which {reader.state.fault}"
        return f"reporting what arrives on {reader.name}{f' ({why})' if reader.state.fault else ''} as {name}"

    with ros_node("arpd_peer", link, address=own()) as node, serving(node, reader=reader, name=name) as (peer, thread):
        log.info("%s", task())
        status = ProbeStatus(task, tell=notifier.status)
        serve_until(
            stopping,
            notifier=notifier,
            parts=[lambda: thread.finished_s],
            addresses=addresses,
            step=lambda: status.update(peer.probed_s),
        )
    return 0
