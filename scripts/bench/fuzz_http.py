"""The fuzz target for connections to the HTTP server."""

from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

from scripts.bench.fuzz_target import BrokenPromiseError, Fuzzable, insist

if TYPE_CHECKING:
    from collections.abc import Callable

    from tornado.iostream import IOStream

_TURNS = 10  # of the event loop: more than Tornado takes from bytes to the request in them


async def _exchanged(data: bytes, serve: Callable[[IOStream], bool]) -> bytes:
    """Return all that comes back for some bytes and, once they are answered, their end."""
    import asyncio
    import socket

    from tornado.iostream import IOStream

    loop = asyncio.get_running_loop()
    near, far = socket.socketpair()

    async def read() -> bytes:
        parts = []
        while part := await loop.sock_recv(near, 65536):
            parts.append(part)
        return b"".join(parts)

    with near:
        near.settimeout(0.0)
        await loop.sock_sendall(near, data)
        reader = asyncio.create_task(read())
        serve(IOStream(far))
        idle = asyncio.all_tasks()  # this one, the reader, and Tornado's for the connection
        # At the end of the bytes Tornado closes, also while an answer is in work.
        turns = 0
        while turns < _TURNS:
            await asyncio.sleep(0)
            turns += 1
            if working := asyncio.all_tasks() - idle:
                await asyncio.wait(working)
                turns = 0
        near.shutdown(socket.SHUT_WR)
        answer = await reader
    while rest := asyncio.all_tasks() - {asyncio.current_task()}:
        await asyncio.wait(rest)
    return answer


def http() -> Fuzzable:
    """Feed one connection's bytes: every answer is one of arpd's own, and repeats nothing of the input."""
    import asyncio
    import logging

    from prometheus_client import CollectorRegistry

    from arpd.adapters.http.answers import Answers
    from arpd.adapters.http.connection_limit import ConnectionLimit
    from arpd.adapters.http.exposition import Exposition
    from arpd.adapters.http.handlers import Site
    from arpd.adapters.http.http_metrics import HttpCounts
    from arpd.adapters.http.passwords import Passwords
    from arpd.adapters.http.web_config import Protection

    failures: list[logging.LogRecord] = []

    class Failures(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            failures.append(record)

    logging.getLogger("arpd.adapters.http").addHandler(Failures(logging.ERROR))  # gets exceptions of connections
    protections = (Protection(), Protection(users={b"ops": b"$2b$04$"}))
    now_s = 0.0

    def clock() -> float:
        return now_s

    counts = HttpCounts()
    passwords = Passwords(clock=clock, secret=b"fuzz", check=lambda password, _hash: password == b"right")
    answers = Answers(
        snapshot=lambda: None,
        is_ready=lambda: False,
        exposition=Exposition(CollectorRegistry()),
        clock=clock,
        started_at_s=0.0,
    )
    protection = protections[0]
    access: Any = SimpleNamespace(current=lambda: protection)
    site = Site(answers=answers, access=access, passwords=passwords, counts=counts)
    limit = ConnectionLimit(site, counts=counts, clock=clock)
    loop = asyncio.new_event_loop()

    def feed(data: bytes) -> None:
        nonlocal now_s, protection
        now_s += 1.0  # one password a second is checked, not throttled
        protection = protections[data[:1] == b"\x01"]
        answer = loop.run_until_complete(
            _exchanged(data[1:], lambda stream: limit.serve(stream, "192.0.2.1", protection))
        )
        if failures:
            record = failures.pop()
            failures.clear()
            raise BrokenPromiseError(record.getMessage()) from (record.exc_info or (None, None))[1]
        if answer:
            head, _, body = answer.partition(b"\r\n\r\n")
            insist(head.startswith(b"HTTP/1.1 "), f"a head: {head!r}")
            insist(b"Traceback" not in body and b"/arpd/" not in body, f"a plain body: {body!r}")
            insist(b"__future__" not in body, f"no file beside the assets: {body!r}")

    heads = (
        b"GET /metrics HTTP/1.1\r\nHost: robot\r\nAccept: application/openmetrics-text;version=1.0.0;q=0.5\r\n\r\n",
        b"HEAD / HTTP/1.0\r\n\r\n",
        b"GET /api/v1/status?x=1 HTTP/1.1\r\nHost: a\r\nAuthorization: Basic b3BzOnJpZ2h0\r\n\r\n",
        b"POST /-/reload HTTP/1.1\r\nHost: a\r\nContent-Length: 3\r\n\r\nabc",
        f"GET {answers.assets}page.js HTTP/1.1\r\nHost: a\r\nRange: bytes=0-9\r\nIf-None-Match: a\r\n\r\n".encode(),
        b"GET /-/ready HTTP/1.1\r\nHost: a\r\n\r\nGET /api/v1/stream HTTP/1.1\r\nHost: a\r\n\r\n",
    )
    words = (
        *("GET ", "HEAD ", " HTTP/1.1", "\r\n", "Transfer-Encoding: chunked", "Expect: 100-continue"),
        "Content-Length: ",
        *("/-/healthy", "/-/ready", "Authorization: Basic b3BzOnJpZ2h0", "Upgrade: h2c", "%00", "%2e%2e/", "../"),
        *(answers.assets, "Range: bytes=", "If-Modified-Since: ", "Accept-Encoding: gzip"),
    )
    return Fuzzable(feed=feed, seeds=tuple(mode + head for mode in (b"\x00", b"\x01") for head in heads), words=words)
