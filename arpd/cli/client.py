"""Questions to a running daemon over HTTP, its address and login, and safe access to its documents."""

from __future__ import annotations

import json
import math
import os
from dataclasses import dataclass, field
from http import HTTPStatus
from pathlib import Path
from typing import TYPE_CHECKING, Any

from arpd.model.errors import DaemonUnreachableError, NoAnswerError, UsageError
from arpd.model.quantities import printable
from arpd.model.settings import HttpSettings

if TYPE_CHECKING:
    import argparse
    import ssl
    from http.client import HTTPResponse
    from urllib.error import HTTPError

_TIMEOUT_S = 3.0
_MAX_BYTES = 16 * 2**20
_DEFAULT = HttpSettings()
_PASSWORD = "ARPD_PASSWORD"  # noqa: S105 - the variable's name


@dataclass(frozen=True, kw_only=True, slots=True)
class Login:
    """Login to a protected daemon.

    Parameters
    ----------
    cacert : CA that verifies the daemon's certificate, None = the system's
    user, password : basic authentication; without a user there is none
    """

    cacert: Path | None = None
    user: str = ""
    password: str = field(default="", repr=False)

    def authorization(self) -> str:
        """Return the Authorization header, empty without a user."""
        import base64

        return f"Basic {base64.b64encode(f'{self.user}:{self.password}'.encode()).decode()}" if self.user else ""

    def context(self) -> ssl.SSLContext:
        """Return the TLS settings that verify the daemon.

        Raises
        ------
        UsageError
            If the CA cannot be used.
        """
        import ssl

        try:
            return ssl.create_default_context(cafile=self.cacert)
        except (OSError, ValueError) as error:
            why = getattr(error, "strerror", None) or error
            raise UsageError(f"--cacert {str(self.cacert)!r} cannot be used ({why}); name a PEM file") from None


@dataclass(frozen=True, kw_only=True, slots=True)
class DaemonAddress:
    """A daemon to ask.

    Parameters
    ----------
    url : base URL, like http://127.0.0.1:9464
    login : CA, user and password
    """

    url: str
    login: Login = field(default_factory=Login)

    def status(self) -> dict[str, Any]:
        """Return the status document (`arpd.report.status`); a daemon that is not ready sends a part of it.

        Raises
        ------
        UsageError
            If the URL is not an HTTP address, or the CA cannot be used.
        DaemonUnreachableError
            If nothing answers there, something else than arpd answers, or arpd refuses.
        """
        status = _document(self._answer("/api/v1/status")[1])
        if status is None:
            raise DaemonUnreachableError(
                f"what answers at {self.url} is not arpd; name the daemon's address with --url"
            )
        return status

    def history(self) -> dict[str, Any] | None:
        """Return the history document, None from a daemon that keeps no history.

        Raises
        ------
        UsageError, DaemonUnreachableError
            As `status`.
        """
        code, body = self._answer("/api/v1/history")
        return _document(body) if code == HTTPStatus.OK else None

    def _answer(self, path: str) -> tuple[int, bytes]:
        from http.client import HTTPException

        url, login = self.url, self.login
        if not url.startswith(("http://", "https://")):
            raise UsageError(f"--url {url!r} is not an HTTP address; write it like http://127.0.0.1:9464")
        try:
            code, body = _get(url.rstrip("/") + path, login)
        except (OSError, HTTPException) as error:
            raise _no_answer(url, getattr(error, "reason", None) or error) from None
        except ValueError as error:
            raise UsageError(f"--url {url!r} is not an HTTP address ({error})") from None
        if code == HTTPStatus.UNAUTHORIZED:
            wrong = f"refuses the password of {login.user}" if login.user else "asks for a user; give --user NAME"
            raise DaemonUnreachableError(f"the daemon at {url} {wrong}; the password is taken from ${_PASSWORD}")
        if code == HTTPStatus.TOO_MANY_REQUESTS:
            raise DaemonUnreachableError(
                f"the daemon at {url} had too many wrong passwords from here; wait a few seconds"
            )
        if code == HTTPStatus.BAD_REQUEST and b"HTTPS" in body[:100]:
            raise DaemonUnreachableError(f"the daemon at {url} speaks HTTPS; write https:// in --url")
        return code, body


def add_address(parser: argparse.ArgumentParser) -> None:
    """Add the options that name the daemon."""
    parser.add_argument(
        "--url", default=f"http://{_DEFAULT.host}:{_DEFAULT.port}", help="base URL of the daemon (default %(default)s)"
    )
    parser.add_argument(
        "--cacert", type=Path, metavar="FILE", help="CA of the daemon's certificate (default: the system's)"
    )
    parser.add_argument("--user", metavar="NAME", default="", help=f"log in; the password is taken from ${_PASSWORD}")


