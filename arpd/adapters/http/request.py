"""Reads the head of one HTTP request within bounds; knows no sockets."""

from __future__ import annotations

from dataclasses import dataclass, field
from http import HTTPStatus
from typing import TYPE_CHECKING

import h11

if TYPE_CHECKING:
    from collections.abc import Callable

MAX_HEAD_BYTES = 16_384
MAX_TARGET_BYTES = 2_048
MAX_HEADERS = 64
METHODS = (b"GET", b"HEAD")
_CHUNK_BYTES = 4_096


class RequestRefusedError(Exception):
    """The bytes are no request that arpd answers; ``status`` is the answer."""

    def __init__(self, status: HTTPStatus) -> None:
        super().__init__(status.phrase)
        self.status = status


@dataclass(frozen=True, kw_only=True, slots=True)
class Request:
    """The parts of a request that arpd uses.

    Parameters
    ----------
    path : target without its query
    wants_body : False for HEAD
    accept, authorization : headers, empty if absent
    takes_gzip : True if the client accepts gzip
    """

    path: str
    wants_body: bool
    accept: str = ""
    takes_gzip: bool = False
    authorization: bytes = field(default=b"", repr=False)


def read_request(receive: Callable[[int], bytes]) -> Request:
    """Read one request head of at most `MAX_HEAD_BYTES`; a target of the fuzzer.

    Parameters
    ----------
    receive : returns at most that many bytes, none at the end of the stream

    Raises
    ------
    RequestRefusedError
        If the request is malformed or too large, has a body, or uses another method than GET and HEAD.
    ConnectionError
        If the client leaves before the head is complete.
    """
    parser = h11.Connection(h11.SERVER, max_incomplete_event_size=MAX_HEAD_BYTES)
    while True:
        try:
            event = parser.next_event()
        except h11.RemoteProtocolError as error:
            raise RequestRefusedError(HTTPStatus(error.error_status_hint)) from None
        if isinstance(event, h11.Request):
            return _understood(event)
        data = receive(_CHUNK_BYTES)
        if not data:
            raise ConnectionError("the client left before its request was complete")
        parser.receive_data(data)


def _understood(event: h11.Request) -> Request:
    if event.http_version not in (b"1.0", b"1.1"):
        raise RequestRefusedError(HTTPStatus.HTTP_VERSION_NOT_SUPPORTED)
    if len(event.target) > MAX_TARGET_BYTES:
        raise RequestRefusedError(HTTPStatus.REQUEST_URI_TOO_LONG)
    if len(event.headers) > MAX_HEADERS:
        raise RequestRefusedError(HTTPStatus.REQUEST_HEADER_FIELDS_TOO_LARGE)
    if event.method not in METHODS:
        raise RequestRefusedError(HTTPStatus.METHOD_NOT_ALLOWED)
    headers: dict[bytes, bytes] = {}
    for name, value in event.headers:
        headers.setdefault(name, value)
    if headers.get(b"content-length", b"0").strip(b"0") or b"transfer-encoding" in headers:
        raise RequestRefusedError(HTTPStatus.REQUEST_ENTITY_TOO_LARGE)
    return Request(
        path=event.target.decode("ascii").partition("?")[0],
        wants_body=event.method != b"HEAD",
        accept=headers.get(b"accept", b"").decode("latin-1"),
        takes_gzip=_takes_gzip(headers.get(b"accept-encoding", b"").decode("latin-1")),
        authorization=headers.get(b"authorization", b""),
    )


def _takes_gzip(accept_encoding: str) -> bool:
    """Return whether the header names gzip with a quality above 0; ``*`` does not count."""
    for item in accept_encoding.lower().split(","):
        coding, _, parameters = item.partition(";")
        if coding.strip() == "gzip":
            quality = parameters.strip().removeprefix("q=")
            return not quality or quality.strip("0.") != ""
    return False
