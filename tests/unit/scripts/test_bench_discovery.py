"""The kinds of packets and the counts of scripts/bench/discovery.py."""

from __future__ import annotations

import struct

import pytest

from scripts.bench.discovery import PLAIN, DiscoveryError, check, rates
from scripts.bench.discovery_packets import (
    GRAPH,
    MULTICAST,
    OTHER,
    UNICAST,
    USER,
    Reader,
    Tally,
    document,
    is_steady,
    kind_of,
)

ROBOT, CEDDP = bytes.fromhex("02000a4d0001"), bytes.fromhex("02000a4d0002")
PREFIX = bytes(range(12))
ALL, FAR = "239.255.0.1", "10.77.0.2"


@pytest.fixture
def reader():
    return Reader({ROBOT: "robot", CEDDP: "ceddp"}, domains=(0, 77))


def ipv4(payload, *, to=FAR, protocol=17, identity=1, offset=0, more=False):
    flags = (0x2000 if more else 0) | offset // 8
    addresses = bytes([10, 77, 0, 1, *map(int, to.split("."))])
    head = struct.pack("!BBHHHBBH", 0x45, 0, 20 + len(payload), identity, flags, 64, protocol, 0)
    return CEDDP + ROBOT + b"\x08\x00" + head + addresses + payload


def udp(port, *, payload=b"RTPS\x02\x03\x01\x0f" + PREFIX, source_port=40000):
    return struct.pack("!HHHH", source_port, port, 8 + len(payload), 0) + payload


@pytest.mark.parametrize(
    ("port", "is_multicast", "expected"),
    [
        (7400, True, (MULTICAST, 0)),
        (7401, True, (USER, 0)),
        (7402, True, (OTHER, 0)),
        (7410, False, (UNICAST, 0)),
        (7411, False, (USER, 0)),
        (7648, False, (UNICAST, 0)),  # of participant 119, the last one in a domain
        (7400, False, (OTHER, 0)),
        (7000, False, (GRAPH, None)),
        (7399, False, (GRAPH, None)),
        (26650, True, (MULTICAST, 77)),
        (26660, False, (UNICAST, 77)),
        (26663, False, (USER, 77)),
        (7660, False, (OTHER, None)),  # of domain 1, which is not in use
        (53, False, (OTHER, None)),
    ],
)
def test_the_port_says_the_kind(port, is_multicast, expected):
    """By the rule of RTPS: 7400 + 250 * domain + offset."""
    assert kind_of(port, is_multicast=is_multicast, domains=(0, 77)) == expected


def test_a_frame_names_its_host_its_port_and_its_participant(reader):
    """The size has the Ethernet header."""
    frame = ipv4(udp(7400), to=ALL)
    packet = reader.read(frame)
    assert (packet.sender, packet.kind, packet.domain, packet.source_port) == ("robot", MULTICAST, 0, 40000)
    assert (packet.participant, packet.size_bytes) == (PREFIX.hex(), len(frame))


def test_later_fragments_are_of_the_kind_of_the_first(reader):
    """Only the first has ports; a fragment of another datagram is not one of them."""
    first = reader.read(ipv4(udp(7411, payload=b"RTPS\x02\x03\x01\x0f" + PREFIX + bytes(1444)), more=True))
    later = reader.read(ipv4(bytes(100), offset=1480))
    stranger = reader.read(ipv4(bytes(100), offset=1480, identity=2))
    assert [packet.kind for packet in (first, later, stranger)] == [USER, USER, OTHER]
    assert later.participant == PREFIX.hex()
    assert later.size_bytes == 14 + 20 + 100


@pytest.mark.parametrize("frame", [ipv4(bytes(8), protocol=1), CEDDP + ROBOT + b"\x08\x06" + bytes(28)])
def test_what_is_no_udp_is_other(reader, frame):
    """ICMP and ARP, too, take their time on the link."""
    packet = reader.read(frame)
    assert (packet.kind, packet.sender, packet.size_bytes) == (OTHER, "robot", len(frame))


def period(nodes, *, packets, size=500, lost=0, port=7400):
    """Return a period in which the nodes send packets of one kind in turn."""
    reader = Reader({ROBOT: "robot", CEDDP: "ceddp"}, domains=(0,))
    tally = Tally(span_s=3.0, lost=lost)
    for number in range(packets):
        payload = b"RTPS\x02\x03\x01\x0f" + PREFIX[:-1] + bytes([number % nodes])
        tally.add(reader.read(ipv4(udp(port, payload=payload.ljust(size - 42, b"\0")), to=ALL)))
    return tally


def cell(side, nodes, *, packets, size):
    """Return a cell of two periods."""
    return {
        "side": side,
        "nodes": nodes,
        "link_bytes_per_second": 2.5e6,
        "is_steady": True,
        "joined_bytes": 1_000_000,
        "discovered_s": 3.0,
        **document([period(nodes, packets=packets, size=size)] * 2),
    }


def test_the_document_counts_every_packet_once():
    """By kind, by participant and by period."""
    found = cell(PLAIN, 4, packets=12, size=500)
    assert [(flow["kind"], flow["packets"], flow["bytes"]) for flow in found["flows"]] == [(MULTICAST, 24, 12_000)]
    assert [each["packets"] for each in found["participants"]] == [6] * 4
    assert found["periods"] == [{"packets": 12, "bytes": 6000}] * 2
    assert rates(found) == rates(found, MULTICAST) == "4.0 (2.00)"
    assert rates(found, USER) == "0"


@pytest.mark.parametrize(
    ("counts", "expected"),
    [([300, 300, 301], True), ([300, 306, 309], True), ([1415, 1304, 1490], False), ([10, 14, 10], False)],
)
def test_a_link_is_steady_while_nodes_only_announce_themselves(counts, expected):
    """The same number of packets of discovery in every period, but for a few that come early or late."""
    assert is_steady([period(4, packets=count) for count in counts]) is expected


def test_user_data_may_come_and_go_on_a_steady_link():
    """The daemon probes now and then."""
    busy = period(4, packets=30)
    busy.packets += period(4, packets=500, port=7401).packets
    assert is_steady([period(4, packets=30), busy])


def test_a_period_with_lost_packets_is_not_steady():
    """Its counts are too low."""
    assert not is_steady([period(4, packets=30), period(4, packets=30, lost=1)])


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"flows": []}, "4 nodes, plain ROS 2: nothing crossed the link"),
        ({"nodes": 5}, "5 nodes, plain ROS 2: 4 participants of the robot were on the link"),
    ],
)
def test_a_plain_robot_that_is_not_heard_is_refused(change, complaint):
    """The figures would be those of another robot."""
    found = cell(PLAIN, 4, packets=12, size=500)
    check(found)
    with pytest.raises(DiscoveryError, match=complaint):
        check({**found, **change})
