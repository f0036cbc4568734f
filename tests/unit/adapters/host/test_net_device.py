"""One interface as the kernel tells of it: what its answers say, as the kernel encodes them."""

import socket
import struct
from pathlib import Path

import pytest

from arpd.adapters.host.netlink import NetDevice, find_device, read_device

# linux/rtnetlink.h, linux/if_link.h
NEWLINK, DONE, ERROR = 16, 3, 2
NAME, STATS64, QUEUE_LENGTH = 3, 23, 13
UP, RUNNING = 0x1, 0x40


def attribute(kind, value):
    return struct.pack("=HH", 4 + len(value), kind) + value + bytes(-len(value) % 4)


def message(kind, body):
    return struct.pack("=IHHII", 16 + len(body), kind, 2, 1, 0) + body


def device(index, *, name=b"wlan0\0", flags=UP | RUNNING, counters=(1, 2, 300, 400, 5, 6, 7, 8)):
    """One interface as the kernel describes it, with more counters than are read."""
    body = struct.pack("=BxHiII", 0, 1, index, flags, 0) + attribute(NAME, name)
    body += attribute(QUEUE_LENGTH, struct.pack("=I", 1000))
    return message(NEWLINK, body + attribute(STATS64, struct.pack("=8Q", *counters) + bytes(128)))


def test_name_flags_and_counters_are_read():
    """Packets come before bytes, and what was received before what was sent."""
    expected = NetDevice(
        name="wlan0",
        is_up=True,
        is_running=True,
        rx_packets=1,
        tx_packets=2,
        rx_bytes=300,
        tx_bytes=400,
        tx_dropped=8,
    )
    assert find_device(device(2, counters=(9,) * 8) + device(3), 3) == (expected, True)


@pytest.mark.parametrize("flags", [0, UP, UP | RUNNING, UP | RUNNING | 0x1002])
def test_flags_are_told_apart(flags):
    """Other flags than the two mean nothing here."""
    found, _ = find_device(device(3, flags=flags), 3)
    assert found is not None
    assert (found.is_up, found.is_running) == (bool(flags & UP), bool(flags & RUNNING))


def test_an_answer_without_the_interface_ends_or_goes_on():
    """An error ends it; a part with other interfaces does not."""
    assert find_device(message(ERROR, struct.pack("=i", -19)), 3) == (None, True)
    assert find_device(device(4), 3) == (None, False)
    assert find_device(device(4) + message(DONE, bytes(4)), 3) == (None, True)


def test_the_kernel_tells_of_loopback_what_it_tells_everybody():
    """The same counters as in /proc/net/dev, on the host the test runs on."""
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
