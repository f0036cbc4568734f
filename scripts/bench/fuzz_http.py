"""The fuzz target for connections to the HTTP server."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from scripts.bench.fuzz_target import BrokenPromiseError, Fuzzable, insist


def http() -> Fuzzable:
    """Feed one connection's bytes: every answer is one of arpd's own, and repeats nothing of the input."""
    import logging
    import socket

    from prometheus_client import CollectorRegistry

    from arpd.adapters.http.answers import Answers
    from arpd.adapters.http.connection_limit import ConnectionLimit
    from arpd.adapters.http.exchange import Exchange
    from arpd.adapters.http.exposition import Exposition
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
    limit = ConnectionLimit()

    def feed(data: bytes) -> None:
        nonlocal now_s
        now_s += 1.0  # one password a second is checked, not throttled
        access = SimpleNamespace(current=lambda: protections[data[:1] == b"\x01"])
        exchange: Any = Exchange(answers=answers, access=access, passwords=passwords, counts=counts, clock=clock)  # type: ignore[arg-type]
        near, far = socket.socketpair()
        with near, far:
            near.sendall(data[1:])
            near.shutdown(socket.SHUT_WR)
            connection, _ = limit.enter(far, "192.0.2.1")
            exchange.run(connection)
            if connection is not None:
                limit.leave(connection)
            answer = b"".join(iter(lambda: near.recv(65536), b""))
        if failures:
            record = failures.pop()
            failures.clear()
            raise BrokenPromiseError(record.getMessage()) from (record.exc_info or (None, None))[1]
        if answer:
            head, _, body = answer.partition(b"\r\n\r\n")
            insist(head.startswith(b"HTTP/1.1 ") and head.count(b"Content-Length: ") == 1, f"a head: {head!r}")
            insist(len(body) < 4096 and b"Traceback" not in body and b"/arpd/" not in body, f"a plain body: {body!r}")

    heads = (
        b"GET /metrics HTTP/1.1\r\nHost: robot\r\nAccept: application/openmetrics-text;version=1.0.0;q=0.5\r\n\r\n",
        b"HEAD / HTTP/1.0\r\n\r\n",
        b"GET /api/v1/status?x=1 HTTP/1.1\r\nHost: a\r\nAuthorization: Basic b3BzOnJpZ2h0\r\n\r\n",
        b"POST /-/reload HTTP/1.1\r\nHost: a\r\nContent-Length: 3\r\n\r\nabc",
    )
    words = (
        *("GET ", "HEAD ", " HTTP/1.1", "\r\n", "Transfer-Encoding: chunked", "Expect: 100-continue"),
        "Content-Length: ",
        *("/-/healthy", "/-/ready", "Authorization: Basic b3BzOnJpZ2h0", "Upgrade: h2c", "%00"),
    )
    return Fuzzable(feed=feed, seeds=tuple(mode + head for mode in (b"\x00", b"\x01") for head in heads), words=words)
