"""Counters and queue of an interface, from answers as the kernel encodes them."""

import struct
from pathlib import Path

import pytest

from arpd.host.netlink import bodies, link_in, read_counters, root_queue_in
from arpd.model.interface import InterfaceState, LinkCounters

# linux/rtnetlink.h, linux/if_link.h, linux/pkt_sched.h, linux/gen_stats.h
NEWQDISC, DONE, ERROR = 36, 3, 2
NAME, QUEUE, STATS64 = 3, 6, 23
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


@pytest.mark.parametrize(
    ("parts", "found"),
    [
        # Among queues of other interfaces and leaves below the root.
        ([qdisc(2, waiting=1) + qdisc(3, parent=0x80010001, waiting=2), qdisc(3) + qdisc(4, waiting=5)], (4242, 17)),
        ([END, qdisc(3)], None),
        ([message(ERROR, bytes(20)), qdisc(3)], None),
        ([qdisc(2) + END], None),
        ([b""], None),
        ([qdisc(3, stats=False) + END], None),
    ],
)
def test_the_root_queue_of_the_interface_is_found_in_any_part_of_the_answer(parts, found):
    """No answer, an error, another interface or a queue without counters gives no backlog."""
    told = (root_queue_in(body, 3) for body in bodies(parts, NEWQDISC))
    assert next(filter(None, told), None) == found


@pytest.mark.parametrize(
    ("flags", "state"), [(0x1043, "up"), (0x1003, "no_carrier"), (0x1002, "down")], ids=["up", "no carrier", "down"]
)
@pytest.mark.parametrize(("queue", "has_queue"), [(b"fq_codel\0", True), (b"noqueue\0", False)])
def test_counters_state_and_queue_of_an_interface_are_found(flags, state, queue, has_queue):
    """Each number stands where linux/if_link.h has it, and a Wi-Fi driver that queues by itself has no queue here."""
    stats = struct.pack("=24Q", 11, 22, 333, 444, 5, 6, 7, 8, *range(16))
    told = attribute(NAME, b"wlan0\0") + attribute(QUEUE, queue) + attribute(STATS64, stats)
    body = struct.pack("=BxHiII", 0, 1, 3, flags, 0) + told
    counters = LinkCounters(
        interface="wlan0",
        rx_packets=11,
        tx_packets=22,
        rx_bytes=333,
        tx_bytes=444,
        tx_dropped=8,
        state=InterfaceState(state),
    )
    assert link_in(body) == (3, has_queue, counters)


def test_the_kernel_answers():
    """Loopback has the counters of /proc/net/dev and no queue, and a missing interface is None, on a real host."""
    found = read_counters("lo")
    (line,) = (line for line in Path("/proc/net/dev").read_text().splitlines() if line.split(":")[0].strip() == "lo")
    rx_bytes, rx_packets = map(int, line.split(":")[1].split()[:2])
    assert 0 <= rx_bytes - found.rx_bytes < 10_000_000
    assert found.rx_packets <= rx_packets
    assert found.backlog_bytes is None
    assert read_counters("none_such") is None
