"""Listens to the multicast discovery of a ROS domain, without joining it."""

from __future__ import annotations

import logging
import re
import socket
import struct
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from arpd.host.interface import index_of, ipv4_addresses
from arpd.host.kernel import PROC
from arpd.model.errors import NotKnownError
from arpd.model.quantities import printable
from arpd.model.wire import ETHERNET_BYTES, IPV4_BYTES, MOST_DOMAIN, UDP_BYTES, domain_port

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence

log = logging.getLogger(__name__)
_GROUP = "239.255.0.1"  # of participant discovery (OMG DDSI-RTPS 2.3, 9.6.1)
_GUID = slice(8, 20)  # first bytes of the sender's, in the header of every RTPS message
_FIRST_SUBMESSAGE = 20
_DATA, _LITTLE_ENDIAN = 0x15, 0x01
_TO_PARAMETERS = 20 + 4  # from the body of a DATA submessage without inline QoS: two ids, a number, CDR header
_PROPERTY_LIST, _METATRAFFIC_LOCATOR, _DEFAULT_LOCATOR, _SENTINEL = 0x59, 0x32, 0x31, 0x01
_UDPV4, _ADDRESS = 1, slice(20, 24)  # of a locator
_TRANSPORTS = {1: "UDPv4", 2: "UDPv6", 4: "TCPv4", 8: "TCPv6"}  # kinds of locators (fastdds/rtps/common/Locator.h)
_HOST, _PROCESS = "fastdds.physical_data.host", "fastdds.physical_data.process"
_IP_MULTICAST_ALL = 49  # linux/in.h
_MOST_PARTICIPANTS = 1000
_MOST_NAME = 60
_HEADERS_BYTES = ETHERNET_BYTES + IPV4_BYTES + UDP_BYTES
_FORGET_S = 60.0  # after a participant was heard last


@dataclass(frozen=True, kw_only=True, slots=True)
class Announcer:
    """A participant that announces itself by multicast.

    Parameters
    ----------
    host : name or address of its computer
    process : its command, or its number in words where none, or several, of this computer go by that
    is_here : whether it runs on this computer
    is_arpds : whether it is a process of arpd's; never known of another computer's
    transports : over what it tells of its topics, as "UDPv4"; empty = not known
    memory : its user, and where they may be seen, the numbers of its /dev/shm; None = not known, or of another computer
    addresses : over IPv4, to each of which others send every sample; empty = not known
    """

    host: str
    process: str
    is_here: bool
    is_arpds: bool
    transports: frozenset[str] = frozenset()
    memory: tuple[int, ...] | None = None
    addresses: frozenset[str] = frozenset()


class Told(NamedTuple):
    """What a participant tells of itself: properties, transports over which it discovers topics, and addresses."""

    properties: dict[str, str]
    transports: set[str]
    addresses: set[str]


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


def heard(
    packets: Iterable[tuple[bytes, str]],
    *,
    own: Collection[str],
    domain_id: int,
    duration_s: float,
    proc: Path = PROC,
) -> HeardDiscovery:
    """Return what the datagrams of a discovery port tell, each with the address that it came from.

    Parameters
    ----------
    own : addresses of this computer
    duration_s : time in which they came (s)
    """
    participants: dict[bytes, tuple[str, Told]] = {}
    size_bytes = 0
    for packet, sender in packets:
        size_bytes += len(packet) + _HEADERS_BYTES
        participant = participant_in(packet)
        if participant is not None and len(participants) < _MOST_PARTICIPANTS:
            first, before = participants.get(participant, (sender, None))
            participants[participant] = first, announced(packet, before)
    running = _running(proc)
    announcers = [_announcer(*one, own, running) for one in participants.values()]
    return HeardDiscovery(
        domain_id=domain_id,
        announcers=tuple(sorted(announcers, key=lambda one: (not one.is_here, one.host, one.process))),
        bytes_per_second=size_bytes / duration_s,
    )


def _running(proc: Path) -> dict[str, list[tuple[Path, list[str]]]]:
    """Return the processes of this computer, each with its command, by the numbers that they themselves see.

    In a container these are others than here, and several processes may have one.
    """
    found: dict[str, list[tuple[Path, list[str]]]] = {}
    for process in proc.glob("[0-9]*"):
        with suppress(OSError):
            numbers = re.findall(r"^NSpid:.*\t(\d+)$", (process / "status").read_text(errors="replace"), re.MULTILINE)
            words = [word for word in (process / "cmdline").read_text(errors="replace").split("\0") if word]
            for number in numbers if words else ():  # the kernel's own have no command
                found.setdefault(number, []).append((process, words))
    return found


