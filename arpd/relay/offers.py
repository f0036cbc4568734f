"""State that each end of the relay tells the other: its offers, its wishes and its refusals."""

from __future__ import annotations

import json
import re
import zlib
from dataclasses import asdict, dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Mapping

VERSION = 4
_MOST_NUMBER = 2**16 - 1  # of a writer and of a place in a group: their fields in a sample have 16 bits
_MOST_NS = 2**63 - 1
_MOST_DEPTH = 5000
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
    number : counts the states of the session
    host : its host name
    arpd : its version of arpd
    topics, services : what it offers
    wants : topics of the other end that somebody reads here
    refused : topics of the other end that it does not carry, and the reason
    link_gids : first 12 bytes of the GUIDs of its endpoints on the link, in hexadecimal digits; empty = not told
    local_gids : the same of those in its local domain
    """

    session: str
    number: int
    host: str = ""
    arpd: str = ""
    topics: Mapping[str, TopicOffer] = field(default_factory=lambda: MappingProxyType({}))
    services: Mapping[str, ServiceOffer] = field(default_factory=lambda: MappingProxyType({}))
    wants: frozenset[str] = frozenset()
    refused: Mapping[str, str] = field(default_factory=lambda: MappingProxyType({}))
    link_gids: str = ""
    local_gids: str = ""


def encode_state(state: EndState) -> bytes:
    """Return the state as compressed JSON."""
    document = {
        "version": VERSION,
        "session": state.session,
        "number": state.number,
        "host": state.host,
        "arpd": state.arpd,
        "topics": {name: asdict(topic) for name, topic in state.topics.items()},
        "services": {name: asdict(service) for name, service in state.services.items()},
        "wants": sorted(state.wants),
        "refused": dict(state.refused),
        "link_gids": state.link_gids,
        "local_gids": state.local_gids,
    }
    return zlib.compress(json.dumps(document, separators=(",", ":")).encode())


def decode_state(data: bytes) -> EndState:
    """Return the state from its bytes.

    Raises
    ------
    OtherVersionError
        If the other end speaks another version.
    ValueError
        If the bytes are no state.
    """
    try:
        expand = zlib.decompressobj()
        text = expand.decompress(data, _MOST_BYTES)
        if expand.unconsumed_tail:
            raise ValueError(f"a state of more than {_MOST_BYTES} bytes")
        document = json.loads(text)
        if (version := document["version"]) != VERSION:
            words = f"it speaks version {version!r} (arpd {document.get('arpd', '?')}), this end version {VERSION}"
            raise OtherVersionError(f"{words}; install one arpd on both ends")
        return EndState(
            session=_session(document["session"]),
            number=_whole(document["number"], most=_MOST_NS),
            host=str(document["host"]),
            arpd=str(document["arpd"]),
            topics={str(name): _topic(topic) for name, topic in document["topics"].items()},
            services={
                str(name): ServiceOffer(type_name=str(service["type_name"]), node=str(service["node"]))
                for name, service in document["services"].items()
            },
            wants=frozenset(map(str, document["wants"])),
            refused={str(name): str(reason) for name, reason in document["refused"].items()},
            link_gids=str(document.get("link_gids", "")),
            local_gids=str(document.get("local_gids", "")),
        )
    except RecursionError as fault:
        raise ValueError("no state of a relay (it is nested)") from fault
    except (zlib.error, KeyError, TypeError, AttributeError, UnicodeDecodeError, json.JSONDecodeError) as fault:
        raise ValueError(f"no state of a relay ({fault})") from fault


def _session(value: Any) -> str:
    if not isinstance(value, str) or not _SESSION.fullmatch(value):
        raise ValueError(f"{value!r} is no session")
    return value


def _topic(document: Any) -> TopicOffer:
    return TopicOffer(
        type_name=str(document["type_name"]),
        writers=tuple(map(_writer, document["writers"])),
        link_name=str(document["link_name"]),
        member=_whole(document["member"], most=_MOST_NUMBER),
        type_hash=str(document["type_hash"]),
        planned_depth=_whole(document["planned_depth"], most=_MOST_DEPTH),
        planned_deadline_ns=_whole(document["planned_deadline_ns"], most=_MOST_NS),
    )


def _writer(document: Any) -> WriterOffer:
    return WriterOffer(
        number=_whole(document["number"], most=_MOST_NUMBER),
        node=str(document["node"]),
        gid=str(document["gid"]),
        is_reliable=document["is_reliable"] is True,
        is_latched=document["is_latched"] is True,
        deadline_ns=_whole(document["deadline_ns"], most=_MOST_NS),
        lifespan_ns=_whole(document["lifespan_ns"], most=_MOST_NS),
        lease_ns=_whole(document["lease_ns"], most=_MOST_NS),
        is_manual=document["is_manual"] is True,
        is_alive=document["is_alive"] is True,
    )


def _whole(value: Any, *, most: int) -> int:
    if type(value) is not int or not 0 <= value <= most:
        raise ValueError(f"{value!r} is not in 0..{most}")
    return value
