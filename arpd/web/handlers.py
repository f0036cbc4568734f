"""Handles requests: bounds, credentials, answers, assets, and the stream of changes."""

from __future__ import annotations

import asyncio
import logging
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import aclosing, suppress
from http import HTTPStatus
from typing import TYPE_CHECKING, Any, cast

from tornado.iostream import StreamClosedError
from tornado.web import Application, Finish, GZipContentEncoding, HTTPError, RequestHandler, StaticFileHandler

from arpd.web.answers import ASSETS, Answer, bare, label
from arpd.web.connection_limit import Connection, connection_of
from arpd.web.passwords import MAX_WAITING, Passwords, PasswordVerdict
from arpd.web.stream import Feed
from arpd.web.tls import has_allowed_name

if TYPE_CHECKING:
    from collections.abc import Callable
    from types import TracebackType

    from tornado.httputil import HTTPHeaders

    from arpd.web.access import Access
    from arpd.web.answers import Answers
    from arpd.web.http_metrics import HttpCounts

log = logging.getLogger(__name__)

MAX_TARGET_BYTES = 2_048
MAX_STREAMS = 8
ANSWER_S = 10.0  # for a client to take an answer
_STREAM_TYPE = "text/event-stream"
_THREADS = 2
_HEADERS = {
    "Server": "arpd",
    "Cache-Control": "no-store",
    "X-Content-Type-Options": "nosniff",
    # Nothing from elsewhere, nothing inline, and no text that becomes markup.
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; img-src 'self' data:; "
        "base-uri 'none'; form-action 'none'; frame-ancestors 'none'; require-trusted-types-for 'script'"
    ),
    "Referrer-Policy": "no-referrer",
}
_OF_STATUS = {
    HTTPStatus.METHOD_NOT_ALLOWED: {"Allow": "GET, HEAD"},
    HTTPStatus.UNAUTHORIZED: {"WWW-Authenticate": 'Basic realm="arpd", charset="UTF-8"'},
    HTTPStatus.TOO_MANY_REQUESTS: {"Retry-After": "1"},
    HTTPStatus.SERVICE_UNAVAILABLE: {"Retry-After": "1"},
}
_OF_VERDICT = {
    PasswordVerdict.MISSING: HTTPStatus.UNAUTHORIZED,
    PasswordVerdict.WRONG: HTTPStatus.UNAUTHORIZED,
    PasswordVerdict.THROTTLED: HTTPStatus.TOO_MANY_REQUESTS,
    PasswordVerdict.BUSY: HTTPStatus.SERVICE_UNAVAILABLE,
}


class _Gzip(GZipContentEncoding):
    GZIP_LEVEL = 1  # already a tenth of the size; higher levels cost the robot more time than they save the link
    CONTENT_TYPES = GZipContentEncoding.CONTENT_TYPES | {"application/openmetrics-text", "application/schema+json"}

    def transform_first_chunk(self, status_code: int, headers: HTTPHeaders, chunk: bytes, finishing: bool) -> Any:  # noqa: FBT001 - Tornado's signature
        if headers.get("Content-Type") == _STREAM_TYPE:
            self.GZIP_LEVEL = 6  # events are small, come for hours, and resemble each other
        return super().transform_first_chunk(status_code, headers, chunk, finishing)


class Site(Application):
    """The paths of the daemon.

    Parameters
    ----------
    answers : answers the paths
    access : protection of connections
    passwords : judges credentials
    counts : counts answers
    """

    def __init__(self, *, answers: Answers, access: Access, passwords: Passwords, counts: HttpCounts) -> None:
        self.answers = answers
        self.access = access
        self.passwords = passwords
        self.counts = counts
        self.work = ThreadPoolExecutor(_THREADS, thread_name_prefix="arpd-http-answer")
        # One more than may wait for bcrypt, so that the next is refused at once.
        self.bcrypt = ThreadPoolExecutor(MAX_WAITING + 1, thread_name_prefix="arpd-http-password")
        self.feed = Feed(answers.status, pool=self.work)
        super().__init__(
            [
                (rf"{answers.assets}([\w./-]*)", AssetHandler, {"path": ASSETS}),
                (r"/api/v1/stream", StreamHandler),
                (r".*", AnswerHandler),
            ],
            transforms=[_Gzip],
            log_function=self._count,
        )

    def _count(self, handler: RequestHandler) -> None:
        self.counts.count_request(label(handler.request.path), handler.get_status())

    def close(self) -> None:
        """Start no further work."""
        for pool in (self.work, self.bcrypt):
            pool.shutdown(wait=False, cancel_futures=True)


