"""The interface's own queue: what the kernel's answers say, as the kernel encodes them."""

import socket
import struct

import pytest

from arpd.adapters.host.netlink import Backlog, find_root, read_backlog

# linux/rtnetlink.h, linux/pkt_sched.h, linux/gen_stats.h
NEWQDISC, DONE, ERROR = 36, 3, 2
KIND, STATS2, STATS_BASIC, STATS_QUEUE = 1, 7, 1, 3
ROOT, NESTED = 0xFFFFFFFF, 0x8000


def attribute(kind, value):
    return struct.pack("=HH", 4 + len(value), kind) + value + bytes(-len(value) % 4)


def message(kind, body):
    return struct.pack("=IHHII", 16 + len(body), kind, 2, 1, 0) + body


def qdisc(index, *, parent=ROOT, name=b"fq_codel\0", packets=3, waiting=4242, dropped=17, stats=True):
    """One queue as a dump lists it."""
    body = struct.pack("=BxxxiIII", 0, index, 0x80010000, parent, 2) + attribute(KIND, name)
    if stats:
        nested = attribute(STATS_BASIC, bytes(16)) + attribute(
            STATS_QUEUE, struct.pack("=IIIII", packets, waiting, dropped, 0, 0)
        )
        body += attribute(STATS2 | NESTED, nested)
    return message(NEWQDISC, body)


END = message(DONE, bytes(4))


def test_the_root_queue_of_the_interface_is_found_among_others():
    """Of queues of other interfaces and of leaves below the root, none is taken for it."""
    answer = qdisc(2, waiting=1) + qdisc(3, parent=0x80010001, waiting=2) + qdisc(3) + qdisc(4, waiting=5) + END
    assert find_root(answer, 3) == (Backlog(waiting_bytes=4242, dropped_packets=17), True)


@pytest.mark.parametrize("answer", [END, message(ERROR, bytes(20)), qdisc(2) + END, b"", qdisc(3, stats=False) + END])
def test_without_a_root_queue_there_is_no_backlog(answer):
    """No answer, a refusal, another interface or a queue that counts nothing: nothing is known."""
    assert find_root(answer, 3)[0] is None


def test_an_interface_without_a_queue_has_no_backlog():
    """Queues inside mac80211 show no zero, which would mean an empty one."""
    assert find_root(qdisc(3, name=b"noqueue\0", waiting=0), 3) == (None, True)


def test_an_answer_goes_on_until_its_end():
    """A dump comes in parts."""
    assert find_root(qdisc(2) + qdisc(4), 3) == (None, False)


def test_a_cut_answer_is_none(monkeypatch):
    """What cannot be read is not guessed at, and no exception leaves."""
    whole = qdisc(3)

    class Kernel:
        def __init__(self, *_):
            self.parts = [whole[:30]]

        def __enter__(self):
            return self

        def __exit__(self, *_):
            return None

        def settimeout(self, _):
            pass

        def send(self, _):
            pass

        def recv(self, _):
            if not self.parts:
                raise TimeoutError
            return self.parts.pop()

    monkeypatch.setattr(socket, "socket", Kernel)
    assert read_backlog(3) is None


def test_the_kernel_answers():
    """For real: loopback has no queue, an interface that is not there has none either."""
    assert read_backlog(socket.if_nametoindex("lo")) is None
    assert read_backlog(999_999) is None
