"""Loss of probe packets: exact, with packets on their way and with lost reports."""

from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from arpd.estimate.probes import ProbeLoss
from arpd.model.probing import PeerReport, ProbeRequest
from arpd.observe.receiver import Receiver


class Peer:
    """A receiver behind a link that loses packets; it has counted packets of earlier daemons."""

    def __init__(self, name="ceddp", *, counted=0):
        self.name = name
        self.receiver = Receiver()
        self.receiver._received = counted  # from earlier daemons

    def hear(self, request, arriving):
        for index in arriving:
            self.receiver.on_probe(
                train=request.number, index=index, packets=request.packets, payload_bytes=16, sent_ns=0, received_ns=0
            )

    def report(self, now_s):
        return PeerReport(
            peer=self.name,
            received_at_s=now_s,
            interval_s=0.1,
            rx_bytes=0,
            rx_packets=0,
            last_probe=self.receiver.last_probe,
            probe_packets=self.receiver.packets_before % 2**32,
        )


def request(number, packets=1):
    return ProbeRequest(packets=packets, packet_bytes=16, number=number)


def play(probes, *, counted=0, peers=1):
    """Send probes given by their packets and losses; return the loss after the last report."""
    loss, everybody = ProbeLoss(), [Peer(f"peer {i}", counted=counted) for i in range(peers)]
    for number, (packets, lost) in enumerate(probes, 1):
        loss.note_sent(request(number, packets))
        for peer in everybody:
            peer.hear(request(number, packets), range(packets - lost))
            loss.digest(peer.report(number * 0.1))
    return loss


@given(
    probes=st.lists(st.integers(1, 24).flatmap(lambda p: st.tuples(st.just(p), st.integers(0, p))), max_size=100),
    counted=st.sampled_from([0, 17, 2**32 - 30]),
    peers=st.integers(1, 3),
)
def test_what_is_lost_is_counted_to_the_packet(probes, counted, peers):
    """The ratio is exact over the probes between the first and the last that arrived; counts may wrap."""
    probes = [(1, 0), *probes, (1, 0)]  # a ping before and after: the second settles everything
    ratio = play(probes, counted=counted, peers=peers).ratio(len(probes) * 0.1)
    sent, lost = (sum(column) for column in zip(*probes[:-1], strict=True))
    if sent * peers < 20:
        assert ratio is None
    else:
        assert ratio == pytest.approx(lost / sent)


def test_what_is_under_way_is_not_lost():
    """Probes that wait in a queue count only when a later one has arrived."""
    loss, peer = ProbeLoss(), Peer()
    for number in range(1, 101):
        loss.note_sent(request(number, 4))
        if number <= 50:
            peer.hear(request(number, 4), range(4))
        loss.digest(peer.report(number * 0.1))
    assert loss.ratio(10.0) == 0.0
    peer.hear(request(100, 4), range(1))  # the others never came
    loss.digest(peer.report(10.1))
    assert loss.ratio(10.1) == pytest.approx(49 / 99)


def test_a_train_whose_packets_arrive_now_is_not_lost():
    """A report in the middle of a train does not count the rest of it as lost."""
    loss, peer = ProbeLoss(), Peer()
    for number in range(1, 30):
        loss.note_sent(request(number, 24))
        peer.hear(request(number, 24), range(12))
        loss.digest(peer.report(number * 0.1))
        assert loss.ratio(number * 0.1) in (None, 0.0)
        peer.hear(request(number, 24), range(12, 24))


def test_a_report_that_is_lost_takes_nothing_with_it():
    """Counts are cumulative, so the next report includes the lost ones."""
    loss, peer, random = ProbeLoss(), Peer(), Random(1)
    for number in range(1, 101):
        loss.note_sent(request(number))
        peer.hear(request(number), range(0 if number % 4 == 0 else 1))
        if random.random() < 0.3 or number in (1, 99):
            loss.digest(peer.report(number * 0.1))
    assert loss.ratio(10.0) == pytest.approx(24 / 98)


def test_a_peer_that_restarts_does_not_look_like_loss():
    """After a restart of the peer the earlier counts are forgotten, and loss is measured again."""
    loss, peer = play([(1, 0)] * 60), Peer("peer 0")
    assert loss.ratio(6.0) == 0.0
    for number in range(61, 101):
        loss.note_sent(request(number))
        peer.hear(request(number), range(number % 2))
        loss.digest(peer.report(number * 0.1))
        assert loss.ratio(number * 0.1) in (None, pytest.approx(0.5, abs=0.03))
    assert loss.ratio(10.0) is not None


def test_an_older_peer_says_nothing():
    """A report without a count leaves the loss unknown, and does not disturb other peers."""
    loss = play([(1, 0)] * 40)
    old = PeerReport(peer="old", received_at_s=4.0, interval_s=0.1, rx_bytes=0, rx_packets=0, last_probe=40)
    loss.digest(old)
    assert loss.ratio(4.0) == 0.0
    only = ProbeLoss()
    for number in range(1, 60):
        only.note_sent(request(number))
        only.digest(old)
    assert only.ratio(6.0) is None


def test_loss_that_is_over_is_forgotten_within_the_window():
    """Losses older than 20 s do not count."""
    probes = [(4, 2)] * 100 + [(4, 0)] * 150
    assert play(probes).ratio(25.0) == pytest.approx(0.13, abs=0.03)
    assert play([*probes, *[(4, 0)] * 60]).ratio(31.0) == 0.0
    assert play(probes).ratio(50.0) is None  # no report within the window


def test_what_is_remembered_is_bounded():
    """Unanswered probes take bounded memory."""
    loss = ProbeLoss()
    for number in range(1, 20_000):
        loss.note_sent(request(number))
    assert len(loss._sent_before) <= 1000
