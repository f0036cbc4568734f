"""The server's side of TLS, from the files that a web-config names."""

from __future__ import annotations

import ipaddress
import re
import ssl
from typing import TYPE_CHECKING, Any

from arpd.model.quantities import printable
from arpd.web.web_config_schema import ClientAuth, TlsVersion

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Mapping
    from pathlib import Path

    from arpd.web.web_config_schema import TlsServer

_VERSIONS = {TlsVersion.TLS12: ssl.TLSVersion.TLSv1_2, TlsVersion.TLS13: ssl.TLSVersion.TLSv1_3}
_VERIFY = {
    ClientAuth.NONE: ssl.CERT_NONE,
    ClientAuth.IF_GIVEN: ssl.CERT_OPTIONAL,
    ClientAuth.REQUIRED: ssl.CERT_REQUIRED,
}
_MAX_PEM_BYTES = 2**20


class TlsFileError(Exception):
    """A file of ``tls_server_config`` cannot be used.

    Parameters
    ----------
    key : key that names the file
    text : ``what is wrong; what would be right``
    """

    def __init__(self, key: str, text: str) -> None:
        super().__init__(text)
        self.key = key
        self.text = text


def make_context(section: TlsServer, *, directory: Path) -> ssl.SSLContext:
    """Return the context that wraps connections.

    Parameters
    ----------
    section : ``tls_server_config``
    directory : folder where relative paths start

    Raises
    ------
    TlsFileError
        If a certificate, key or CA cannot be used.
    """
    certificate, key = directory / section.cert_file, directory / section.key_file
    _check_pem("cert_file", certificate, "CERTIFICATE")
    _check_pem("key_file", key, "PRIVATE KEY")
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = _VERSIONS[section.min_version]
    context.maximum_version = _VERSIONS[section.max_version]
    context.set_alpn_protocols(["http/1.1"])
    context.options |= ssl.OP_NO_RENEGOTIATION
    if not section.prefer_server_cipher_suites:
        context.options &= ~ssl.OP_CIPHER_SERVER_PREFERENCE
    if ciphers := ":".join(filter(None, section.cipher_suites)):
        context.set_ciphers(ciphers)
    try:
        context.load_cert_chain(certificate, key, password=_no_passphrase)
    except ssl.SSLError as error:
        raise _unusable_pair(error) from None
    if section.client_ca_file:
        authority = directory / section.client_ca_file
        _check_pem("client_ca_file", authority, "CERTIFICATE")
        try:
            context.load_verify_locations(authority)
        except ssl.SSLError as error:
            raise TlsFileError("client_ca_file", f"holds no usable certificate ({_reason(error)}); renew it") from None
    context.verify_mode = _VERIFY[section.client_auth_type]
    return context


def has_allowed_name(certificate: Mapping[str, Any] | None, allowed: Collection[str]) -> bool:
    """Return whether an alternative name (DNS, IP, e-mail, URI) of a decoded certificate is allowed."""
    return not {_plain_ip(name) for name in allowed}.isdisjoint(_names(certificate or {}))


def _names(certificate: Mapping[str, Any]) -> Iterator[str]:
    for kind, name in certificate.get("subjectAltName", ()):
        if kind in ("DNS", "email", "URI"):
            yield name
        elif kind == "IP Address":
            yield _plain_ip(name.strip())


def _plain_ip(name: str) -> str:
    """Return an address in its short form, because OpenSSL spells IPv6 out, and any other name unchanged."""
    try:
        return str(ipaddress.ip_address(name))
    except ValueError:
        return name


def _check_pem(key: str, path: Path, label: str) -> None:
    """Raise an error for each fault that OpenSSL reports alike."""
    shown = printable(str(path), longest=200)
    try:
        with path.open("rb") as file:
            text = file.read(_MAX_PEM_BYTES)
    except FileNotFoundError:
        raise TlsFileError(key, f"{shown} does not exist; create it or name another file") from None
    except PermissionError:
        raise TlsFileError(key, f"{shown} is not readable for this user; change its mode or owner") from None
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or error
        raise TlsFileError(key, f"{shown} cannot be read ({why}); name a PEM file") from None
    if not re.search(rb"-----BEGIN ([A-Z0-9]+ )*" + label.encode() + b"-----", text):
        raise TlsFileError(key, f"{shown} holds no {label} in PEM; convert it with openssl")


def _no_passphrase() -> str:
    """Refuse a passphrase; OpenSSL would ask the terminal for it."""
    raise TlsFileError("key_file", "has a passphrase, which a daemon cannot enter; decrypt it with openssl pkey")


def _unusable_pair(error: ssl.SSLError) -> TlsFileError:
    reason = _reason(error)
    if "MISMATCH" in reason:
        return TlsFileError("key_file", "does not belong to the certificate in cert_file; name the key made with it")
    return TlsFileError("cert_file", f"cannot be used with key_file ({reason}); create both again")


def _reason(error: ssl.SSLError) -> str:
    return error.reason or "not PEM"
