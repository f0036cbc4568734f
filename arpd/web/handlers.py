"""Handles requests: who may ask, and the answer for each path."""

from __future__ import annotations

import asyncio
from concurrent.futures import ThreadPoolExecutor
from http import HTTPStatus
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from tornado.web import Application, HTTPError, RequestHandler, StaticFileHandler

from arpd.web.access import client_of, is_own_name
from arpd.web.api import History, Status
from arpd.web.json_text import schema_of
from arpd.web.passwords import MAX_WAITING, Passwords, PasswordVerdict
from arpd.web.web_config import has_allowed_name

if TYPE_CHECKING:
    from collections.abc import Callable

    from arpd.report.snapshot import Snapshot
    from arpd.web.access import Access, HttpCounts
    from arpd.web.documents import Documents

HEALTHY_S = 10.0  # a daemon without a tick for longer hangs; the watchdog of systemd has the same limit
ASSETS = Path(__file__).parent / "assets"
_HEADERS = {
    "Server": "arpd",
    "Cache-Control": "no-cache",  # a client may keep it, and asks each time whether it changed
    "Content-Type": "text/plain; charset=utf-8",
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


class Site(Application):
    """The paths of the daemon.

    Parameters
    ----------
    documents : metrics, status and history
    access : who may ask
    passwords : judges credentials
    counts : counts answers
    snapshot, clock : see `Documents`
    host : ``http.host``
    """

    def __init__(
        self,
        *,
        documents: Documents,
        access: Access,
        passwords: Passwords,
        counts: HttpCounts,
        snapshot: Callable[[], Snapshot | None],
        clock: Callable[[], float],
        host: str,
    ) -> None:
        self.documents = documents
        self.access = access
        self.passwords = passwords
        self.counts = counts
        self.host = host
        # One more than may wait for bcrypt, so that the next is refused at once.
        self.threads = ThreadPoolExecutor(MAX_WAITING + 1, thread_name_prefix="arpd-http-password")
        self.snapshot, self.clock, self.started_at_s = snapshot, clock, clock()
        super().__init__(
            [
                (r"/()", _Asset, {"path": ASSETS, "default_filename": "page.html"}),
                (r"/assets/([\w./-]+)", _Asset, {"path": ASSETS}),
                (r"/(metrics)", _Document),
                (r"/api/v1/(status|history)", _Document),
                (r"/api/v1/schema/(status|history)-v1\.json", _Schema),
                (r"/-/(healthy|ready)", _Health),
            ],
            default_handler_class=_Nothing,
            compress_response=True,
            log_function=self._count,
        )

    def _count(self, handler: RequestHandler) -> None:
        path = handler.request.path
        label = "/assets/" if path.startswith("/assets/") else "other" if isinstance(handler, _Nothing) else path
        self.counts.requests.labels(label, handler.get_status()).inc()

    def close(self) -> None:
        """Start no further work."""
        self.documents.close()
        self.threads.shutdown(wait=False, cancel_futures=True)


class _Guarded(RequestHandler):
    """Lets in who may ask, and sets the headers of all answers."""

    SUPPORTED_METHODS = ("GET", "HEAD")

    @property
    def site(self) -> Site:
        return cast("Site", self.application)

    def set_default_headers(self) -> None:
        for name, value in _HEADERS.items():
            self.set_header(name, value)

    async def prepare(self) -> None:
        """Refuse a client that lacks the right certificate, name or password."""
        protection, request = self.site.access.protection, self.request
        if protection.allowed_sans:
            certificate = cast("dict[str, Any]", request.get_ssl_certificate())
            if not has_allowed_name(certificate, protection.allowed_sans):
                raise HTTPError(HTTPStatus.FORBIDDEN)
        if protection.users:
            given = request.headers.get("Authorization", "").encode("latin-1", "replace")
            client = client_of(str(request.remote_ip))
            verdict = await self._in_thread(self.site.passwords.judge, protection.users, given, client)
            self.site.counts.authentications.labels(verdict).inc()
            if verdict in _OF_VERDICT:
                raise HTTPError(_OF_VERDICT[verdict])
        elif protection.tls is None and not await self._in_thread(is_own_name, request.host, self.site.host):
            raise HTTPError(HTTPStatus.MISDIRECTED_REQUEST)

    async def _in_thread(self, work: Callable[..., Any], *arguments: Any) -> Any:
        return await asyncio.get_running_loop().run_in_executor(self.site.threads, work, *arguments)

    def write_error(self, status_code: int, **_: Any) -> None:
        """Answer with the code and its phrase, and nothing of the request."""
        status = HTTPStatus(status_code)
        for name, value in _OF_STATUS.get(status, {}).items():
            self.set_header(name, value)
        hint = "ask by an address of this computer\n" if status is HTTPStatus.MISDIRECTED_REQUEST else ""
        self.finish(f"{status.value} {status.phrase}\n{hint}")


class _Nothing(_Guarded):
    def get(self) -> None:
        raise HTTPError(HTTPStatus.NOT_FOUND)

    head = get


class _Asset(_Guarded, StaticFileHandler):
    """The page, its scripts and styles."""

    async def prepare(self) -> None:
        """Leave out ranges: they would be those of the compressed file."""
        await super().prepare()
        self.request.headers.pop("Range", None)


class _Document(_Guarded):
    async def get(self, name: str) -> None:
        document = await self.site.documents.get(name)
        if not document.is_there:
            self.set_status(HTTPStatus.SERVICE_UNAVAILABLE)
        self.set_header("Content-Type", document.content_type)
        self.write(document.body)

    head = get


class _Schema(_Guarded):
    def get(self, name: str) -> None:
        self.set_header("Content-Type", "application/schema+json")
        self.write(schema_of({"status": Status, "history": History}[name], name))

    head = get


class _Health(_Guarded):
    def get(self, what: str) -> None:
        snapshot, wrong = self.site.snapshot(), ""
        # Before the first tick the start counts, so that a slow start is no hang.
        since_s = self.site.clock() - (snapshot.finished_at_s if snapshot else self.site.started_at_s)
        if what == "ready" and snapshot is None:
            wrong = "not ready: no tick has finished yet"
        elif what == "healthy" and since_s >= HEALTHY_S:
            last = "the last tick finished" if snapshot else "no tick has finished since the start"
            wrong = f"unhealthy: {last} {since_s:.1f} s ago; the limit is {HEALTHY_S:.0f} s"
        if wrong:
            self.set_status(HTTPStatus.SERVICE_UNAVAILABLE)
        self.write(f"{wrong or what}\n")

    head = get
