"""The packets of a link, by kind and by participant of DDS: what `discovery.py` captures."""

from __future__ import annotations

import socket
import struct
import time
from collections import Counter
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any

from arpd.model.errors import ArpdError
from arpd.model.wire import ETHERNET_BYTES, UDP_BYTES
from scripts.netns.namespaces import inside

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping

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


class CaptureError(ArpdError):
    """The capture lost packets."""


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
            first = self._fragmented.get(identity, other)
            return Packet(sender=sender, size_bytes=len(frame), kind=first.kind, domain=first.domain,
                          source_port=first.source_port, participant=first.participant)  # fmt: skip
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

    Parameters
    ----------
    span_s : its length (s)
    """

    span_s: float
    packets: Counter[tuple[str, str, int | None]] = field(default_factory=Counter)
    sizes_bytes: Counter[tuple[str, str, int | None]] = field(default_factory=Counter)
    by_second_bytes: list[int] = field(default_factory=list)
    _participants: dict[tuple[str, str], list[Packet]] = field(default_factory=dict)

    def add(self, packet: Packet, after_s: float) -> None:
        """Count a packet that came so long after the start (s)."""
        key = (packet.sender, packet.kind, packet.domain)
        self.packets[key] += 1
        self.sizes_bytes[key] += packet.size_bytes
        second = int(after_s)
        self.by_second_bytes += [0] * (second + 1 - len(self.by_second_bytes))
        self.by_second_bytes[second] += packet.size_bytes
        if packet.participant:
            self._participants.setdefault((packet.sender, packet.participant), []).append(packet)

    def document(self) -> dict[str, Any]:
        """Return the counts for JSON."""
        return {
            "span_s": self.span_s,
            "flows": [
                {"from": sender, "kind": kind, "domain": domain, "packets": count, "bytes": self.sizes_bytes[key]}
                for key, count in sorted(self.packets.items(), key=str)
                for sender, kind, domain in [key]
            ],
            "participants": [
                {
                    "from": sender,
                    "guid_prefix": prefix,
                    "source_ports": sorted({packet.source_port for packet in packets}),
                    "domains": sorted({packet.domain for packet in packets if packet.domain is not None}),
                    "packets": len(packets),
                    "bytes": sum(packet.size_bytes for packet in packets),
                }
                for (sender, prefix), packets in sorted(self._participants.items())
            ],
            "bytes_by_second": self.by_second_bytes,
        }


def capture(
    link: SimLink, for_s: float, *, domains: Collection[int], on_second: Callable[[], object] = lambda: None
) -> Tally:
    """Count what crosses the link for a while, in both directions.

    The kernel shows each frame on the robot's interface behind the queue, so all that is counted has left it.

    Parameters
    ----------
    on_second : called about once a second

    Raises
    ------
    CaptureError
        If packets came faster than they were read.
    """
    reader = Reader({_mac(host.mac): host.name for host in link.hosts}, domains)
    tally = Tally(for_s)
    # With protocol 0 the socket receives nothing before it is bound to the interface.
    opened = inside(link.robot.namespace, partial(socket.socket, socket.AF_PACKET, socket.SOCK_RAW, 0))
    with opened as receiver:
        receiver.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, _RECEIVE_BYTES)
        receiver.settimeout(0.2)
        inside(link.robot.namespace, partial(receiver.bind, (link.robot.interface, _EVERY_PROTOCOL)))
        started_s = called_s = time.monotonic()
        while (after_s := time.monotonic() - started_s) < for_s:
            if started_s + after_s - called_s >= 1.0:
                called_s = started_s + after_s
                on_second()
            try:
                frame = receiver.recv(65536)
            except TimeoutError:
                continue
            tally.add(reader.read(frame), after_s)
        seen, dropped = struct.unpack("II", receiver.getsockopt(_SOL_PACKET, _PACKET_STATISTICS, 8))
    if dropped:
        raise CaptureError(f"the capture lost {dropped} of {seen} packets: the machine is too busy")
    return tally


def _mac(text: str) -> bytes:
    return bytes.fromhex(text.replace(":", ""))