class _Guarded(RequestHandler):
    """Checks bounds and credentials before each answer, and sets the headers of all answers."""

    @property
    def site(self) -> Site:
        return cast("Site", self.application)

    @property
    def client_connection(self) -> Connection:
        return connection_of(self.request.connection)

    def set_default_headers(self) -> None:
        for name, value in (_HEADERS | dict(self.site.access.current().headers)).items():
            self.set_header(name, value)

    async def prepare(self) -> None:
        """Refuse a request that is too large, has a body, or lacks the right credentials."""
        request, connection = self.request, self.client_connection
        connection.is_answered = False
        protection = self.site.access.current()
        if protection is not connection.protection:
            connection.stream.close()  # the client connects again, now under the new rules
            self.set_status(HTTPStatus.SERVICE_UNAVAILABLE)
            raise Finish
        if len(request.uri or "") > MAX_TARGET_BYTES:
            raise HTTPError(HTTPStatus.REQUEST_URI_TOO_LONG)
        if request.body:
            raise HTTPError(HTTPStatus.REQUEST_ENTITY_TOO_LARGE)
        if request.method not in ("GET", "HEAD"):
            raise HTTPError(HTTPStatus.METHOD_NOT_ALLOWED)
        if protection.allowed_sans and not has_allowed_name(
            cast("dict[str, Any]", request.get_ssl_certificate()), protection.allowed_sans
        ):
            raise HTTPError(HTTPStatus.FORBIDDEN)
        if protection.users:
            given = request.headers.get("Authorization", "").encode("latin-1", "replace")
            with connection.working():
                verdict = await self._run(
                    self.site.bcrypt, self.site.passwords.judge, protection.users, given, connection.client
                )
            self.site.counts.count_authentication(verdict)
            if verdict in _OF_VERDICT:
                raise HTTPError(_OF_VERDICT[verdict])

    async def _run(self, pool: ThreadPoolExecutor, work: Callable[..., Any], *arguments: Any) -> Any:
        return await asyncio.get_running_loop().run_in_executor(pool, work, *arguments)

    def write_error(self, status_code: int, **_: Any) -> None:
        """Answer with the code and its phrase, and nothing of the request."""
        self.give(bare(HTTPStatus(status_code)))
        self.finish()

    def give(self, answer: Answer) -> None:
        """Set status, headers and body."""
        self.set_status(answer.status)
        headers = {"Content-Type": answer.content_type, **answer.headers, **_OF_STATUS.get(answer.status, {})}
        for name, value in headers.items():
            self.set_header(name, value)
        self.write(answer.body)

    def compute_etag(self) -> str | None:
        """Name a version of what a client may keep, and of nothing else."""
        return None if self._headers.get("Cache-Control") == "no-store" else super().compute_etag()

    def on_finish(self) -> None:
        """Note that the connection is free for its next request."""
        self.client_connection.is_answered = True

    def log_exception(
        self, typ: type[BaseException] | None, value: BaseException | None, tb: TracebackType | None
    ) -> None:
        """Log what is a fault of ours."""
        if not isinstance(value, (HTTPError, StreamClosedError)) and typ and value:
            log.error(
                "a request from %s could not be answered", self.client_connection.client, exc_info=(typ, value, tb)
            )

    async def take(self, sent: asyncio.Future[None]) -> None:
        """Wait until the client has taken what was sent; close the connection of one that does not."""
        try:
            async with asyncio.timeout(ANSWER_S):
                await sent
        except TimeoutError:
            self.client_connection.is_answered = False
            self.client_connection.stream.close()
            raise StreamClosedError from None
        except StreamClosedError:
            self.client_connection.is_answered = False
            raise


class AnswerHandler(_Guarded):
    """Every path that `Answers` knows, and 404 for others."""

    async def get(self) -> None:
        """Make the answer in a thread, and wait until the client has it."""
        with self.client_connection.working():
            self.give(await self._run(self.site.work, self._answer, time.monotonic()))
        with suppress(StreamClosedError):
            await self.take(self.finish())

    head = get

    def _answer(self, asked_s: float) -> Answer:
        if self.client_connection.stream.closed():
            return bare(HTTPStatus.SERVICE_UNAVAILABLE)  # nobody waits for it, others do
        accept = self.request.headers.get("Accept", "")
        return self.site.answers.answer(self.request.path, accept, asked_s=asked_s)


class AssetHandler(_Guarded, StaticFileHandler):
    """Scripts and styles, under a path that changes with their content."""

    async def prepare(self) -> None:
        """Leave out ranges: they would be those of the compressed file."""
        await super().prepare()
        self.request.headers.pop("Range", None)

    def set_extra_headers(self, path: str) -> None:  # noqa: ARG002 - Tornado's signature
        """Let browsers keep the file for good."""
        self.set_header("Cache-Control", "private, max-age=31536000, immutable")


class StreamHandler(_Guarded):
    """The status document as server-sent events: once whole, then its changes."""

    async def get(self) -> None:
        """Send events until the client leaves or the protection changes."""
        site, connection = self.site, self.client_connection
        if site.feed.listeners >= MAX_STREAMS:
            raise HTTPError(HTTPStatus.SERVICE_UNAVAILABLE)
        if site.answers.snapshot() is None:
            self.give(site.answers.answer("/api/v1/status", ""))
            return
        self.set_header("Content-Type", _STREAM_TYPE)
        self.set_header("X-Accel-Buffering", "no")  # nginx would collect the events
        if self.request.method == "HEAD":
            return
        with suppress(StreamClosedError):
            async with aclosing(site.feed.events(connection.stream.closed)) as events:
                async for event in events:
                    self.write(event)
                    await self.take(self.flush())
                    connection.is_answered = True
                    if site.access.current() is not connection.protection:
                        return

    head = get

    def on_connection_close(self) -> None:
        """Give the place to the next listener."""
        super().on_connection_close()
        self._leaving = asyncio.ensure_future(self.site.feed.look_around())
