"""The peer with real rclpy: what a daemon on the other side hears from it."""

import time
from dataclasses import replace
from itertools import count

import pytest
from std_msgs.msg import UInt8MultiArray

from arpd.estimate.receiver import Receiver
from arpd.host.interface import InterfaceReader
from arpd.model.observation import MessageKind, MessageRefusal
from arpd.model.probing import ProbeHeader, ProbeRequest
from arpd.model.wire import probe_wire_bytes
from arpd.ros import peer_reports
from arpd.ros.cdr import wrap
from arpd.ros.names import PROBE_TOPIC, REPORT_TOPIC
from arpd.ros.peer import serving
from arpd.ros.probe_messages import decode_report, encode_probe, encode_report
from arpd.ros.world import RosControl
from tests.ros.ends_world import BEST_EFFORT
from tests.ros.world import DOMAIN, FREE

SIZE = 1200


class Daemon:
    """The other side: it sends probes, and keeps the reports."""

    def __init__(self, node):
        self.control = RosControl(node, interface="lo", on_report=lambda: None)
        self._numbers = count(1)

    def probe(self):
        request = ProbeRequest(packets=1, packet_bytes=SIZE, number=next(self._numbers), quiet_s=0.25)
        self.control.probe(request)

    def observe(self):
        return self.control.observe(time.monotonic())

    def is_answered(self):
        """Send a probe; return whether the peer has answered one."""
        self.probe()
        return any(report.last_probe for report in self.observe().reports)


@pytest.fixture
def daemon(ros, eventually):
    daemon = Daemon(ros.node("daemon"))
    with serving(ros.node("peer"), reader=InterfaceReader("lo"), name="base-3f2a"):
        eventually("the peer answers the daemon's probes", daemon.is_answered)
        yield daemon


def test_a_train_is_measured_and_a_ping_answered_at_once(daemon, ros, eventually):
    """A train is reported as bytes and packets, and the next report answers a ping; what was lost shows in a count."""
    node, reports = ros.node("prober"), []
    probes, numbers = node.create_publisher(UInt8MultiArray, PROBE_TOPIC, BEST_EFFORT), count(1000)

    def hear(message):
        reports.append(decode_report(bytes(message.data)))

    node.create_subscription(UInt8MultiArray, REPORT_TOPIC, hear, BEST_EFFORT)

    def probe(packets):
        number = next(numbers)
        for index in range(packets):
            header = ProbeHeader(train=number, index=index, packets=packets, quiet_s=0.25)
            probes.publish(wrap(encode_probe(header, payload_bytes=SIZE)))
            time.sleep(0.001)  # no link disperses these, and packets that arrive together are no train
        return number

    def trains():
        probe(20)
        return [train for report in reports for train in report.trains]

    for train in eventually("a train is reported", trains):
        assert 1 <= train.packets <= 19
        assert train.payload_bytes == train.packets * probe_wire_bytes(SIZE)
    number = probe(1)
    eventually("the ping is answered", lambda: reports[-1].last_probe == number)
    assert {report.peer for report in reports} == {"base-3f2a"}
    counts = [report.probe_packets for report in reports]
    assert counts == sorted(counts)


def test_of_two_daemons_one_drives_and_neither_refuses_what_answers_the_other(daemon, ros, eventually):
    """The one with the lower GUID drives until it is silent; what answers its probes is nothing to complain of."""
    both = daemon, Daemon(ros.node("other"))

    def know_each_other():
        for each in both:
            each.control.set_price(FREE)
        return all(each.control._daemons.are_heard for each in both)

    eventually("they know each other", know_each_other)
    driving, standing = sorted(both, key=lambda each: each.observe().active_daemon)
    standing.probe()
    eventually(
        "the one that stands by hears a report",
        lambda: (know_each_other() and driving.probe()) or standing.observe().reports,
    )
    assert not any(each.observe().refused for each in both)
    eventually("both are in the graph", lambda: all(each.observe().other_daemons == ("this host",) for each in both))
    eventually("the one that is silent is succeeded", lambda: not standing.observe().active_daemon)


def test_a_peer_that_has_heard_no_probe_yet_is_nothing_to_complain_of(ros, eventually):
    """Reports of a peer that starts answer no probe; only those that claim to are counted, and named in the log."""
    daemon, reports = Daemon(ros.node("daemon")), ros.node("peer").create_publisher(UInt8MultiArray, REPORT_TOPIC, 100)
    daemon.probe()
    report = Receiver("base", 0.0).look(1.0, None)
    eventually("the daemon hears reports", reports.get_subscription_count)
    for last_probe in (0, 0, 4711):
        reports.publish(wrap(encode_report(replace(report, last_probe=last_probe))))
    refused = eventually("one is refused", lambda: daemon.observe().refused)
    assert refused == {(MessageKind.REPORTS, MessageRefusal.UNANSWERED): 1}


def test_while_no_probe_leaves_a_peer_has_none_to_answer(ros, eventually, monkeypatch):
    """A peer may restart after a reload has pinned the capacity: its reports count, though it never hears a probe."""
    monkeypatch.setattr(peer_reports, "_ASKS_S", 0.0)
    daemon, reports = Daemon(ros.node("daemon")), ros.node("peer").create_publisher(UInt8MultiArray, REPORT_TOPIC, 100)
    daemon.probe()
    report = wrap(encode_report(Receiver("base", 0.0).look(1.0, None)))
    eventually("its reports count", lambda: reports.publish(report) or daemon.observe().peer_ages_s)
    assert not daemon.observe().refused


def test_the_daemon_knows_the_peers_clock(daemon, eventually):
    """On one host both clocks are the same: the daemon finds that, within half a round trip."""

    def clock():
        daemon.probe()
        return daemon.observe().peer_clocks.get("base-3f2a")

    found = eventually("the clocks are compared", clock)
    assert found.uncertainty_s > 0
    assert abs(found.offset_s) <= found.uncertainty_s


def test_a_peer_of_a_relay_with_two_ends_lives_in_the_link_domain(ros, arpd, eventually, tmp_path):
    """The peer joins `relay.link_domain`, and not the domain of its environment."""
    config, node = tmp_path / "arpd.yaml", ros.node("daemon")
    config.write_text(f"relay: {{link_domain: {DOMAIN}, robot: 127.0.0.1, base: 127.0.0.1}}")
    peer = arpd("peer", "--interface", "lo", "--config", config, ROS_DOMAIN_ID=str(DOMAIN + 1))
    eventually("the peer is in the link's domain", lambda: "arpd_peer" in node.get_node_names())
    peer.terminate()
    assert peer.wait(timeout=60.0) == 0