def address(options: argparse.Namespace) -> DaemonAddress:
    """Return the daemon that the options name.

    Raises
    ------
    UsageError
        If there is a user without a password.
    """
    if options.user and _PASSWORD not in os.environ:
        raise UsageError(
            f"--user needs the password in ${_PASSWORD}; there is no option for it, because ps shows options"
        )
    password = os.environ.get(_PASSWORD, "")
    return DaemonAddress(url=options.url, login=Login(cacert=options.cacert, user=options.user, password=password))


def _document(body: bytes) -> dict[str, Any] | None:
    try:
        document = json.loads(body)
    except (ValueError, RecursionError):
        return None
    return document if isinstance(document, dict) and "api_version" in document else None


def _no_answer(url: str, reason: object) -> DaemonUnreachableError:
    import ssl

    if isinstance(reason, ssl.SSLCertVerificationError):
        why = f"the certificate of {url} is not trusted ({reason.verify_message}); name its CA with --cacert"
        return DaemonUnreachableError(why)
    if isinstance(reason, ssl.SSLError):
        why = f"{url} cannot be reached by TLS ({reason.reason or 'the handshake failed'}); does it speak https?"
        return DaemonUnreachableError(why)
    hint = "is it running (systemctl status arpd), and is http.port the same?"
    return NoAnswerError(f"no daemon answers at {url} ({reason}); {hint}", is_late=isinstance(reason, TimeoutError))


def _get(address: str, login: Login) -> tuple[int, bytes]:
    import urllib.error
    import urllib.request

    # No proxy from the environment: the daemon is on this network.
    handlers: list[urllib.request.BaseHandler] = [urllib.request.ProxyHandler({})]
    if address.startswith("https:"):
        handlers.append(urllib.request.HTTPSHandler(context=login.context()))
    request = urllib.request.Request(address)  # noqa: S310 - the caller accepts http and https only
    # A fifth of the bytes: they may cross the link that arpd protects.
    request.add_header("Accept-Encoding", "gzip")
    if header := login.authorization():
        request.add_unredirected_header("Authorization", header)
    try:
        with urllib.request.build_opener(*handlers).open(request, timeout=_TIMEOUT_S) as response:
            return response.status, _body(response)
    except urllib.error.HTTPError as error:
        # A daemon that is not ready has its reason in the body of its 503.
        return error.code, _body(error)


def _body(answer: HTTPResponse | HTTPError) -> bytes:
    """Return the body, decompressed; empty where that cannot be done."""
    import zlib

    body = answer.read(_MAX_BYTES)
    if answer.headers.get("Content-Encoding") != "gzip":
        return body
    try:
        return zlib.decompressobj(wbits=31).decompress(body, _MAX_BYTES)
    except zlib.error:
        return b""


_LONGEST = 400


def find(document: object, *keys: str) -> Any:
    """Return the value under the keys, None where there is none."""
    for key in keys:
        if not isinstance(document, dict):
            return None
        document = document.get(key)
    return document


def number(document: object, *keys: str) -> float | None:
    """Return the finite number under the keys, None where there is none."""
    value = find(document, *keys)
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return None
    try:
        return float(value) if math.isfinite(value) else None
    except OverflowError:  # integers of JSON are unlimited
        return None


def count(document: object, *keys: str) -> int:
    """Return the count under the keys, 0 where there is none."""
    return int(number(document, *keys) or 0)


def text(document: object, *keys: str, longest: int = _LONGEST) -> str:
    """Return the text under the keys, safe for a terminal; empty where there is none."""
    value = find(document, *keys)
    return printable(value, longest=longest) if isinstance(value, str) else ""


def rows(document: object, *keys: str) -> list[dict[str, Any]]:
    """Return the objects of the list under the keys."""
    value = find(document, *keys)
    return [row for row in value if isinstance(row, dict)] if isinstance(value, list) else []


def texts(document: object, *keys: str) -> list[str]:
    """Return the texts of the list under the keys, as `text` does."""
    value = find(document, *keys)
    return (
        [printable(item, longest=_LONGEST) for item in value if isinstance(item, str)]
        if isinstance(value, list)
        else []
    )


def counts(document: object, *keys: str) -> dict[str, int]:
    """Return the counts by name under the keys, without zeros."""
    value = find(document, *keys)
    named = {printable(str(name)): count(value, name) for name in value} if isinstance(value, dict) else {}
    return {name: many for name, many in named.items() if many}


def series(document: object, *keys: str) -> list[float | None]:
    """Return the samples under the keys, None for a sample that is missing."""
    value = find(document, *keys)
    return [number({"": item}, "") for item in value] if isinstance(value, list) else []
