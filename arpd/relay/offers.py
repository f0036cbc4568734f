"""State that each end of the relay tells the other: its offers, its wishes and its refusals."""

from __future__ import annotations

import re
from dataclasses import asdict, dataclass, field, fields
from typing import TYPE_CHECKING, Any

from arpd.ros.documents import MOST_INTEGER, integer, pack, unpack

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from dataclasses import Field

VERSION = 5
_SESSION = re.compile(r"[0-9a-f]{16}")
_MOST_BYTES = 4_000_000  # decoded; 200 topics take 60 kB


class OtherVersionError(ValueError):
    """A state of a version that this arpd does not know."""


@dataclass(frozen=True, kw_only=True, slots=True)
class WriterOffer:
    """One writer of an offered topic, as the graph shows it.

    Parameters
    ----------
    number : stands for it in the samples
    node : its node
    gid : its DDS GUID, in hexadecimal digits
    is_reliable, is_latched : its reliability and durability
    deadline_ns, lifespan_ns, lease_ns : its periods, 0 = infinite (ns)
    is_manual, is_alive : whether it asserts its liveliness by topic, and has done so within its lease
    """

    number: int
    node: str
    gid: str
    is_reliable: bool = True
    is_latched: bool = False
    deadline_ns: int = 0
    lifespan_ns: int = 0
    lease_ns: int = 0
    is_manual: bool = False
    is_alive: bool = False


@dataclass(frozen=True, kw_only=True, slots=True)
class TopicOffer:
    """A topic that the other side may read.

    Parameters
    ----------
    type_name : its type
    type_hash : of the definition that its writers have (REP 2016), as "RIHS01_..."; empty = they do not tell one
    writers : its writers
    link_name : name under which it crosses the link; all topics of a group have one
    member : its place in the group, 0 without one
    planned_depth, planned_deadline_ns : the daemon's plan for it, or for its group; no plan = 0 (samples, ns)
    """

    type_name: str
    writers: tuple[WriterOffer, ...]
    link_name: str
    member: int = 0
    type_hash: str = ""
    planned_depth: int = 0
    planned_deadline_ns: int = 0


@dataclass(frozen=True, kw_only=True, slots=True)
class ServiceOffer:
    """A service that the other side may call: its type, ``example_interfaces/srv/AddTwoInts``, and its node."""

    type_name: str
    node: str


@dataclass(frozen=True, kw_only=True, slots=True)
class EndState:
    """Everything one end tells the other; all names are those on the robot.

    Parameters
    ----------
    session : 16 hexadecimal digits, new with each process
    serial : counts the states of the session
    host : its host name
    arpd : its version of arpd
    topics, services : what it offers
    wants : topics of the other end that somebody reads here
    refused : topics of the other end that it does not carry, and the reason
    link_gids : first 12 bytes of the GUIDs of its endpoints on the link, in hexadecimal digits; empty = not told
    local_gids : the same of those in its local domain
    """

    session: str
    serial: int
    host: str = ""
    arpd: str = ""
    topics: Mapping[str, TopicOffer] = field(default_factory=dict)
    services: Mapping[str, ServiceOffer] = field(default_factory=dict)
    wants: frozenset[str] = frozenset()
    refused: Mapping[str, str] = field(default_factory=dict)
    link_gids: str = ""
    local_gids: str = ""


def encode_state(state: EndState) -> bytes:
    """Return the state as bytes."""
    return pack({"version": VERSION, **asdict(state), "wants": sorted(state.wants)})


def decode_state(data: bytes) -> EndState:
    """Return the state from its bytes.

    Raises
    ------
    OtherVersionError
        If the other end speaks another version.
    ValueError
        If the bytes are no state.
    """
    document = unpack(data, most_bytes=_MOST_BYTES)
    if (version := document.get("version")) != VERSION:
        words = f"it speaks version {version!r} (arpd {document.get('arpd', '?')}), this end version {VERSION}"
        raise OtherVersionError(f"{words}; install one arpd on both ends")
    try:
        state: EndState = _read(EndState, document)
    except (KeyError, TypeError, AttributeError) as fault:
        raise ValueError(f"no state of a relay ({fault})") from fault
    return state


def _read(kind: Any, document: Any) -> Any:
    """Return a record from its values by name."""
    return kind(**{each.name: _value(each, document[each.name]) for each in fields(kind)})


def _value(of: Field[Any], value: Any) -> Any:
    if of.name in _READERS:
        return _READERS[of.name](value)
    if of.type == "int":
        return integer(of.name, value, most=_MOST.get(of.name, MOST_INTEGER))
    return value is True if of.type == "bool" else str(value)


def _session(value: Any) -> str:
    if not isinstance(value, str) or not _SESSION.fullmatch(value):
        raise ValueError(f"{value!r} is no session")
    return value


_MOST = {"number": 2**16 - 1, "member": 2**16 - 1, "planned_depth": 5000}  # the first two have 16 bits in a sample
_READERS: Mapping[str, Callable[[Any], Any]] = {
    "session": _session,
    "topics": lambda topics: {str(name): _read(TopicOffer, topic) for name, topic in topics.items()},
    "writers": lambda writers: tuple(_read(WriterOffer, writer) for writer in writers),
    "services": lambda services: {str(name): _read(ServiceOffer, service) for name, service in services.items()},
    "wants": lambda wants: frozenset(map(str, wants)),
    "refused": lambda refused: {str(name): str(reason) for name, reason in refused.items()},
}
