"""Records of calls that cross the link: requests, answers, failures and signals."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import Enum, StrEnum
from typing import TypeAlias

VERSION = 1
_MOST_BYTES = 64_000_000
_MOST_TEXT_BYTES = 1000
_MOST_MESSAGE = 250  # characters
_HEADER = struct.Struct(">BBQQ")  # version, kind, number, oldest
_LENGTH = struct.Struct(">I")


class FailureReason(StrEnum):
    """Reason why a call has no answer."""

    TIMEOUT = "timeout"
    UNREACHABLE = "unreachable"
    RESTARTED = "restarted"
    NO_SERVER = "no_server"
    TYPE = "type"


@dataclass(frozen=True, kw_only=True, slots=True)
class Request:
    """A request: its service, its type, ``example_interfaces/srv/AddTwoInts``, and the serialized message."""

    service: str
    type_name: str
    body: bytes


@dataclass(frozen=True, kw_only=True, slots=True)
class Answer:
    """The serialized response of a call."""

    body: bytes


@dataclass(frozen=True, kw_only=True, slots=True)
class CallFailure:
    """A call without an answer: the reason, and the same in words."""

    reason: FailureReason
    message: str


class Signal(Enum):
    """A record that only names a call.

    RUNNING: the callee has the request, and need not receive it again. ASK: repeats a request that the callee has.
    DONE: the caller needs nothing more of this call.
    """

    RUNNING = "running"
    ASK = "ask"
    DONE = "done"


Outcome: TypeAlias = Answer | CallFailure
_Kind: TypeAlias = type[Request] | type[Answer] | type[CallFailure] | Signal
_KINDS: dict[int, _Kind] = {1: Request, 2: Answer, 3: CallFailure, 4: Signal.RUNNING, 5: Signal.ASK, 6: Signal.DONE}
_CODES: dict[_Kind, int] = {kind: code for code, kind in _KINDS.items()}


@dataclass(frozen=True, kw_only=True, slots=True)
class Record:
    """Part of a call that crosses the link.

    Parameters
    ----------
    caller : session of the end that makes the call
    callee : session of the end that the call is meant for
    number : of the call, 1 for the caller's first
    oldest : number below which the caller needs nothing more; 0 in records of the callee
    content : request, outcome or signal
    """

    caller: str
    callee: str
    number: int
    oldest: int = 0
    content: Request | Outcome | Signal


def encode_record(record: Record) -> bytes:
    """Return the record as bytes.

    Raises
    ------
    ValueError
        If it is larger than an end accepts.
    """
    content = record.content
    parts = [_bytes(record.caller), _bytes(record.callee)]
    match content:
        case Request():
            parts += [_bytes(content.service), _bytes(content.type_name), content.body]
        case Answer():
            parts.append(content.body)
        case CallFailure():
            parts += [_bytes(content.reason), _bytes(content.message[:_MOST_MESSAGE])]
        case Signal():
            pass
    code = _CODES[content if isinstance(content, Signal) else type(content)]
    data = _HEADER.pack(VERSION, code, record.number, record.oldest)
    data += b"".join(piece for part in parts for piece in (_LENGTH.pack(len(part)), part))
    if len(data) > _MOST_BYTES:
        raise ValueError(f"{len(data)} bytes, more than {_MOST_BYTES}")
    return data


def decode_record(data: bytes) -> Record:
    """Return the record from its bytes.

    Raises
    ------
    ValueError
        If the bytes are no record, or one of another version.
    """
    if not _HEADER.size <= len(data) <= _MOST_BYTES:
        raise ValueError(f"a record of {len(data)} bytes; it has {_HEADER.size} to {_MOST_BYTES}")
    version, code, number, oldest = _HEADER.unpack_from(data)
    if version != VERSION:
        raise ValueError(f"a record of version {version}; this end speaks {VERSION}")
    if (kind := _KINDS.get(code)) is None:
        raise ValueError(f"a record of unknown kind {code}")
    caller, callee, *parts = _split(data)
    return Record(
        caller=_text(caller), callee=_text(callee), number=number, oldest=oldest, content=_content(kind, parts)
    )


def what_of(data: bytes) -> bytes:
    """Return what names the call and the kind of an encoded record: one that repeats another has the same."""
    return data[1:10]


def _split(data: bytes) -> list[bytes]:
    parts = []
    at = _HEADER.size
    while at < len(data):
        if at + _LENGTH.size > len(data):
            raise ValueError("a record that ends in the middle of a length")
        (length,) = _LENGTH.unpack_from(data, at)
        at += _LENGTH.size
        if at + length > len(data):
            raise ValueError(f"a record that ends {at + length - len(data)} bytes early")
        parts.append(data[at : at + length])
        at += length
        if len(parts) > 5:
            raise ValueError("a record of more than 5 parts")
    if len(parts) < 2:
        raise ValueError("a record without its sessions")
    return parts


def _content(kind: _Kind, parts: list[bytes]) -> Request | Outcome | Signal:
    match kind, parts:
        case Signal(), []:
            return kind
        case type(), [service, type_name, body] if kind is Request:
            return Request(service=_text(service), type_name=_text(type_name), body=body)
        case type(), [body] if kind is Answer:
            return Answer(body=body)
        case type(), [reason, message] if kind is CallFailure:
            return CallFailure(reason=FailureReason(_text(reason)), message=_text(message))
    raise ValueError(f"a record of {len(parts)} parts where its kind has another number")


def _text(part: bytes) -> str:
    if len(part) > _MOST_TEXT_BYTES:
        raise ValueError(f"a text of {len(part)} bytes, more than {_MOST_TEXT_BYTES}")
    return part.decode()


def _bytes(text: str) -> bytes:
    part = text.encode(errors="replace")
    if len(part) > _MOST_TEXT_BYTES:
        raise ValueError(f"a text of {len(part)} bytes, more than {_MOST_TEXT_BYTES}")
    return part
