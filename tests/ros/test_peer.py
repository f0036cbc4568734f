"""The peer with real rclpy: content and rate of its reports, also when the interface is gone."""

import os
import subprocess
import sys
import time
from itertools import count

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from arpd.adapters.ros.names import PROBE_TOPIC, REPORT_TOPIC
from arpd.adapters.ros.peer import Peer, default_name
from arpd.adapters.ros.probe_messages import ProbeHeader, decode_report, encode_probe
from arpd.adapters.ros.world import RosControl
from arpd.estimate.probes import ProbeLoss
from arpd.model.interface import InterfaceState, LinkCounters
from arpd.model.probing import ProbeRequest
from arpd.model.settings import GraphSettings
from arpd.model.wire import probe_wire_bytes
from arpd.observe.receiver import PROMPT_S, WORTH_BYTES
from tests.ros.domain import DOMAIN

SIZE = 1200


class Interface:
    """An interface that receives 1000 bytes between two readings, and may be gone."""

    def __init__(self):
        self.packets = 0
        self.flood = 0
        self.is_there = True

    def read(self):
        if not self.is_there:
            return None
        self.packets += 1
        return LinkCounters(
            interface="wlan0",
            rx_bytes=1000 * self.packets + self.flood,
            rx_packets=self.packets,
            tx_bytes=0,
            tx_packets=0,
            tx_dropped=0,
            state=InterfaceState.UP,
        )


class Daemon:
    """The other side: it sends probes and keeps reports."""

    def __init__(self, node):
        from rclpy.qos import QoSProfile, QoSReliabilityPolicy
        from std_msgs.msg import UInt8MultiArray

        qos = QoSProfile(depth=100, reliability=QoSReliabilityPolicy.BEST_EFFORT)
        self.reports = []
        self.sizes = []
        self._numbers = count(1)
        self._probes = node.create_publisher(UInt8MultiArray, PROBE_TOPIC, qos)
        node.create_subscription(UInt8MultiArray, REPORT_TOPIC, self._on_report, qos)

    @property
    def is_matched(self):
        return self._probes.get_subscription_count() > 0 and bool(self.reports)

    def probe(self, packets, *, every_s=0.0, quiet_s=0.0, lost=()):
        number = next(self._numbers)
        for index in sorted({*range(packets)} - {*lost}):
            header = ProbeHeader(train=number, index=index, packets=packets, quiet_s=quiet_s)
            self._probes.publish(encode_probe(header, payload_bytes=SIZE))
            time.sleep(every_s)
        return number

    def collect(self, duration_s, every_s=None, packets=1):
        """Return the reports of a duration, with a probe every ``every_s``."""
        self.reports.clear()
        self.sizes.clear()
        until_s = time.monotonic() + duration_s
        while time.monotonic() < until_s:
            if every_s:
                self.probe(packets)
            time.sleep(every_s or duration_s)
        return list(self.reports)

    def _on_report(self, message):
        self.sizes.append(len(message.data))
        self.reports.append(decode_report(bytes(message.data), received_at_s=time.monotonic()))


@pytest.fixture
def interface():
    return Interface()


@pytest.fixture
def daemon(ros, interface, eventually):
    daemon = Daemon(ros.node("daemon"))
    Peer(ros.node("peer"), reader=interface, name="ceddp-3f2a")
    eventually(lambda: daemon.is_matched)
    return daemon


def test_a_train_is_measured_and_a_ping_answered_at_once(daemon, eventually):
    """A train is reported as bytes, time and departures, and a ping within a tenth of a second."""
    daemon.reports.clear()
    daemon.probe(20, every_s=0.001)  # no link disperses these, and packets that arrive together are no train
    eventually(lambda: any(report.trains for report in daemon.reports))
    (train,) = next(report.trains for report in daemon.reports if report.trains)
    assert 1 <= train.packets <= 19
    assert train.payload_bytes == train.packets * probe_wire_bytes(SIZE)
    assert 0 < train.sent_s < 1.0
    waits = []
    for _ in range(10):
        time.sleep(0.06)
        sent_s, number = time.monotonic(), daemon.probe(1)
        eventually(lambda number=number: daemon.reports[-1].last_probe == number)
        waits.append(time.monotonic() - sent_s)
    print(f"ping to report (s): {sorted(waits)}")
    assert sorted(waits)[5] < 0.1  # 20 ms here, the step of `eventually`
    assert all(abs(delay) < 1.0 for report in daemon.reports for delay in report.delays_s)


