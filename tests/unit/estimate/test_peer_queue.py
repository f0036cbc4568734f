"""Queue and capacity as the reports of one peer show them; tests/sim has the rest, over whole links."""

import pytest

from arpd.estimate.peer_queue import QueueGauge, SentPing
from arpd.estimate.receiver import PROMPT_S
from arpd.model.probing import PeerReport


class Peer:
    """A peer, and the gauge of the queue before it."""

    def __init__(self):
        self.gauge, self.sent, self.handed_bytes = QueueGauge(), 0, 0.0

    def ping(self, sent_s):
        self.sent += 1
        self.gauge.note_sent(SentPing(number=self.sent, sent_s=sent_s, handed_bytes=self.handed_bytes))

    def report(self, at_s, *delays_s, rx_bytes=0):
        report = PeerReport(
            peer="p",
            received_at_s=at_s,
            interval_s=0.1,
            rx_bytes=rx_bytes,
            rx_packets=0,
            delays_s=delays_s,
            last_probe=self.sent if delays_s else 0,
        )
        self.gauge.digest(report, handed_bytes=self.handed_bytes)


def test_an_overdue_ping_waits_behind_a_queue_of_that_length():
    """A ping on its way for longer than the least round trip and the wait of a report shows the excess at once."""
    peer, ways_s = Peer(), (0.10, 0.02, 0.05)
    for at_s, way_s in enumerate(ways_s):
        peer.ping(at_s)
        peer.report(at_s + way_s, way_s)
    peer.ping(10.0)
    usual_s = 10.0 + min(ways_s) + PROMPT_S
    queues_s = [peer.gauge.queue_s(usual_s + late_s, handed_bytes=0.0, capacity=1e6) for late_s in (0.02, 0.1, 3.0)]
    assert queues_s == pytest.approx([0.02, 0.1, 3.0])


def test_bytes_that_waited_and_did_not_all_arrive_show_the_capacity():
    """The link was never idle between two reports, unless a ping left and arrived between them."""
    peer = Peer()
    peer.ping(1.0)
    peer.report(1.01, 0.005)
    peer.handed_bytes, rates = 200_000.0, []
    for tick in range(1, 4):
        peer.report(1.0 + 0.1 * tick, rx_bytes=50_000)
        rates.append(peer.gauge.backlog.busy_rate)
    assert rates == [None, pytest.approx(500_000), pytest.approx(500_000)]
    peer.handed_bytes += 200_000.0
    peer.report(1.4, rx_bytes=50_000)
    peer.ping(1.41)
    peer.report(1.5, 0.005, rx_bytes=50_000)
    assert peer.gauge.backlog.busy_rate is None