def _announcer(
    address: str, told: Told, own: Collection[str], running: Mapping[str, Sequence[tuple[Path, list[str]]]]
) -> Announcer:
    is_here, number = address in own, told.properties.get(_PROCESS, "")
    known = running.get(number, ()) if is_here else ()
    process, words = known[0] if len(known) == 1 else (None, [])
    program = _program(*words)
    return Announcer(
        host=told.properties.get(_HOST, "").rpartition(":")[0] or address,
        process=printable(program.name, longest=_MOST_NAME) or f"process {number or 'unknown'}",
        is_here=is_here,
        # In a workspace of colcon it is lib/arpd/relay.
        is_arpds=program.name.partition(".")[0] == "arpd" or program.parts[-3:-1] == ("lib", "arpd"),
        transports=frozenset(told.transports),
        memory=_memory(process) if process else None,
        addresses=frozenset(told.addresses),
    )


def _program(program: str = "", *words: str) -> Path:
    """Return what a command runs; where that is Python, the script or the module."""
    if Path(program).name.startswith("python"):
        # What follows -c is code, and no name.
        script = next((word for word in words if word == "-c" or not word.startswith("-")), "-c")
        program = program if script == "-c" else script
    return Path(program)


def _memory(process: Path) -> tuple[int, ...] | None:
    """Return the user of a process of this computer, and where they may be seen, the numbers of its /dev/shm."""
    told: tuple[int, ...] | None = None
    with suppress(OSError):
        told = (process.stat().st_uid,)
        found = (process / "root/dev/shm").stat()
        told += (found.st_dev, found.st_ino)
    return told


def announced(packet: bytes, before: Told | None = None) -> Told:
    """Return what the sender of an announcement tells of itself, with what it told before; never of shared memory."""
    told = before or Told({}, set(), set())
    with suppress(struct.error, IndexError, UnicodeDecodeError, OSError):  # the last for a short address
        for parameter, order, value in _parameters(packet):
            if parameter == _PROPERTY_LIST:
                words = _words(value, order)
                told.properties.update(zip(words, words, strict=False))
            elif parameter in {_METATRAFFIC_LOCATOR, _DEFAULT_LOCATOR}:
                (kind,) = struct.unpack_from(f"{order}i", value)
                if parameter == _METATRAFFIC_LOCATOR and kind in _TRANSPORTS:
                    told.transports.add(_TRANSPORTS[kind])
                elif parameter == _DEFAULT_LOCATOR and kind == _UDPV4:
                    told.addresses.add(socket.inet_ntoa(value[_ADDRESS]))
    return told


def _parameters(packet: bytes) -> Iterator[tuple[int, str, bytes]]:
    """Yield kind, byte order and value of every parameter (OMG DDSI-RTPS 2.3, 9.4 and 9.4.2.11)."""
    for kind, order, body in _submessages(packet):
        offset = _TO_PARAMETERS
        while kind == _DATA and offset + 4 <= len(body):
            parameter, length = struct.unpack_from(f"{order}HH", body, offset)
            if parameter == _SENTINEL:
                break
            yield parameter, order, body[offset + 4 : offset + 4 + length]
            offset += 4 + length


def _submessages(packet: bytes) -> Iterator[tuple[int, str, bytes]]:
    """Yield kind, byte order and body of every submessage; one without a length is the last."""
    offset = _FIRST_SUBMESSAGE
    while offset + 4 <= len(packet):
        order = "<" if packet[offset + 1] & _LITTLE_ENDIAN else ">"
        (length,) = struct.unpack_from(f"{order}H", packet, offset + 2)
        end = offset + 4 + length if length else len(packet)
        yield packet[offset], order, packet[offset + 4 : end]
        offset = end


def _words(data: bytes, order: str) -> Iterator[str]:
    """Yield the texts of a list of properties: names and values by turns."""
    offset = 4  # after their number
    while offset + 4 <= len(data):
        (length,) = struct.unpack_from(f"{order}I", data, offset)
        yield printable(data[offset + 4 : offset + 4 + length].rstrip(b"\0").decode(), longest=_MOST_NAME)
        offset += 4 + (length + 3 & ~3)


