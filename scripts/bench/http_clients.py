"""The clients of `http_load.py`: a scraper, and beside it those of one load, for some seconds.

Usage: python -m scripts.bench.http_clients URL LOAD SECONDS
"""

from __future__ import annotations

import asyncio
import json
import ssl
import sys
import time
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

from tornado.httpclient import AsyncHTTPClient, HTTPError

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable

    Client = Callable[[asyncio.StreamReader, asyncio.StreamWriter], Awaitable[None]]

SCRAPE_EVERY_S = 0.25
AGAIN_S = 0.5  # from the end of a connection to the client's next
_AS_PROMETHEUS_3 = {
    "Accept": "application/openmetrics-text;version=1.0.0;escaping=allow-utf-8;q=0.6,text/plain;version=0.0.4;q=0.3",
    "Accept-Encoding": "gzip",
}


async def ask(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    """Scrape, and take the answer."""
    writer.write(b"GET /metrics HTTP/1.1\r\nHost: robot\r\nAccept-Encoding: gzip\r\nConnection: close\r\n\r\n")
    await reader.read()


async def watch(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    """Take the events of the page."""
    writer.write(b"GET /api/v1/stream HTTP/1.1\r\nHost: robot\r\nAccept-Encoding: gzip\r\n\r\n")
    while await reader.read(65536):
        pass


async def wait(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:  # noqa: ARG001 - as clients are
    """Send nothing."""
    await reader.read()


async def dribble(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    """Send a request that never ends (slowloris)."""
    writer.write(b"GET / HTTP/1.1\r\nHost: ")
    while not reader.at_eof():
        writer.write(b"x")
        with suppress(TimeoutError):
            async with asyncio.timeout(1.0):  # wait_for of Python 3.11 may lose a cancellation
                await reader.read(1)


async def send_long_head(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    """Send a head of 1 MB."""
    writer.write(b"GET / HTTP/1.1\r\n" + b"Long: header\r\n" * 75_000)
    await reader.read()


async def send_large_body(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    """Send a body of 1 MB."""
    writer.write(b"POST / HTTP/1.1\r\nHost: robot\r\nContent-Length: 1000000\r\n\r\n" + bytes(1_000_000))
    await reader.read()


async def half_close(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    """Scrape, and close one half of the connection before the answer."""
    writer.write(b"GET /metrics HTTP/1.1\r\nHost: robot\r\n\r\n")
    writer.write_eof()
    await reader.read()


@dataclass(frozen=True, kw_only=True, slots=True)
class Load:
    """Clients of one kind.

    Parameters
    ----------
    name : of the load in the results
    client : what each does with a connection
    clients : their number
    has_tls : whether they need a server with a certificate
    """

    name: str
    client: Client = wait
    clients: int = 0
    has_tls: bool = False


LOADS = (
    Load(name="one scraper"),
    Load(name="four more scrapers", client=ask, clients=4),
    Load(name="four open pages", client=watch, clients=4),
    Load(name="1,000 idle connections", client=wait, clients=1000),
    Load(name="200 slow heads (slowloris)", client=dribble, clients=200),
    Load(name="20 heads of 1 MB", client=send_long_head, clients=20),
    Load(name="20 bodies of 1 MB", client=send_large_body, clients=20),
    Load(name="20 half-closed sockets", client=half_close, clients=20),
    Load(name="TLS, four more scrapers", client=ask, clients=4, has_tls=True),
    Load(name="TLS, a new certificate each second", client=ask, clients=4, has_tls=True),
)


async def connect_again_and_again(client: Client, *, host: str, port: int, tls: ssl.SSLContext | None) -> None:
    """Be a client that returns whenever its connection ends."""
    while True:
        with suppress(OSError):
            reader, writer = await asyncio.open_connection(host, port, ssl=tls)
            try:
                await client(reader, writer)
            finally:
                writer.close()
        await asyncio.sleep(AGAIN_S)


async def scrape(url: str, *, for_s: float) -> tuple[list[float], int]:
    """Scrape, each time by a new connection; return the seconds of each scrape, and how many failed."""
    prometheus = AsyncHTTPClient()
    end_s, spent, failed = time.monotonic() + for_s, [], 0
    while (began_s := time.monotonic()) < end_s:
        try:
            await prometheus.fetch(
                f"{url}/metrics", headers=_AS_PROMETHEUS_3, validate_cert=False, request_timeout=10.0
            )
            spent.append(time.monotonic() - began_s)
        except (OSError, HTTPError):
            failed += 1
        await asyncio.sleep(max(0.0, began_s + SCRAPE_EVERY_S - time.monotonic()))
    return spent, failed


async def play(url: str, load: Load, for_s: float) -> dict[str, object]:
    """Put a load on a server for some seconds."""
    address = urlsplit(url)
    tls = None
    if load.has_tls:
        tls = ssl.create_default_context()
        tls.check_hostname, tls.verify_mode = False, ssl.CERT_NONE
    host, port = address.hostname or "", address.port or 0
    beside = [
        asyncio.create_task(connect_again_and_again(load.client, host=host, port=port, tls=tls))
        for _ in range(load.clients)
    ]
    spent, failed = await scrape(url, for_s=for_s)
    for each in beside:
        each.cancel()
    await asyncio.wait(beside) if beside else None
    return {"scrape_s": spent, "failed": failed}


def main() -> None:
    url, name, for_s = sys.argv[1:]
    (load,) = (load for load in LOADS if load.name == name)
    print(json.dumps(asyncio.run(play(url, load, float(for_s)))))


if __name__ == "__main__":
    main()
