"""The packets of a link, by kind and by participant of DDS: what `discovery.py` captures."""

from __future__ import annotations

import socket
import struct
import time
from collections import Counter
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, Any

from arpd.model.wire import ETHERNET_BYTES, UDP_BYTES
from scripts.netns.namespaces import inside

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence

    from scripts.netns.simlink import SimLink

MULTICAST, UNICAST, GRAPH, USER, OTHER = KINDS = (
    "multicast discovery",
    "unicast discovery",
    "ROS graph",
    "user data",
    "other",
)

_PORT_BASE, _DOMAIN_GAIN, _UNICAST_OFFSET = 7400, 250, 10  # OMG DDSI-RTPS 2.3, 9.6.1
_GRAPH_PORTS = range(7000, 7400)  # rmw_fastrtps receives ros_discovery_info there, in every domain
_IPV4, _UDP = 0x0800, 17
_EVERY_PROTOCOL = 0x0003  # ETH_P_ALL
_PREFIX = slice(8, 20)  # of an RTPS message: the GUID prefix of its sender
_SO_RCVBUFFORCE, _SOL_PACKET, _PACKET_STATISTICS = 33, 263, 6
_RECEIVE_BYTES = 32 << 20
_SPREAD, _SPREAD_PACKETS = 0.03, 3  # between steady periods: announcements come a little early or late


@dataclass(frozen=True, kw_only=True, slots=True)
class Packet:
    """A frame on the link.

    Parameters
    ----------
    sender : host that sent it; empty for a stranger
    size_bytes : with the Ethernet header
    domain : ROS domain of its destination; None for one that names no domain
    source_port : 0 without UDP
    participant : GUID prefix of the sender, in hexadecimal; empty without RTPS
    """

    sender: str
    size_bytes: int
    kind: str = OTHER
    domain: int | None = None
    source_port: int = 0
    participant: str = ""


def kind_of(port: int, *, is_multicast: bool, domains: Collection[int]) -> tuple[str, int | None]:
    """Return the kind of a datagram and its domain, by the port it goes to.

    Parameters
    ----------
    domains : those in use; the ports of any other mean nothing
    """
    if port in _GRAPH_PORTS:
        return GRAPH, None
    domain, offset = divmod(port - _PORT_BASE, _DOMAIN_GAIN)
    if domain not in domains:
        return OTHER, None
    if is_multicast:
        return {0: MULTICAST, 1: USER}.get(offset, OTHER), domain
    if offset < _UNICAST_OFFSET:
        return OTHER, domain
    return USER if offset % 2 else UNICAST, domain


class Reader:
    """Reads frames; later fragments of a datagram are of the kind of the first, which alone has ports.

    Parameters
    ----------
    hosts : their names by Ethernet address
    domains : ROS domains in use
    """

    def __init__(self, hosts: Mapping[bytes, str], domains: Collection[int]) -> None:
        self._hosts = hosts
        self._domains = domains
        self._fragmented: dict[tuple[bytes, bytes], Packet] = {}

    def read(self, frame: bytes) -> Packet:
        """Return what a frame is."""
        sender = self._hosts.get(frame[6:12], "")
        other = Packet(sender=sender, size_bytes=len(frame))
        if frame[12:14] != _IPV4.to_bytes(2, "big") or frame[ETHERNET_BYTES + 9] != _UDP:
            return other
        ip = frame[ETHERNET_BYTES:]
        (flags,) = struct.unpack_from("!H", ip, 6)
        identity = (ip[12:16], ip[4:6])
        if flags & 0x1FFF:
            return replace(self._fragmented.get(identity, other), size_bytes=len(frame))
        datagram = ip[(ip[0] & 0x0F) * 4 :]
        source_port, port = struct.unpack_from("!HH", datagram)
        kind, domain = kind_of(port, is_multicast=ip[16] & 0xF0 == 0xE0, domains=self._domains)
        message = datagram[UDP_BYTES:]
        packet = Packet(
            sender=sender,
            size_bytes=len(frame),
            kind=kind,
            domain=domain,
            source_port=source_port,
            participant=message[_PREFIX].hex() if message[:4] == b"RTPS" else "",
        )
        if flags & 0x2000:
            self._fragmented[identity] = packet
        return packet