def listen(interface: str, domain_id: int, *, duration_s: float) -> HeardDiscovery:
    """Listen for a time (s) to what crosses an interface, also from this computer.

    Raises
    ------
    NotKnownError
        If the kernel lets nobody listen there.
    """
    index = index_of(interface)
    if index is None:
        raise NotKnownError(f"there is no interface {interface}")
    if not 0 <= domain_id <= MOST_DOMAIN:
        raise NotKnownError(f"ROS has no domain {domain_id}")
    own = frozenset[str]().union(*ipv4_addresses().values())
    try:
        with discovery_socket(domain_id) as ear:
            ear.setsockopt(socket.IPPROTO_IP, _IP_MULTICAST_ALL, 0)  # what other sockets joined is not heard
            join_discovery(ear, index)
            return heard(_packets(ear, duration_s), own=own, domain_id=domain_id, duration_s=duration_s)
    except OSError as error:
        raise NotKnownError(f"cannot listen on {interface} ({error.strerror or error})") from None


def _packets(ear: socket.socket, duration_s: float) -> Iterator[tuple[bytes, str]]:
    began_s = time.monotonic()
    with suppress(TimeoutError):
        while (left_s := began_s + duration_s - time.monotonic()) > 0:
            ear.settimeout(left_s)
            packet, (address, _port) = ear.recvfrom(65536)
            yield packet, address


def discovery_socket(domain_id: int) -> socket.socket:
    """Return a socket for the multicast discovery of a domain; it hears the interfaces of `join_discovery`."""
    ear = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        ear.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        ear.bind((_GROUP, domain_port(domain_id)))
    except BaseException:
        ear.close()
        raise
    return ear


def join_discovery(ear: socket.socket, index: int, *, is_gone: bool = False) -> None:
    """Let a socket hear the interface with a number of the kernel; OSError where that is down, or has no address.

    Parameters
    ----------
    is_gone : whether to leave it instead: the kernel lets a socket hear twenty, and counts those that are gone
    """
    member = struct.pack("4s4si", socket.inet_aton(_GROUP), bytes(4), index)
    ear.setsockopt(socket.IPPROTO_IP, socket.IP_DROP_MEMBERSHIP if is_gone else socket.IP_ADD_MEMBERSHIP, member)


def participant_in(packet: bytes) -> bytes | None:
    """Return the first bytes of the GUIDs of the process that sent a packet, None if it is no message of RTPS."""
    return packet[_GUID] if packet[:4] == b"RTPS" and len(packet) >= _FIRST_SUBMESSAGE else None


class AnnouncedParticipants:
    """Hears the multicast discovery of the local domain, and remembers whose it is.

    It hears this host's nodes, too. A participant of the other side that announces itself here has crossed the link
    without the relay. An end confined to its host does not see it in its graph.
    """

    def __init__(self, domain_id: int) -> None:
        self._heard_s: dict[str, float] = {}
        self._joined: set[int] = set()
        self._socket: socket.socket | None = None
        try:
            self._socket = discovery_socket(domain_id)
            self._socket.settimeout(0.0)
        except OSError as error:
            log.warning("cannot listen for nodes that cross the link on their own: %s", error)

    def recent(self) -> Collection[str]:
        """Return the first 12 bytes of the GUIDs of those heard in the last minute, in hexadecimal digits."""
        if self._socket is None:
            return ()
        present = {index for index, _name in socket.if_nameindex()}
        for index in present ^ self._joined:  # a radio or a container that returns has a new number
            with suppress(OSError):  # down, or without an address
                join_discovery(self._socket, index, is_gone=index in self._joined)
                self._joined ^= {index}
        now_s = time.monotonic()
        with suppress(OSError):  # nothing more has come
            for _ in range(_MOST_PARTICIPANTS):
                if (participant := participant_in(self._socket.recv(64))) is not None:  # its header is enough
                    self._heard_s[participant.hex()] = now_s
        recent = {guid: heard_s for guid, heard_s in self._heard_s.items() if now_s - heard_s < _FORGET_S}
        self._heard_s = recent if len(recent) <= _MOST_PARTICIPANTS else {}
        return self._heard_s.keys()

    def close(self) -> None:
        """Listen no more."""
        if self._socket is not None:
            self._socket.close()
