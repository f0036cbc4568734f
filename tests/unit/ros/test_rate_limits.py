"""Admission of messages from the network: rates, and reports of peers."""

from dataclasses import replace

import pytest

from arpd.model.observation import MessageRefusal
from arpd.model.probing import PeerReport
from arpd.ros.peer_reports import PeerReports
from arpd.ros.rate_limits import RateLimit

REPORT = PeerReport(peer="base", received_at_s=0.0, interval_s=0.1, rx_bytes=1000, rx_packets=2, last_probe=0)


# -- rates


def test_a_flood_takes_nothing_from_the_others():
    """Each source has its own rate, and those beyond the bound share one."""
    limit = RateLimit(2, period_s=1.0)
    passed = 0
    for tick in range(100):
        now_s = tick / 10
        if tick % 10 == 0:
            assert limit.take("honest", now_s)
        passed += sum(limit.take("flood", now_s) for _ in range(100))
    assert passed == 2 * 10
    assert limit.take("honest", 10.0)
    assert sum(limit.take(f"invented{k}", 10.0) for k in range(5000)) < 1010
    assert limit.take("honest", 10.0)


# -- reports


class Daemon(PeerReports):
    """Sends probes, and hears reports that answer one of them."""

    def answer(self, probe=1, now_s=0.0, **fields):
        """Let a peer answer a probe of this number; return why it is refused, or what is believed."""
        return self.hear(now_s, last_probe=self.number(probe, now_s), **fields)

    def hear(self, now_s=0.0, *, must_answer=True, **fields):
        refusal = self.note(replace(REPORT, received_at_s=now_s, **fields), must_answer=must_answer)
        return refusal or self.take(now_s)[0][0]


@pytest.mark.parametrize("base", [0, 1, 2**31, 2**32 - 1])
def test_a_report_must_answer_a_probe_that_was_sent(base):
    """Only the number of a recent probe is an answer; it comes back as our own number."""
    daemon = Daemon(base)
    wires = [daemon.number(probe, 0.0) for probe in range(1, 4)]
    assert daemon.answer(3).last_probe == 3
    for guess in {0, (base + 4) % 2**32, base, (base - 5) % 2**32, 4711} - {wire for wire in wires if wire}:
        assert daemon.hear(last_probe=guess) is MessageRefusal.UNANSWERED
    daemon.number(5000, 0.0)
    assert daemon.hear(last_probe=wires[-1]) is MessageRefusal.UNANSWERED  # too old


def test_who_stands_by_takes_reports_that_answer_another_daemon():
    """They are neither refused nor answers to its own last probe."""
    daemon = Daemon(9)
    daemon.number(7, 0.0)
    assert daemon.hear(last_probe=4711) is MessageRefusal.UNANSWERED
    assert daemon.hear(last_probe=4711, must_answer=False).last_probe == 0


def test_no_more_peers_are_believed_than_there_are():
    """Invented peers get at most as many entries as the graph shows, and never that of a known peer."""
    daemon = Daemon(9)
    daemon.see(2)
    for tick in range(200):
        now_s = tick / 10
        assert daemon.answer(now_s=now_s) is not MessageRefusal.QUOTA
        results = [daemon.answer(now_s=now_s, peer=f"liar-{tick}-{k}") for k in range(5)]
        assert results.count(MessageRefusal.QUOTA) >= 4
    pinned = PeerReports(9)  # a daemon whose capacity is known asks nobody
    pinned.see(1)
    assert [pinned.note(replace(REPORT, peer=peer)) for peer in ("base", "liar")] == [None, MessageRefusal.QUOTA]
