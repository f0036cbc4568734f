"""Listens to the multicast discovery of a ROS domain on one interface, without joining it."""

from __future__ import annotations

import select
import socket
import struct
import time
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import psutil

from arpd.host.interface import index_of, ipv4_addresses
from arpd.model.errors import NotKnownError
from arpd.model.quantities import printable
from arpd.model.wire import ETHERNET_BYTES, IPV4_BYTES, UDP_BYTES

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

_GROUP = "239.255.0.1"  # of participant discovery (OMG DDSI-RTPS 2.3, 9.6.1)
_PORT, _PORTS_OF_DOMAIN, _MOST_DOMAIN = 7400, 250, 232
_GUID = slice(8, 20)  # first bytes of the sender's, in the header of every RTPS message
_FIRST_SUBMESSAGE = 20
_DATA, _LITTLE_ENDIAN = 0x15, 0x01
_TO_PARAMETERS = 20 + 4  # from the body of a DATA submessage without inline QoS: two ids, a number, CDR header
_PROPERTY_LIST, _METATRAFFIC_LOCATOR, _SENTINEL = 0x59, 0x32, 0x01
_TRANSPORTS = {1: "UDPv4", 2: "UDPv6", 4: "TCPv4", 8: "TCPv6"}  # kinds of locators (fastdds/rtps/common/Locator.h)
_HOST, _PROCESS = "fastdds.physical_data.host", "fastdds.physical_data.process"
_IP_PKTINFO, _IP_MULTICAST_ALL = 8, 49  # linux/in.h
_PACKET_INFO = struct.Struct("i4s4s")  # interface, its address, destination (ip(7))
_MOST_PARTICIPANTS = 1000
_MOST_NAME = 60
_HEADERS_BYTES = ETHERNET_BYTES + IPV4_BYTES + UDP_BYTES


@dataclass(frozen=True, kw_only=True, slots=True)
class Announcer:
    """A participant that announces itself by multicast.

    Parameters
    ----------
    host : name or address of its computer
    process : its command, or its number in words; empty = not known
    is_here : whether it runs on this computer
    is_arpds : whether it is a process of arpd's; never known of another computer's
    transports : over what it tells of its topics, as "UDPv4"; empty = not known
    """

    host: str
    process: str
    is_here: bool
    is_arpds: bool
    transports: frozenset[str] = frozenset()


@dataclass(frozen=True, kw_only=True, slots=True)
class HeardDiscovery:
    """Multicast discovery on the link interface for some seconds.

    Parameters
    ----------
    bytes_per_second : with UDP, IP and Ethernet headers
    """

    domain_id: int
    announcers: tuple[Announcer, ...]
    bytes_per_second: float


@dataclass(slots=True)
class _Participant:
    address: str
    properties: dict[str, str] = field(default_factory=dict)
    transports: set[str] = field(default_factory=set)


class DiscoveryEar:
    """Collects the announcements that cross one interface.

    Parameters
    ----------
    own_addresses : addresses of this computer
    """

    def __init__(self, own_addresses: frozenset[str]) -> None:
        self._own = own_addresses
        self._participants: dict[bytes, _Participant] = {}
        self._bytes = 0

    def take(self, packet: bytes, sender: str) -> None:
        """Take one datagram of the discovery port, from an address."""
        self._bytes += len(packet) + _HEADERS_BYTES
        participant = participant_in(packet)
        if participant is None or len(self._participants) >= _MOST_PARTICIPANTS:
            return
        known = self._participants.setdefault(participant, _Participant(sender))
        properties, transports = announced(packet)
        known.properties.update(properties)
        known.transports.update(transports)

    def heard(self, *, domain_id: int, elapsed_s: float) -> HeardDiscovery:
        """Return everything that was heard in a time (s)."""
        announcers = [self._announcer(one) for one in self._participants.values()]
        return HeardDiscovery(
            domain_id=domain_id,
            announcers=tuple(sorted(announcers, key=lambda one: (not one.is_here, one.host, one.process))),
            bytes_per_second=self._bytes / elapsed_s,
        )

    def _announcer(self, one: _Participant) -> Announcer:
        is_here = one.address in self._own
        host = one.properties.get(_HOST, "").rpartition(":")[0] or one.address
        number = one.properties.get(_PROCESS, "")
        command = _command(number) if is_here and number.isdecimal() else ()
        return Announcer(
            host=host,
            process=command_name(command) or f"process {number or 'unknown'}",
            is_here=is_here,
            is_arpds=is_arpd(command),
            transports=frozenset(one.transports),
        )


def _command(number: str) -> tuple[str, ...]:
    try:
        words = psutil.Process(int(number)).cmdline()
    except (psutil.Error, OverflowError):
        return ()
    return tuple(printable(word, longest=_MOST_NAME) for word in words if word)


def command_name(command: tuple[str, ...]) -> str:
    """Return the name of a command: of a script or module where Python runs one; empty if there is no command."""
    program = _program(command)
    return f"{Path(command[0]).name} -c" if program == "-c" else Path(program).name


def is_arpd(command: tuple[str, ...]) -> bool:
    """Return whether a command is one of arpd's, in a workspace of colcon too (lib/arpd/relay)."""
    program = Path(_program(command))
    name = program.name
    return name == "arpd" or name.startswith("arpd.") or program.parts[-3:-1] == ("lib", "arpd")