@dataclass(slots=True)
class Tally:
    """Packets of a while, by what they are.

    Attributes
    ----------
    span_s : its length (s)
    lost : packets that the capture missed
    """

    span_s: float = 0.0
    lost: int = 0
    packets: Counter[tuple[str, str, int | None]] = field(default_factory=Counter)
    sizes_bytes: Counter[tuple[str, str, int | None]] = field(default_factory=Counter)
    participants: dict[tuple[str, str], list[Packet]] = field(default_factory=dict)

    @property
    def discovery_packets(self) -> int:
        """Packets with which nodes find each other."""
        return sum(count for (_, kind, _), count in self.packets.items() if kind in (MULTICAST, UNICAST, GRAPH))

    def add(self, packet: Packet) -> None:
        """Count a packet."""
        key = (packet.sender, packet.kind, packet.domain)
        self.packets[key] += 1
        self.sizes_bytes[key] += packet.size_bytes
        if packet.participant:
            self.participants.setdefault((packet.sender, packet.participant), []).append(packet)


def is_steady(periods: Sequence[Tally]) -> bool:
    """Return whether nodes announce themselves and nothing more: then all periods have as many packets of discovery."""
    counts = [period.discovery_packets for period in periods]
    most = max(counts)
    return most - min(counts) <= _SPREAD * most + _SPREAD_PACKETS and not any(period.lost for period in periods)


def document(periods: Sequence[Tally]) -> dict[str, Any]:
    """Return the counts of successive periods together, for JSON."""
    packets: Counter[tuple[str, str, int | None]] = Counter()
    sizes_bytes: Counter[tuple[str, str, int | None]] = Counter()
    participants: dict[tuple[str, str], list[Packet]] = {}
    for period in periods:
        packets += period.packets
        sizes_bytes += period.sizes_bytes
        for whose, sent in period.participants.items():
            participants.setdefault(whose, []).extend(sent)
    return {
        "span_s": sum(period.span_s for period in periods),
        "lost": sum(period.lost for period in periods),
        "flows": [
            {"from": key[0], "kind": key[1], "domain": key[2], "packets": count, "bytes": sizes_bytes[key]}
            for key, count in sorted(packets.items(), key=str)
        ],
        "participants": [
            {
                "from": sender,
                "guid_prefix": prefix,
                "source_ports": sorted({packet.source_port for packet in sent}),
                "domains": sorted({packet.domain for packet in sent if packet.domain is not None}),
                "packets": len(sent),
                "bytes": sum(packet.size_bytes for packet in sent),
            }
            for (sender, prefix), sent in sorted(participants.items())
        ],
        "periods": [{"packets": period.packets.total(), "bytes": period.sizes_bytes.total()} for period in periods],
    }


class Capture:
    """Captures what crosses the link, in both directions, until it is closed.

    The kernel shows each frame on the robot's interface behind the queue, so all that is counted has left it.

    Parameters
    ----------
    domains : ROS domains in use
    """

    def __init__(self, link: SimLink, domains: Collection[int]) -> None:
        self._reader = Reader({_mac(host.mac): host.name for host in link.hosts}, domains)
        namespace = link.robot.namespace
        # With protocol 0 the socket receives nothing before it is bound to the interface.
        self._socket = inside(namespace, partial(socket.socket, socket.AF_PACKET, socket.SOCK_RAW, 0))
        self._socket.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, _RECEIVE_BYTES)
        inside(namespace, partial(self._socket.bind, (link.robot.interface, _EVERY_PROTOCOL)))

    def close(self) -> None:
        """End the capture."""
        self._socket.close()

    def period(self, for_s: float) -> Tally:
        """Count what crosses the link for a while from now on."""
        tally, began_s = Tally(), time.monotonic()
        while (left_s := began_s + for_s - time.monotonic()) > 0.0:
            self._socket.settimeout(left_s)
            try:
                frame = self._socket.recv(65536)
            except TimeoutError:
                break
            tally.add(self._reader.read(frame))
        tally.span_s = time.monotonic() - began_s
        # Reading the kernel's count sets it to zero.
        _, tally.lost = struct.unpack("II", self._socket.getsockopt(_SOL_PACKET, _PACKET_STATISTICS, 8))
        return tally


def _mac(text: str) -> bytes:
    return bytes.fromhex(text.replace(":", ""))
