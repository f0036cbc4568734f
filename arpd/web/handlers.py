"""Handles requests: who may ask, and the answer for each path."""

from __future__ import annotations

import json
from http import HTTPStatus
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from tornado.web import Application, HTTPError, RequestHandler, StaticFileHandler

from arpd.web.api import API_VERSION, History, Status
from arpd.web.json_text import schema_of

if TYPE_CHECKING:
    from arpd.web.access import Access
    from arpd.web.documents import Documents

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
    HTTPStatus.TOO_MANY_REQUESTS: {"Retry-After": "5"},
    HTTPStatus.SERVICE_UNAVAILABLE: {"Retry-After": "1"},
}
_METRICS = "text/plain; version=0.0.4; charset=utf-8"


class Site(Application):
    """The paths of the daemon."""

    def __init__(self, *, documents: Documents, access: Access) -> None:
        self.documents = documents
        self.access = access
        super().__init__(
            [
                (r"/()", _Asset, {"path": ASSETS, "default_filename": "page.html"}),
                (r"/assets/([\w./-]+)", _Asset, {"path": ASSETS}),
                (r"/(metrics)", _Document),
                (r"/api/v1/(status|history)", _Document),
                (r"/api/v1/schema/(status|history)-v1\.json", _Schema),
            ],
            default_handler_class=_Nothing,
            compress_response=True,
            log_function=self._count,
        )

    def _count(self, handler: RequestHandler) -> None:
        path = handler.request.path
        label = "/assets/" if path.startswith("/assets/") else "other" if isinstance(handler, _Nothing) else path
        self.access.counts.requests.labels(label, handler.get_status()).inc()


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
        if status := await self.site.access.refusal(self.request):
            raise HTTPError(status)

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
    async def prepare(self) -> None:
        """Leave out ranges: they would be those of the compressed file."""
        await super().prepare()
        self.request.headers.pop("Range", None)


class _Document(_Guarded):
    async def get(self, name: str) -> None:
        body = await self.site.documents.get(name)
        self.set_header("Content-Type", _METRICS if name == "metrics" else "application/json")
        if not body:
            self.set_status(HTTPStatus.SERVICE_UNAVAILABLE)
            body = json.dumps({"api_version": API_VERSION, "ready": False}).encode()
        self.write(body)

    head = get


class _Schema(_Guarded):
    def get(self, name: str) -> None:
        self.set_header("Content-Type", "application/schema+json")
        self.write(schema_of({"status": Status, "history": History}[name], name))

    head = get
