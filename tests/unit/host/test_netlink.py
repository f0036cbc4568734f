"""The queue of an interface, from answers as the kernel encodes them."""

import socket
import struct

import pytest

from arpd.host.netlink import Backlog, find_root, read_backlog

# linux/rtnetlink.h, linux/pkt_sched.h, linux/gen_stats.h
NEWQDISC, DONE, ERROR = 36, 3, 2
KIND, STATS2, STATS_BASIC, STATS_QUEUE = 1, 7, 1, 3
ROOT, NESTED = 0xFFFFFFFF, 0x8000


def attribute(kind, value):
    return struct.pack("=HH", 4 + len(value), kind) + value + bytes(-len(value) % 4)


def message(kind, body):
    return struct.pack("=IHHII", 16 + len(body), kind, 2, 1, 0) + body


def qdisc(index, *, parent=ROOT, waiting=4242, stats=True):
    """Return a message about one queue."""
    body = struct.pack("=BxxxiIII", 0, index, 0x80010000, parent, 2) + attribute(KIND, b"fq_codel\0")
    if stats:
        queue = attribute(STATS_QUEUE, struct.pack("=IIIII", 3, waiting, 17, 0, 0))
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


def test_the_kernel_answers_about_queues():
    """Loopback and a missing interface have no queue on a real host."""
    assert read_backlog(socket.if_nametoindex("lo")) is None
    assert read_backlog(999_999) is None
