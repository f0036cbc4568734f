"""Questions to a running daemon over HTTP: its address, the login, and its documents, read by the models of the API."""

from __future__ import annotations

import json
import logging
import os
import ssl
from contextlib import closing
from dataclasses import dataclass, field
from http import HTTPStatus
from typing import TYPE_CHECKING, Any

from pydantic import ValidationError
from tornado.httpclient import HTTPClient, HTTPError
from tornado.simple_httpclient import HTTPTimeoutError, SimpleAsyncHTTPClient

from arpd.cli.options import DEFAULT_URL, IN_CLEAR, PASSWORD, plain_host
from arpd.model.errors import ArpdError, DaemonUnreachableError, NoAnswerError, UsageError
from arpd.model.quantities import printable
from arpd.web.api.history import History
from arpd.web.api.status import Status

if TYPE_CHECKING:
    import argparse
    from pathlib import Path

    from tornado.httpclient import HTTPResponse

_DEADLINE_S = 3.0  # of a whole answer
_MOST_BYTES = 16 * 2**20
_LONGEST = 400  # characters of a text
_LARGEST = 2**63  # counts beyond it are nonsense

# Its warning about TLS would stand beside arpd's own error.
logging.getLogger("tornado").addHandler(logging.NullHandler())


@dataclass(frozen=True, kw_only=True, slots=True)
class DaemonAddress:
    """A daemon to ask.

    Parameters
    ----------
    url : base URL, like http://127.0.0.1:9464
    cacert : CA that verifies the daemon's certificate, None = the system's
    user, password : basic authentication; without a user there is none
    """

    url: str
    cacert: Path | None = None
    user: str = ""
    password: str = field(default="", repr=False)

    def document(self) -> dict[str, Any]:
        """Return the status document as it came; before the first tick it has `api_version` and `ready` only.

        Raises
        ------
        UsageError
            If the URL is not an HTTP address, or the CA cannot be used.
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
        UsageError, DaemonUnreachableError, ArpdError
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
        if not url.lower().startswith(("http://", "https://")):
            raise UsageError(f"--url {url!r} is not an HTTP address; write it like {DEFAULT_URL}")
        try:
            answer = self._fetch(url.rstrip("/") + path)
        except OSError as error:
            raise _no_answer(url, error) from None
        except HTTPError as error:
            raise _no_answer(url, TimeoutError("timed out") if isinstance(error, HTTPTimeoutError) else error) from None
        except (ValueError, KeyError) as error:
            raise UsageError(f"--url {url!r} is not an HTTP address ({error}); write it like {DEFAULT_URL}") from None
        code, body = answer.code, answer.body or b""
        if HTTPStatus.MULTIPLE_CHOICES <= code < HTTPStatus.BAD_REQUEST:
            where = printable(answer.headers.get("Location", ""), longest=200)
            why = f"{url} leads to {where}; write that in --url if it is the daemon"
        elif code == HTTPStatus.UNAUTHORIZED:
            wrong = f"refuses the password of {self.user}" if self.user else "asks for a user; give --user NAME"
            why = f"the daemon at {url} {wrong}; the password is taken from ${PASSWORD}"
        elif code == HTTPStatus.TOO_MANY_REQUESTS:
            why = f"the daemon at {url} had too many wrong passwords from here; wait a few seconds"
        elif code == HTTPStatus.BAD_REQUEST and b"HTTPS" in body[:100]:
            why = f"the daemon at {url} speaks HTTPS; write https:// in --url"
        else:
            return code, body  # a daemon that is not ready has its reason in the body of its 503
        raise DaemonUnreachableError(why)

    def _fetch(self, url: str) -> HTTPResponse:
        """Return the whole answer, which has one deadline, however slowly it comes.

        Tornado asks no proxy of the environment, as the daemon is on this network, and for gzip: a fifth of the bytes,
        which may cross the link that arpd protects.
        """
        client = HTTPClient(SimpleAsyncHTTPClient, force_instance=True, max_body_size=_MOST_BYTES)
        with closing(client):
            return client.fetch(
                url,
                raise_error=False,
                follow_redirects=False,
                connect_timeout=_DEADLINE_S,
                request_timeout=_DEADLINE_S,
                ssl_options=self._tls() if url.lower().startswith("https:") else None,
                **({"auth_username": self.user, "auth_password": self.password} if self.user else {}),
            )

    def _tls(self) -> ssl.SSLContext:
        try:
            return ssl.create_default_context(cafile=self.cacert)
        except (OSError, ValueError) as error:
            why = getattr(error, "strerror", None) or error
            raise UsageError(f"--cacert {str(self.cacert)!r} cannot be used ({why}); name a PEM file") from None


def address(options: argparse.Namespace) -> DaemonAddress:
    """Return the daemon that the options name.

    Raises
    ------
    UsageError
        If there is a user without a password, or one whose password would cross the network in clear.
    """
    if options.user and PASSWORD not in os.environ:
        raise UsageError(
            f"--user needs the password in ${PASSWORD}; there is no option for it, because ps shows options"
        )
    if options.user and not options.password_in_clear and (host := plain_host(options.url)):
        raise UsageError(
            f"--user over http:// sends the password to {printable(host)} in clear; "
            f"write https:// in --url, or give {IN_CLEAR}"
        )
    return DaemonAddress(
        url=options.url, cacert=options.cacert, user=options.user, password=os.environ.get(PASSWORD, "")
    )


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
    hint = "is it running (systemctl status arpd), and is http.port the same?"
    return NoAnswerError(f"no daemon answers at {url} ({error}); {hint}", is_late=isinstance(error, TimeoutError))
