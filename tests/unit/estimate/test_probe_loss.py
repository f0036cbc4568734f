"""Loss of probe packets: exact, with packets on their way and with lost reports."""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from arpd.estimate.probes import ProbeLoss
from arpd.estimate.receiver import Receiver
from arpd.model.probing import ProbeRequest


class Peer:
    """A receiver behind a link that loses packets; it has counted packets of earlier daemons."""

    def __init__(self, name="base", *, counted=0):
        self.receiver = Receiver(name, 0.0)
        self.receiver._received = counted  # from earlier daemons

    def hear(self, request, arriving):
        for index in arriving:
            self.receiver.on_probe(
                train=request.number, index=index, packets=request.packets, payload_bytes=16, sent_ns=0, received_ns=0
            )

    def report(self, now_s):
        report = self.receiver.report(now_s, rx_bytes=0, rx_packets=0)
        return replace(report, probe_packets=report.probe_packets % 2**32)


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
