"""State that each end of the relay tells the other: its offers, its wishes and its refusals."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, TypeAlias, TypeVar

from pydantic import AfterValidator, FailFast, Field, TypeAdapter, ValidationError

from arpd.relay.envelope import WRAP
from arpd.ros.documents import MOST_INTEGER, pack, unpack
from arpd.ros.names import checked_full_name

VERSION = 10
_STRANGE = "its message is not understood"
_MOST_BYTES = 4_000_000  # decoded; 200 topics take 60 kB
T = TypeVar("T")
WriterClass: TypeAlias = tuple[bool, bool, int]  # of writers that one reader hears


_Period = Annotated[int, Field(ge=0, le=MOST_INTEGER)]
# Each fault in a message is written down, so it may not have too many.
_ByName = Annotated[Mapping[str, T], Field(max_length=20_000)]


@dataclass(frozen=True, kw_only=True, slots=True)
class WriterOffer:
    """One writer of an offered topic, as the graph shows it.

    Parameters
    ----------
    node : its node
    gid : its DDS GUID, in hexadecimal digits
    is_reliable, is_latched : its reliability and durability
    deadline_ns, lifespan_ns, lease_ns : its periods, 0 = infinite (ns)
    is_manual, is_alive : whether it asserts its liveliness by topic, and has done so within its lease
    """

    node: str
    gid: str
    is_reliable: bool = True
    is_latched: bool = False
    deadline_ns: _Period = 0
    lifespan_ns: _Period = 0
    lease_ns: _Period = 0
    is_manual: bool = False
    is_alive: bool = False

    @property
    def kind(self) -> WriterClass:
        """Its reliability and durability, and its lease if it asserts its liveliness by topic, else 0 (ns)."""
        return self.is_reliable, self.is_latched, self.lease_ns if self.is_manual else 0


@dataclass(frozen=True, kw_only=True, slots=True)
class TopicOffer:
    """A topic that the other side may read.

    Parameters
    ----------
    type_name : its type
    type_hash : of the definition that its writers have (REP 2016), as "RIHS01_..."; empty = they do not tell one
    writers : its writers
    link_name : name under which it crosses the link; all topics of a group have one
    planned_depth, planned_deadline_ns : the daemon's plan for it, or for its group; no plan = 0 (samples, ns)
    """

    type_name: str
    writers: Annotated[tuple[WriterOffer, ...], FailFast()]
    link_name: Annotated[str, AfterValidator(checked_full_name)]
    type_hash: str = ""
    planned_depth: Annotated[int, Field(ge=0, le=5000)] = 0
    planned_deadline_ns: _Period = 0


@dataclass(frozen=True, kw_only=True, slots=True)
class ServiceOffer:
    """A service that the other side may call.

    Parameters
    ----------
    type_name, node : its type, ``example_interfaces/srv/AddTwoInts``, and its node
    type_hashes : as that of a topic, of its request and its response
    """

    type_name: str
    node: str
    type_hashes: tuple[str, str] = ("", "")


@dataclass(frozen=True, kw_only=True, slots=True)
class EndState:
    """Everything one end tells the other; all names are those on the robot.

    Parameters
    ----------
    session : of its process, new with each
    host : its host name
    arpd : its version of arpd
    topics, services : what it offers
    wants : topics of the other end that somebody reads here
    refused : topics of the other end that it does not carry, and the reason
    namespace : `relay.namespace` of its configuration, which tells one robot from another
    follows : ``link_gids`` of the other end that it follows, empty = none
    link_gids : first 12 bytes of the GUIDs of its endpoints on the link, in hexadecimal digits; empty = not told
    local_gids : the same of those in its local domain
    """

    session: Annotated[int, Field(gt=0, lt=WRAP)]
    host: str = ""
    arpd: str = ""
    topics: _ByName[TopicOffer] = field(default_factory=dict)
    services: _ByName[ServiceOffer] = field(default_factory=dict)
    wants: Annotated[frozenset[str], FailFast()] = frozenset()
    refused: _ByName[str] = field(default_factory=dict)
    namespace: str = ""
    follows: str = ""
    link_gids: str = ""
    local_gids: str = ""


_STATE = TypeAdapter(EndState)


def encode_state(state: EndState) -> bytes:
    """Return the state as bytes."""
    return pack({"version": VERSION, **_STATE.dump_python(state, mode="json")})


def decode_state(data: bytes, *, namespace: str = "") -> EndState:
    """Return the state from its bytes, for an end with this `relay.namespace`.

    Raises ValueError if the other end speaks another version or has another namespace, or the bytes are no state.
    """
    try:
        document = unpack(data, most_bytes=_MOST_BYTES)
    except ValueError as fault:
        raise ValueError(f"{_STRANGE} ({fault})") from fault
    if (version := document.get("version")) != VERSION:
        words = f"it speaks version {version!r} (arpd {document.get('arpd', '?')}), this end version {VERSION}"
        raise ValueError(f"{words}; install one arpd on both ends")
    try:
        state = _STATE.validate_python(document)
    except ValidationError as faults:
        first = faults.errors(include_url=False)[0]
        raise ValueError(f"{_STRANGE} ({'.'.join(map(str, first['loc']))}: {first['msg']})") from faults
    if state.namespace != namespace:
        words = f"its configuration has relay.namespace {state.namespace!r}, and this end {namespace!r}"
        raise ValueError(f"{words}; give each robot a relay.link_domain of its own, and both its ends one file")
    return state
