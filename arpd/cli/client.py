"""Questions to a running daemon over HTTP: its address, the login, and its documents."""

from __future__ import annotations

import base64
import ipaddress
import os
import ssl
import zlib
from contextlib import suppress
from functools import partial
from http import HTTPStatus
from http.client import HTTPConnection, HTTPException, HTTPSConnection, InvalidURL
from queue import Empty, SimpleQueue
from socket import SHUT_RDWR
from threading import Thread
from typing import TYPE_CHECKING, Any, Self
from urllib.parse import urlsplit

from pydantic import ValidationError
from pydantic_core import from_json

from arpd.cli.options import DEFAULT_URL, IN_CLEAR, PASSWORD, host_of, no_address
from arpd.model.errors import ArpdError, DaemonUnreachableError, NoAnswerError, UsageError
from arpd.model.quantities import printable
from arpd.web.api import History, Status
from arpd.web.json_text import read

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable
    from http.client import HTTPResponse
    from pathlib import Path

_DEADLINE_S = 3.0  # of a whole answer
_MOST_BYTES = 16 * 2**20
_LONGEST = 400  # characters of a text
_LARGEST = 2**63  # counts beyond it are nonsense
_GZIP = 16 + zlib.MAX_WBITS


class Daemon:
    """A daemon that is asked without a proxy, over one connection as long as it keeps that.

    Parameters
    ----------
    url : base URL, like http://127.0.0.1:9464
    cacert : CA that verifies the daemon's certificate, None = the system's
    user, password : basic authentication; without a user there is none

    Raises
    ------
    UsageError
        If the URL is not an HTTP address, or the CA cannot be used.
    """

    def __init__(self, url: str, *, cacert: Path | None = None, user: str = "", password: str = "") -> None:
        self.url, self._user = url, user
        self._headers = {"User-Agent": "arpd", "Accept-Encoding": "gzip"}  # it may cross the link that arpd protects
        if user:
            login = base64.b64encode(f"{user}:{password}".encode()).decode()
            self._headers["Authorization"] = f"Basic {login}"
        host, scheme = host_of(url), url.lower().partition("://")[0]
        if scheme not in {"http", "https"} or not host:
            raise UsageError(f"--url {url!r} is not an HTTP address; write it like {DEFAULT_URL}")
        try:
            parts = urlsplit(url)
            self._path, port = parts.path.rstrip("/"), parts.port
            self._open: Callable[[], HTTPConnection] = partial(HTTPConnection, host, port or 80, timeout=_DEADLINE_S)
            if scheme == "https":
                self._open = partial(HTTPSConnection, host, port or 443, timeout=_DEADLINE_S, context=_tls(cacert))
            self._connection = self._open()
        except (ValueError, InvalidURL) as error:
            raise no_address(url, error) from None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self._hang_up()

    def document(self) -> dict[str, Any]:
        """Return the status document as it came; before the first tick it has `api_version` and `ready` only.

        Raises
        ------
        DaemonUnreachableError
            If nothing answers there, something else than arpd answers, or arpd refuses.
        """
        document = _json(self._answer("/api/v1/status")[1])
        if not isinstance(document, dict) or "api_version" not in document:
            raise DaemonUnreachableError(
                f"what answers at {self.url} is not arpd; name the daemon's address with --url"
            )
        return document

    def status(self) -> Status | None:
        """Return the status, None before the first tick.

        Raises
        ------
        DaemonUnreachableError, ArpdError
            As `document` and `read_status`.
        """
        return read_status(self.document(), url=self.url)

    def history(self) -> History | None:
        """Return the history, None where there is none."""
        try:
            code, body = self._answer("/api/v1/history")
        except DaemonUnreachableError:
            return None
        return read_history(_json(body)) if code == HTTPStatus.OK else None

    def _answer(self, path: str) -> tuple[int, bytes]:
        url = self.url
        try:
            answer, body = self._within_deadline(path)
        except OSError as error:  # before ValueError: a certificate that is not trusted is both
            raise _no_answer(url, error) from None
        except (ValueError, InvalidURL) as error:
            raise no_address(url, error) from None
        except HTTPException as error:
            raise _no_answer(url, error) from None
        code = answer.status
        if HTTPStatus.MULTIPLE_CHOICES <= code < HTTPStatus.BAD_REQUEST:
            where = printable(answer.getheader("Location", ""), longest=200)
            why = f"{url} leads to {where}; write that in --url if it is the daemon"
        elif code == HTTPStatus.UNAUTHORIZED:
            wrong = f"refuses the password of {self._user}" if self._user else "asks for a user; give --user NAME"
            why = f"the daemon at {url} {wrong}; the password is taken from ${PASSWORD}"
        elif code == HTTPStatus.TOO_MANY_REQUESTS:
            why = f"the daemon at {url} had too many wrong passwords from here; wait a few seconds"
        elif code == HTTPStatus.MISDIRECTED_REQUEST:
            why = f"the computer at {url} does not call itself so; write its address, or a name of its own, in --url"
        else:
            return code, body  # a daemon that is not ready has its reason in the body of its 503
        raise DaemonUnreachableError(why)

    def _within_deadline(self, path: str) -> tuple[HTTPResponse, bytes]:
        """Ask in a thread: name server, handshake and answer have one deadline together, however slowly they come."""
        came: SimpleQueue[tuple[HTTPResponse, bytes] | Exception] = SimpleQueue()

        def ask() -> None:
            try:
                came.put(self._ask(path))
            except Exception as error:  # noqa: BLE001 - raised where it was asked
                came.put(error)

        Thread(target=ask, daemon=True).start()
        try:
            answer = came.get(timeout=_DEADLINE_S)
        except Empty:
            answer = TimeoutError("timed out")
        if isinstance(answer, Exception):
            self._hang_up()  # the rest of this answer may still come
            raise answer
        return answer

    def _ask(self, path: str) -> tuple[HTTPResponse, bytes]:
        connection = self._connection
        is_kept = connection.sock is not None
        try:
            connection.request("GET", self._path + path, headers=self._headers)
            answer = connection.getresponse()
        except ConnectionError:
            if not is_kept or connection is not self._connection:
                raise
            connection.close()  # the daemon has closed an idle connection
            return self._ask(path)
        body = answer.read(_MOST_BYTES)
        if answer.length or len(body) == _MOST_BYTES:
            raise ConnectionResetError("its answer broke off, or is too long")
        if answer.getheader("Content-Encoding") == "gzip":
            with suppress(zlib.error):  # then it is no document either
                body = zlib.decompressobj(_GZIP).decompress(body, _MOST_BYTES)
        return answer, body

    def _hang_up(self) -> None:
        """Begin anew; a thread that still waits has the connection of before to itself, and its end."""
        before, self._connection = self._connection, self._open()
        if (stream := before.sock) is not None:
            with suppress(OSError):
                stream.shutdown(SHUT_RDWR)
        before.close()


