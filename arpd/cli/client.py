"""Questions to a running daemon over HTTP: its address, the login, and its documents."""

from __future__ import annotations

import ipaddress
import logging
import os
import ssl
from contextlib import suppress
from socket import gaierror
from typing import TYPE_CHECKING, Any, Self

from pydantic import ValidationError
from pydantic_core import from_json
from tornado.httpclient import HTTPClient, HTTPClientError
from tornado.iostream import UnsatisfiableReadError
from tornado.simple_httpclient import HTTPTimeoutError, SimpleAsyncHTTPClient

from arpd.cli.options import IN_CLEAR, PASSWORD, Address
from arpd.model.errors import ArpdError, DaemonUnreachableError, NoAnswerError, UsageError
from arpd.model.quantities import printable
from arpd.web.api import History, Status
from arpd.web.json_text import read

if TYPE_CHECKING:
    import argparse
    from pathlib import Path

_DEADLINE_S = 3.0  # of a whole answer
_FOR_CERTIFICATE = "for a client certificate, which arpd cannot present; ask its API by curl --cert"
_MOST_BYTES = 16 * 2**20
_LONGEST = 400  # characters of a text
_LARGEST = 2**63  # counts beyond it are nonsense
_OTHER_NAME = {62, 64}  # X509_V_ERR_HOSTNAME_MISMATCH, X509_V_ERR_IP_ADDRESS_MISMATCH
_NOT_NOW = {9, 10}  # X509_V_ERR_CERT_NOT_YET_VALID, X509_V_ERR_CERT_HAS_EXPIRED: x509_vfy.h


