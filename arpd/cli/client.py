"""Questions to a running daemon over HTTP: its address, the login, and its documents, read by the models of the API."""

from __future__ import annotations

import json
import logging
import os
import ssl
from http import HTTPStatus
from typing import TYPE_CHECKING, Any, Self

from pydantic import ValidationError

from arpd.cli.kept_connection import KeptConnection
from arpd.cli.options import DEFAULT_URL, IN_CLEAR, PASSWORD, plain_host
from arpd.model.errors import ArpdError, DaemonUnreachableError, NoAnswerError, UsageError
from arpd.model.quantities import printable
from arpd.web.api.history import History
from arpd.web.api.status import Status

if TYPE_CHECKING:
    import argparse
    from pathlib import Path

_DEADLINE_S = 3.0  # of a whole answer
_MOST_BYTES = 16 * 2**20
_LONGEST = 400  # characters of a text
_LARGEST = 2**63  # counts beyond it are nonsense

# Its warning about TLS would stand beside arpd's own error.
logging.getLogger("tornado").addHandler(logging.NullHandler())


class Daemon:
    """A daemon that is asked, over one connection as long as it keeps that.

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
        scheme = url.lower().partition("://")[0]
        if scheme not in {"http", "https"}:
            raise UsageError(f"--url {url!r} is not an HTTP address; write it like {DEFAULT_URL}")
        try:
            self._connection = KeptConnection(
                url,
                tls=_tls(cacert) if scheme == "https" else None,
                user=user,
                password=password,
                deadline_s=_DEADLINE_S,
                most_bytes=_MOST_BYTES,
            )
        except ValueError as error:
            raise UsageError(f"--url {url!r} is not an HTTP address ({error}); write it like {DEFAULT_URL}") from None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self._connection.close()

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
            answer = self._connection.get(path)
        except OSError as error:
            raise _no_answer(url, error) from None
        except ValueError as error:
            raise UsageError(f"--url {url!r} is not an HTTP address ({error}); write it like {DEFAULT_URL}") from None
        code, body = answer.code, answer.body
        if HTTPStatus.MULTIPLE_CHOICES <= code < HTTPStatus.BAD_REQUEST:
            where = printable(answer.headers.get("Location", ""), longest=200)
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
    if options.user and not options.password_in_clear and (host := plain_host(url)):
        raise UsageError(
            f"--user over http:// sends the password to {printable(host)} in clear; "
            f"write https:// in --url, or give {IN_CLEAR}"
        )
    return Daemon(url, cacert=options.cacert, user=options.user, password=os.environ.get(PASSWORD, ""))


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
        return Status.model_validate(_shown(document))
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
        return History.model_validate(_shown(document))
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
        return json.loads(body, parse_constant=lambda _: None)
    except (ValueError, RecursionError):
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
    if isinstance(error, ConnectionResetError) and url.lower().startswith("http:"):
        why = f"no whole answer from {url} ({error}); if the daemon has TLS, write https:// in --url"
        return DaemonUnreachableError(why)
    hint = "is it running (systemctl status arpd), and is http.port the same?"
    return NoAnswerError(f"no daemon answers at {url} ({error}); {hint}", is_late=isinstance(error, TimeoutError))
