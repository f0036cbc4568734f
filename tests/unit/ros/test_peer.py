"""The peer in virtual time: when it reports, and what."""

from itertools import count

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from arpd.estimate.receiver import QUIET_S
from arpd.model.interface import InterfaceState, LinkCounters
from arpd.model.probing import ProbeHeader
from arpd.ros.cdr import octets, wrap
from arpd.ros.peer import Peer, default_name
from arpd.ros.probe_messages import decode_report, encode_probe
from arpd.ros.raw_reader import Sample


class World:
    """An interface that receives 100 packets of 10 bytes a second, and the daemon across the link."""

    def __init__(self):
        self.now_s, self.has_interface, self.reports = 100.0, True, []
        self._numbers = count(1)
        self._peer = Peer(self._publish, reader=self, name="base-3f2a", clock=lambda: self.now_s)

    def _publish(self, message):
        self.reports.append(decode_report(octets(message)))

    def read(self):
        packets, nothing = round((self.now_s - 100.0) * 100), dict.fromkeys(("tx_bytes", "tx_packets", "tx_dropped"), 0)
        counted = {"rx_bytes": 10 * packets, "rx_packets": packets, **nothing}
        return LinkCounters(interface="wlan0", state=InterfaceState.UP, **counted) if self.has_interface else None

    def collect(self, seconds):
        """Send a ping every 0.1 s for so long; return the reports."""
        self.reports.clear()
        for _ in range(round(seconds * 10)):
            header = ProbeHeader(train=next(self._numbers), index=0, packets=1)
            data, at_ns = wrap(encode_probe(header, payload_bytes=1200)), round(self.now_s * 1e9)
            self._peer.hear(Sample(data, b"writer", header.train, at_ns - 3_000_000, at_ns))
            until_s = self.now_s + 0.1
            while (due_s := self._peer.step()) <= until_s:
                self.now_s = max(self.now_s, due_s)
            self.now_s = until_s
        return [*self.reports]


def test_every_byte_and_every_moment_is_reported_once():
    """Received bytes and time are split over the reports without gap or overlap."""
    reports = World().collect(20.0)
    assert sum(report.rx_packets for report in reports) == pytest.approx(2000, abs=25)
    assert all(report.rx_bytes == 10 * report.rx_packets for report in reports)
    assert sum(report.interval_s for report in reports) == pytest.approx(20.0, abs=QUIET_S)
    assert {report.peer for report in reports} == {"base-3f2a"}


def test_an_interface_that_is_gone_counts_nothing_and_the_reports_go_on():
    """Without the interface, reports go on with delays and without bytes; what came meanwhile is no burst."""
    world = World()
    world.collect(1.0)
    world.has_interface = False
    reports = world.collect(1.0)
    assert len(reports) >= 9
    assert all(report.delays_s for report in reports)
    assert sum(report.rx_bytes for report in reports) == 0
    world.has_interface = True
    assert all(report.delays_s for report in world.collect(1.0))


def test_two_peers_tell_themselves_apart(monkeypatch):
    """Hosts with the same host name have different peer names by their interface's address."""
    addresses = {"wlan0": "b827eb123f2a", "wlan1": "b827eb99c001", "tun0": ""}
    monkeypatch.setattr("arpd.ros.peer.hardware_address", addresses.__getitem__)
    monkeypatch.setattr("arpd.ros.peer.platform.node", lambda: "base")
    assert [default_name(interface) for interface in addresses] == ["base-3f2a", "base-c001", "base"]