def _program(command: tuple[str, ...]) -> str:
    """Return the path of a program; where Python runs one, of its script, the name of its module, or ``-c``."""
    if not command:
        return ""
    first, *rest = command
    if not Path(first).name.startswith("python"):
        return first
    return next((word for word in rest if not word.startswith("-") or word == "-c"), first)


def announced(packet: bytes) -> tuple[dict[str, str], set[str]]:
    """Return what the sender of an announcement tells of itself: properties, among them host and process; transports.

    The transports are those over which it takes part in discovery of topics; shared memory is not told.
    """
    properties: dict[str, str] = {}
    transports: set[str] = set()
    with suppress(struct.error, IndexError, UnicodeDecodeError):
        for parameter, order, value in _parameters(packet):
            if parameter == _PROPERTY_LIST:
                properties.update(_pairs(value, order))
            elif (
                parameter == _METATRAFFIC_LOCATOR and (kind := struct.unpack_from(f"{order}i", value)[0]) in _TRANSPORTS
            ):
                transports.add(_TRANSPORTS[kind])
    return properties, transports


def _parameters(packet: bytes) -> Iterator[tuple[int, str, bytes]]:
    """Yield kind, byte order and value of every parameter (OMG DDSI-RTPS 2.3, 9.4.2.11)."""
    for kind, order, body in _submessages(packet):
        if kind != _DATA:
            continue
        offset = _TO_PARAMETERS
        while offset + 4 <= len(body):
            parameter, length = struct.unpack_from(f"{order}HH", body, offset)
            if parameter == _SENTINEL:
                break
            yield parameter, order, body[offset + 4 : offset + 4 + length]
            offset += 4 + length


def _submessages(packet: bytes) -> Iterator[tuple[int, str, bytes]]:
    """Yield kind, byte order and body of every submessage (OMG DDSI-RTPS 2.3, 9.4)."""
    offset = _FIRST_SUBMESSAGE
    while offset + 4 <= len(packet):
        kind, flags = packet[offset], packet[offset + 1]
        order = "<" if flags & _LITTLE_ENDIAN else ">"
        (length,) = struct.unpack_from(f"{order}H", packet, offset + 2)
        yield kind, order, packet[offset + 4 : offset + 4 + length if length else len(packet)]
        if not length:  # it is the last one
            return
        offset += 4 + length


def _pairs(data: bytes, order: str) -> Iterator[tuple[str, str]]:
    (number,) = struct.unpack_from(f"{order}I", data)
    offset = 4
    for _ in range(min(number, 100)):
        words = []
        for _ in range(2):
            (length,) = struct.unpack_from(f"{order}I", data, offset)
            words.append(data[offset + 4 : offset + 4 + length].rstrip(b"\0").decode())
            offset += 4 + (length + 3 & ~3)
        name, value = words
        yield name, printable(value, longest=_MOST_NAME)


def listen(
    interface: str, domain_id: int, *, duration_s: float, clock: Callable[[], float] = time.monotonic
) -> HeardDiscovery:
    """Listen for a time (s) to what crosses an interface, also from this computer.

    Raises
    ------
    NotKnownError
        If the kernel lets nobody listen there.
    """
    index = index_of(interface)
    if index is None:
        raise NotKnownError(f"there is no interface {interface}")
    if not 0 <= domain_id <= _MOST_DOMAIN:
        raise NotKnownError(f"ROS has no domain {domain_id}")
    every = ipv4_addresses()
    ear = DiscoveryEar(frozenset[str]().union(*every.values()))
    try:
        with discovery_socket(domain_id) as heard:
            heard.setsockopt(socket.IPPROTO_IP, _IP_PKTINFO, 1)
            heard.setsockopt(socket.IPPROTO_IP, _IP_MULTICAST_ALL, 0)
            join_discovery(heard, index)
            began_s = clock()
            while (left_s := began_s + duration_s - clock()) > 0:
                if not select.select([heard], [], [], left_s)[0]:
                    continue
                packet, extra, _flags, sender = heard.recvmsg(65536, socket.CMSG_SPACE(_PACKET_INFO.size))
                arrived = [_PACKET_INFO.unpack(data)[0] for level, kind, data in extra if kind == _IP_PKTINFO]
                if index in arrived:
                    ear.take(packet, sender[0])
    except OSError as error:
        raise NotKnownError(f"cannot listen on {interface} ({error.strerror or error})") from None
    return ear.heard(domain_id=domain_id, elapsed_s=duration_s)


def discovery_socket(domain_id: int) -> socket.socket:
    """Return a socket for the multicast discovery of a domain; it hears the interfaces of `join_discovery`.

    Raises
    ------
    OSError
        If the kernel refuses it.
    """
    heard = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        heard.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        heard.bind((_GROUP, _PORT + _PORTS_OF_DOMAIN * domain_id))
    except BaseException:
        heard.close()
        raise
    return heard


def join_discovery(heard: socket.socket, index: int) -> None:
    """Let a socket hear the interface with a number of the kernel.

    Raises
    ------
    OSError
        If it cannot join the group: it is down, or has no address.
    """
    member = struct.pack("4s4si", socket.inet_aton(_GROUP), bytes(4), index)
    heard.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, member)


def participant_in(packet: bytes) -> bytes | None:
    """Return the first bytes of the GUIDs of the process that sent a packet, None if it is no message of RTPS."""
    return packet[_GUID] if packet[:4] == b"RTPS" and len(packet) >= _FIRST_SUBMESSAGE else None