def test_what_never_arrives_is_known_to_the_packet(daemon, eventually):
    """Twenty trains of four, of which ten lose a packet, make a loss of an eighth."""
    loss = ProbeLoss()

    def probe(packets, **lost):
        number = daemon.probe(packets, **lost)
        loss.note_sent(ProbeRequest(packets=packets, packet_bytes=SIZE, number=number))
        return number

    first = probe(1)
    eventually(lambda: daemon.reports[-1].last_probe == first)
    for turn in range(20):
        probe(4, lost=() if turn % 2 else (0,) if turn == 4 else (3,))
    last = probe(1)
    eventually(lambda: daemon.reports[-1].last_probe == last)
    for report in daemon.reports:
        loss.digest(report)
    assert loss.ratio(daemon.reports[-1].received_at_s) == pytest.approx(10 / 81)


def test_the_daemon_hears_what_was_lost_and_how_long_the_way_back_was(ros, interface, eventually):
    """A report has the packet count, and the daemon knows its delay by the two hosts' clocks."""
    from arpd.adapters.ros.world import RosControl
    from arpd.model.settings import GraphSettings

    Peer(ros.node("peer"), reader=interface, name="ceddp-3f2a")
    world = RosControl(ros.node("arpd"), interface="lo", graph=GraphSettings(), on_report=lambda: None)
    reports, numbers = [], count(1)

    def answered():
        world.probe(ProbeRequest(packets=3, packet_bytes=200, number=next(numbers)))
        reports.extend(world.observe(time.monotonic()).reports)
        return len(reports) > 5 and reports[-1].probe_packets > 6

    eventually(answered)
    assert all(0.0 <= report.return_delay_s < 5.0 for report in reports)  # both clocks are the same here
    counts = [report.probe_packets for report in reports]
    assert counts == sorted(counts)


def test_pings_set_the_pace_of_reports(daemon):
    """Without pings there are four reports a second, with more pings one for each, below 1 kB/s."""
    quiet = daemon.collect(2.0)
    assert 4 <= len(quiet) <= 9
    busy = daemon.collect(3.0, every_s=0.1)
    assert 12 <= len(busy) <= 34  # fewer where the machine is busy: pings then come late
    assert sum(daemon.sizes) / 3.0 < 1000
    assert 15 <= len(daemon.collect(2.0, every_s=PROMPT_S / 4)) <= 2.0 / PROMPT_S + 2


def test_a_ping_may_ask_for_fewer_reports(daemon):
    """Reports without a cause are as rare as the last ping allowed."""
    daemon.probe(1, quiet_s=1.0)
    time.sleep(0.3)
    assert 2 <= len(daemon.collect(3.0)) <= 4
    daemon.probe(1)
    time.sleep(0.3)
    assert len(daemon.collect(2.0)) >= 4


def test_traffic_without_pings_is_reported_twice_as_often(daemon, interface, background):
    """While much data arrives without a ping, reports come every 0.12 s."""

    def flood(stopping):
        while not stopping.wait(0.02):
            interface.flood += WORTH_BYTES

    background(flood)
    reports = daemon.collect(3.0)
    assert 16 <= len(reports) <= 26
    assert not any(report.delays_s for report in reports)


def test_every_byte_is_reported_once(daemon, interface):
    """Received bytes and time are split over the reports without gap or overlap."""
    started_s = time.monotonic()
    first = interface.packets
    reports = daemon.collect(2.0, every_s=0.1)
    elapsed_s = time.monotonic() - started_s
    assert abs(sum(report.rx_packets for report in reports) - (interface.packets - first)) <= 1
    assert all(report.rx_bytes == 1000 * report.rx_packets for report in reports)
    assert sum(report.interval_s for report in reports) == pytest.approx(elapsed_s, abs=0.3)
    assert {report.peer for report in reports} == {"ceddp-3f2a"}


def test_an_interface_that_is_gone_counts_nothing_and_the_reports_go_on(daemon, interface):
    """Without the interface, reports go on with delays and without bytes."""
    interface.is_there = False
    daemon.collect(0.3, every_s=0.1)
    reports = daemon.collect(1.0, every_s=0.1)
    assert len(reports) >= 5
    assert any(report.delays_s for report in reports)
    assert sum(report.rx_bytes for report in reports) == 0
    interface.is_there = True
    assert sum(report.rx_packets for report in daemon.collect(1.0, every_s=0.1)) <= 12


