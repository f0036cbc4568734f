"""An interface and its queue, from answers as the kernel encodes them."""

import socket
import struct
from pathlib import Path
from unittest.mock import MagicMock

import pytest

from arpd.adapters.host.netlink import Backlog, NetDevice, find_device, find_root, read_backlog, read_device

# linux/rtnetlink.h, linux/if_link.h, linux/pkt_sched.h, linux/gen_stats.h
NEWLINK, NEWQDISC, DONE, ERROR = 16, 36, 3, 2
NAME, STATS64, QUEUE_LENGTH = 3, 23, 13
UP, RUNNING = 0x1, 0x40
KIND, STATS2, STATS_BASIC, STATS_QUEUE = 1, 7, 1, 3
ROOT, NESTED = 0xFFFFFFFF, 0x8000


def attribute(kind, value):
    return struct.pack("=HH", 4 + len(value), kind) + value + bytes(-len(value) % 4)


def message(kind, body):
    return struct.pack("=IHHII", 16 + len(body), kind, 2, 1, 0) + body


def device(index, *, name=b"wlan0\0", flags=UP | RUNNING, counters=(1, 2, 300, 400, 5, 6, 7, 8)):
    """Return a message about one interface, with more counters than arpd reads."""
    body = struct.pack("=BxHiII", 0, 1, index, flags, 0) + attribute(NAME, name)
    body += attribute(QUEUE_LENGTH, struct.pack("=I", 1000))
    return message(NEWLINK, body + attribute(STATS64, struct.pack("=8Q", *counters) + bytes(128)))


def test_name_flags_and_counters_are_read():
    """The kernel's counters begin with packets received, packets sent, bytes received and bytes sent."""
    counters = {"rx_packets": 1, "tx_packets": 2, "rx_bytes": 300, "tx_bytes": 400, "tx_dropped": 8}
    expected = NetDevice(name="wlan0", is_up=True, is_running=True, **counters)
    assert find_device(device(2, counters=(9,) * 8) + device(3), 3) == (expected, True)


@pytest.mark.parametrize("flags", [0, UP, UP | RUNNING, UP | RUNNING | 0x1002])
def test_flags_are_told_apart(flags):
    """Only the flags for up and running matter."""
    found, _ = find_device(device(3, flags=flags), 3)
    assert found is not None
    assert (found.is_up, found.is_running) == (bool(flags & UP), bool(flags & RUNNING))


def test_an_answer_without_the_interface_ends_or_goes_on():
    """An error or the end ends an answer; a part with other interfaces does not."""
    assert find_device(message(ERROR, struct.pack("=i", -19)), 3) == (None, True)
    assert find_device(device(4), 3) == (None, False)
    assert find_device(device(4) + message(DONE, bytes(4)), 3) == (None, True)


def test_the_kernel_answers_about_loopback():
    """The counters of loopback are those of /proc/net/dev, and a missing interface gives None."""
    index = socket.if_nametoindex("lo")

    def told():
        (line,) = (one for one in Path("/proc/net/dev").read_text().splitlines() if one.strip().startswith("lo:"))
        fields = [int(field) for field in line.partition(":")[2].split()]
        return fields[0], fields[1], fields[8], fields[9]

    before = told()
    found = read_device(index)
    after = told()
    assert found is not None
    assert (found.name, found.is_up, found.is_running) == ("lo", True, True)
    seen = (found.rx_bytes, found.rx_packets, found.tx_bytes, found.tx_packets)
    assert all(low <= value <= high for low, value, high in zip(before, seen, after, strict=True))
    assert read_device(999_999) is None


# -- its queue


def qdisc(index, *, parent=ROOT, name=b"fq_codel\0", packets=3, waiting=4242, dropped=17, stats=True):
    """Return a message about one queue."""
    body = struct.pack("=BxxxiIII", 0, index, 0x80010000, parent, 2) + attribute(KIND, name)
    if stats:
        queue = attribute(STATS_QUEUE, struct.pack("=IIIII", packets, waiting, dropped, 0, 0))
        body += attribute(STATS2 | NESTED, attribute(STATS_BASIC, bytes(16)) + queue)
    return message(NEWQDISC, body)


END = message(DONE, bytes(4))


def test_the_root_queue_of_the_interface_is_found_among_others():
    """Queues of other interfaces and leaves below the root are not the root queue."""
    answer = qdisc(2, waiting=1) + qdisc(3, parent=0x80010001, waiting=2) + qdisc(3) + qdisc(4, waiting=5) + END
    assert find_root(answer, 3) == (Backlog(waiting_bytes=4242, dropped_packets=17), True)


@pytest.mark.parametrize("answer", [END, message(ERROR, bytes(20)), qdisc(2) + END, b"", qdisc(3, stats=False) + END])
def test_without_a_root_queue_there_is_no_backlog(answer):
    """No answer, an error, another interface or a queue without counters gives no backlog."""
    assert find_root(answer, 3)[0] is None


def test_an_interface_without_a_queue_has_no_backlog():
    """A queue inside mac80211 is unknown, not empty."""
    assert find_root(qdisc(3, name=b"noqueue\0", waiting=0), 3) == (None, True)


def test_an_answer_goes_on_until_its_end():
    """A part without the queue and without an end asks for the next part."""
    assert find_root(qdisc(2) + qdisc(4), 3) == (None, False)


def test_a_cut_answer_is_none(monkeypatch):
    """An answer that is cut off gives None and raises nothing."""
    kernel = MagicMock()
    kernel.__enter__.return_value.recv.return_value = qdisc(3)[:30]
    monkeypatch.setattr(socket, "socket", lambda *_: kernel)
    assert read_backlog(3) is None
    kernel.__enter__.return_value.recv.assert_called_once()


def test_the_kernel_answers_about_queues():
    """Loopback and a missing interface have no queue on a real host."""
    assert read_backlog(socket.if_nametoindex("lo")) is None
    assert read_backlog(999_999) is None