def connect(options: argparse.Namespace, *, url: str = "") -> Daemon:
    """Return the daemon that the options name, or the one at another address.

    Raises
    ------
    UsageError
        If there is a user without a password, or one whose password would cross the network in clear.
    """
    url = url or options.url
    if options.user and PASSWORD not in os.environ:
        raise UsageError(
            f"--user needs the password in ${PASSWORD}; there is no option for it, because ps shows options"
        )
    if options.user and not options.password_in_clear and (host := _plain_host(url)):
        raise UsageError(
            f"--user over http:// sends the password to {printable(host)} in clear; "
            f"write https:// in --url, or give {IN_CLEAR}"
        )
    return Daemon(url, cacert=options.cacert, user=options.user, password=os.environ.get(PASSWORD, ""))


def _plain_host(url: str) -> str:
    """Return the other computer to which a URL leads without TLS, empty for this one."""
    host = host_of(url)
    if url.lower().startswith("https:") or host == "localhost":
        return ""
    try:
        return "" if ipaddress.ip_address(host).is_loopback else host
    except ValueError:
        return host


def read_status(document: dict[str, Any], *, url: str) -> Status | None:
    """Return a status document as its model; its texts are safe for a terminal. None before the first tick.

    Raises
    ------
    ArpdError
        If it is of another version of arpd.
    """
    if "link" not in document and document.get("ready") is False:
        return None
    try:
        return read(Status, _shown(document))
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = printable(".".join(map(str, first["loc"])))
        raise ArpdError(
            f"the daemon at {url} speaks another version of arpd ({where}: {printable(first['msg'])}); "
            "`arpd status --json` prints what it says"
        ) from None


def read_history(document: object) -> History | None:
    """Return a history document as its model, None where it is something else."""
    try:
        return read(History, _shown(document))
    except ValidationError:
        return None


def _tls(cacert: Path | None) -> ssl.SSLContext:
    try:
        return ssl.create_default_context(cafile=cacert)
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or error
        raise UsageError(f"--cacert {str(cacert)!r} cannot be used ({why}); name a PEM file") from None


def _json(body: bytes) -> Any:
    try:
        return from_json(body, allow_inf_nan=False)
    except ValueError:  # also where it is nested more than 200 deep
        return None


def _shown(part: Any) -> Any:
    """Return a document whose texts and names are safe for a terminal, and whose numbers are of a sane size."""
    if isinstance(part, str):
        return printable(part, longest=_LONGEST)
    if isinstance(part, dict):
        return {printable(str(name)): _shown(value) for name, value in part.items()}
    if isinstance(part, list):
        return [_shown(value) for value in part]
    return None if isinstance(part, (int, float)) and not -_LARGEST < part < _LARGEST else part


def _no_answer(url: str, error: Exception) -> DaemonUnreachableError:
    if isinstance(error, ssl.SSLCertVerificationError):
        why = f"the certificate of {url} is not trusted ({error.verify_message}); name its CA with --cacert"
        return DaemonUnreachableError(why)
    if isinstance(error, ssl.SSLError):
        why = f"{url} cannot be reached by TLS ({error.reason or 'the handshake failed'}); does it speak https?"
        return DaemonUnreachableError(why)
    if isinstance(error, HTTPException | ConnectionResetError):
        wrong = error if isinstance(error, OSError) else "it speaks no HTTP, or its answer broke off"
        hint = "" if url.lower().startswith("https:") else "; if the daemon has TLS, write https:// in --url"
        return DaemonUnreachableError(f"no whole answer from {url} ({wrong}){hint}")
    hint = "is it running (systemctl status arpd), and is http.port the same?"
    why = f"no daemon answers at {url} ({error}); {hint}"
    return NoAnswerError(why, url=url, is_late=isinstance(error, TimeoutError))