def test_two_peers_tell_themselves_apart(daemon, ros, eventually, monkeypatch):
    """Hosts with the same host name have different peer names by their interface's address."""
    addresses = {"wlan0": "b827eb123f2a", "wlan1": "b827eb99c001", "tun0": ""}
    monkeypatch.setattr("arpd.adapters.ros.peer.hardware_address", addresses.__getitem__)
    monkeypatch.setattr("arpd.adapters.ros.peer.platform.node", lambda: "ceddp")
    names = [default_name(interface) for interface in addresses]
    assert names == ["ceddp-3f2a", "ceddp-c001", "ceddp"]
    Peer(ros.node("peer"), reader=Interface(), name=names[1])
    daemon.reports.clear()
    eventually(lambda: {report.peer for report in daemon.reports} == {"ceddp-3f2a", "ceddp-c001"})


def test_probes_of_strangers_are_ignored(daemon, ros, eventually):
    """Messages that are no probes are ignored."""
    from std_msgs.msg import UInt8MultiArray

    stranger = ros.node("stranger").create_publisher(UInt8MultiArray, PROBE_TOPIC, 10)
    eventually(lambda: stranger.get_subscription_count() > 0)
    for data in ([], [9] * 20, [1] + [255] * 9):
        stranger.publish(UInt8MultiArray(data=data))
    reports = daemon.collect(0.6, every_s=0.1)
    assert reports[-1].last_probe > 0
    assert sum(len(report.delays_s) for report in reports) <= 8


def test_the_daemon_sees_interface_and_radio(ros, eventually, monkeypatch):
    """An observation has the interface's counters and state, and the last bit rate of its radio."""
    from arpd.adapters.host.interface import index_of
    from arpd.adapters.ros.world import RosControl
    from arpd.model.settings import GraphSettings

    asked = []

    class Radio:
        cell = "02:00:00:00:00:01"

        def read(self, interface, index):
            asked.append((interface, index))
            return 8_125_000.0

    monkeypatch.setattr("arpd.adapters.ros.world.Radio", Radio)
    world = RosControl(ros.node("arpd"), interface="lo", graph=GraphSettings(), on_report=lambda: None)
    first = world.observe(time.monotonic())
    assert (first.counters.interface, first.counters.state) == ("lo", InterfaceState.UP)
    eventually(lambda: world.observe(time.monotonic()).radio_bytes_per_second == 8_125_000.0)
    eventually(lambda: asked[-1] == ("lo", index_of("lo")))
    assert world.observe(time.monotonic()).cell == Radio.cell


def test_a_peer_of_a_relay_with_two_ends_lives_in_the_link_domain(ros, eventually, tmp_path):
    """The peer joins `relay.link_domain`, and not the domain of its environment."""
    config = tmp_path / "arpd.yaml"
    config.write_text(f"relay: {{link_domain: {DOMAIN}, robot: 127.0.0.1}}")
    node = ros.node("daemon")
    command = [sys.executable, "-m", "arpd.cli", "peer", "--interface", "lo", "--config", str(config)]
    with subprocess.Popen(command, env={**os.environ, "ROS_DOMAIN_ID": str(DOMAIN + 1)}) as peer:
        try:
            eventually(lambda: "arpd_peer" in node.get_node_names())
        finally:
            peer.terminate()
        assert peer.wait(timeout=15.0) == 0


def test_the_daemon_knows_the_peers_clock(ros, interface, eventually):
    """On one host both clocks are the same: the daemon finds that, within half a round trip."""
    Peer(ros.node("peer"), reader=interface, name="ceddp-3f2a")
    control = RosControl(ros.node("daemon"), interface="lo", graph=GraphSettings(), on_report=lambda: None)
    numbers = count(1)

    def clock():
        control.probe(ProbeRequest(packets=1, packet_bytes=100, number=next(numbers), quiet_s=0.25))
        time.sleep(0.1)
        return control.observe(time.monotonic()).peer_clocks.get("ceddp-3f2a")

    eventually(lambda: clock() is not None)
    found = [each for each in (clock() for _ in range(20)) if each][-1]
    assert 0 < found.uncertainty_s < 0.2
    assert abs(found.offset_s) <= found.uncertainty_s