class Daemon:
    """A daemon that is asked without a proxy.

    Parameters
    ----------
    options : of the command line: the address, a CA, and whether and how to log in
    address : where it answers, by default that of the options

    Raises
    ------
    UsageError
        If there is a user without a password, or one whose password would cross the network in clear, or a CA that
        cannot be used, or is of no use.
    """

    def __init__(self, options: argparse.Namespace, address: Address | None = None) -> None:
        address = address or options.url
        is_tls, user = address.base.startswith("https:"), options.user
        if options.cacert and not is_tls:
            raise UsageError("--cacert is for https://, which --url does not name")
        if user and PASSWORD not in os.environ:
            raise UsageError(
                f"--user needs the password in ${PASSWORD}; there is no option for it, because ps shows options"
            )
        if user and not (is_tls or options.password_in_clear or _is_here(address.host)):
            raise UsageError(
                f"--user over http:// sends the password to {printable(address.host)} in clear; "
                f"write https:// in --url, or give {IN_CLEAR}"
            )
        self.url, self._base, self._user = address.url, address.base, user
        self._options = {
            "ssl_options": _tls(options.cacert) if is_tls else None,
            "auth_username": user or None,
            "auth_password": os.environ.get(PASSWORD, ""),
            "follow_redirects": False,
            "user_agent": "arpd",
        }
        for name in ("asyncio", "tornado"):
            logging.getLogger(name).setLevel(logging.CRITICAL)  # what they warn of is in the error
        self._client = HTTPClient(SimpleAsyncHTTPClient, max_body_size=_MOST_BYTES)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self._client.close()

    def document(self) -> dict[str, Any]:
        """Return the status document as it came; before the first tick it has `api_version` and `ready` only.

        Raises
        ------
        DaemonUnreachableError
            If nothing answers there, something else than arpd answers, or arpd refuses.
        """
        document = self._answer("/api/v1/status")
        if not isinstance(document, dict) or "api_version" not in document:
            raise DaemonUnreachableError(
                f"what answers at {self.url} is not arpd; stop it (sudo ss -ltnp), or name the daemon with --url"
            )
        return document

    def status(self) -> Status | None:
        """Return the status, None before the first tick; raise what `document` and `read_status` do."""
        return read_status(self.document(), source=self.url)

    def history(self) -> History | None:
        """Return the history, None where there is none."""
        try:
            return read_history(self._answer("/api/v1/history"))
        except DaemonUnreachableError:
            return None

    def _answer(self, path: str) -> Any:
        """Return a document, None where something else answers; one that is not ready has its reason in a 503."""
        url, deadline = self.url, {"connect_timeout": _DEADLINE_S, "request_timeout": _DEADLINE_S}
        try:
            answer = self._client.fetch(self._base + path, raise_error=False, **self._options, **deadline)
        # Before ValueError: a certificate that is not trusted is both.
        except (OSError, HTTPClientError, UnsatisfiableReadError) as error:
            raise _no_answer(url, error) from None
        except ValueError as error:
            raise UsageError(f"--url {url!r} leads nowhere ({error})") from None
        refuses = f"refuses the password of {self._user}" if self._user else "asks for a user; give --user NAME"
        leads = f"{url} leads to {printable(answer.headers.get('Location', ''), longest=200)}"
        refusals = {
            3: f"{leads}; write that in --url if it is the daemon",
            401: f"the daemon at {url} {refuses}; the password is taken from ${PASSWORD}",
            429: f"the daemon at {url} had too many wrong passwords from here; wait a few seconds",
            421: f"the computer at {url} does not call itself so; write its address, or a name of its own, in --url",
        }
        if why := refusals.get(answer.code) or refusals.get(answer.code // 100):
            raise DaemonUnreachableError(why)
        try:
            return from_json(answer.body, allow_inf_nan=False)
        except ValueError:  # also where it is nested more than 200 deep
            return None


def _is_here(host: str) -> bool:
    """Return whether nobody else hears what goes there; a name server may say anything of a name."""
    with suppress(ValueError):
        return ipaddress.ip_address(host).is_loopback
    return host == "localhost"


def read_status(document: dict[str, Any], *, source: str) -> Status | None:
    """Return a status document as its model; its texts are safe for a terminal. None before the first tick.

    Raises
    ------
    ArpdError
        If it is of another version of arpd.
    """
    if document.get("ready") is False:
        return None
    try:
        return read(Status, _shown(document))
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = f"{printable('.'.join(map(str, first['loc'])))}: {printable(first['msg'])}"
        raise ArpdError(
            f"what {printable(source, longest=4096)} says is of another version of arpd ({where}); "
            "`arpd status --json` prints it"
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
        hint = "compare the clocks of both computers" if error.verify_code in _NOT_NOW else "name its CA with --cacert"
        hint = "write a name that it has in --url" if error.verify_code in _OTHER_NAME else hint
        why = f"the certificate of {url} is not trusted ({error.verify_message}); {hint}"
    elif isinstance(error, ssl.SSLEOFError):  # whether its alert is read before the end of the connection is chance
        why = f"{url} broke off TLS, so it speaks no https, or asks {_FOR_CERTIFICATE}"
    elif isinstance(error, ssl.SSLError) and "CERTIFICATE_REQUIRED" in (error.reason or ""):
        why = f"{url} asks {_FOR_CERTIFICATE}"
    elif isinstance(error, ssl.SSLError):
        why = f"{url} cannot be reached by TLS ({error.reason or 'the handshake failed'}); does it speak https?"
    elif isinstance(error, (OSError, HTTPTimeoutError)) and not isinstance(error, ConnectionResetError):
        is_late = isinstance(error, (TimeoutError, HTTPTimeoutError))
        reason = "timed out" if is_late else getattr(error, "strerror", None) or error
        hint = "is it running (systemctl status arpd), and do its http.host and http.port name this address?"
        why = f"no daemon answers at {url} ({reason}); "
        if isinstance(error, gaierror):
            return DaemonUnreachableError(f"{why}write its address in --url, or a name that `getent hosts` knows here")
        if is_late and url.lower().startswith("https:"):  # a server without TLS waits for the rest of a request
            return DaemonUnreachableError(f"{why}{hint} Does it speak https? Without TLS, write http:// in --url")
        return NoAnswerError(f"{why}{hint}", url=url, is_late=is_late)
    else:
        hint = "" if url.lower().startswith("https:") else "; if the daemon has TLS, write https:// in --url"
        why = f"no whole answer from {url} (it speaks no HTTP, or its answer broke off){hint}"
    return DaemonUnreachableError(why)
