"""The web-config: users, TLS and client certificates, in the format of Prometheus exporters (exporter-toolkit)."""

from __future__ import annotations

import ipaddress
import re
import ssl
from dataclasses import dataclass, field
from enum import StrEnum
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, PlainValidator, ValidationError

from arpd.host.config.yaml_source import Fault, config_error, dotted, read_source
from arpd.model.quantities import printable

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Mapping
    from pathlib import Path

    from pydantic_core import ErrorDetails

    from arpd.host.config.yaml_source import Location, YamlSource
    from arpd.model.settings import HttpSettings

MAX_COST = 14  # each step doubles the time of bcrypt; 14 takes seconds on a Pi
_HASH = re.compile(r"\$2[aby]\$([0-9]{2})\$[./A-Za-z0-9]{53}")
_MAKE_HASH = "make one with `htpasswd -nBC 10 NAME`"
_MAX_PEM_BYTES = 2**20
_TLS = "tls_server_config"
_MINIMAL = "a minimal one is `basic_auth_users: {NAME: HASH}`, or leave http.web_config out"
# Of exporters only, with the way out.
_UNSUPPORTED = {
    "cert": "write the certificate to a file and name it in cert_file",
    "key": "write the key to a file that only arpd may read and name it in key_file",
    "client_ca": "write the CA to a file and name it in client_ca_file",
    "rate_limit": "remove it; arpd limits connections by itself",
    "http_server_config": "remove it; arpd speaks HTTP/1.1 with headers of its own",
} | dict.fromkeys(
    ("min_version", "max_version", "cipher_suites", "prefer_server_cipher_suites", "curve_preferences"),
    "remove it; arpd speaks TLS 1.2 and 1.3 with OpenSSL's choice of ciphers",
)


class ClientAuth(StrEnum):
    """Values of ``client_auth_type``."""

    NONE = "NoClientCert"
    IF_GIVEN = "VerifyClientCertIfGiven"
    REQUIRED = "RequireAndVerifyClientCert"


_VERIFY = {
    ClientAuth.NONE: ssl.CERT_NONE,
    ClientAuth.IF_GIVEN: ssl.CERT_OPTIONAL,
    ClientAuth.REQUIRED: ssl.CERT_REQUIRED,
}


def _hash(raw: Any) -> str:
    """Accept a bcrypt hash; no message shows it, because it is a secret."""
    match = _HASH.fullmatch(raw) if isinstance(raw, str) else None
    if match is None:
        raise ValueError(f"is not a bcrypt hash; {_MAKE_HASH}")
    if not 4 <= int(match[1]) <= MAX_COST:
        raise ValueError(f"has bcrypt cost {match[1]}, arpd takes 4..{MAX_COST}; {_MAKE_HASH}")
    return match[0]


_File = Annotated[str, Field(pattern=r"^[^\x00]{1,4096}$")]
_WRONG = {
    "client_auth_type": f"is not one of the choices; write {' or '.join(ClientAuth)}",
    "client_allowed_sans": "is not a list of names; write `- name` for each, or leave it out",
} | dict.fromkeys(("cert_file", "key_file", "client_ca_file"), "is not a path; write the path of a PEM file")


class _Section(BaseModel):
    model_config = ConfigDict(strict=True, extra="forbid", frozen=True)


class TlsServer(_Section):
    """``tls_server_config``."""

    cert_file: _File
    key_file: _File
    client_auth_type: Annotated[ClientAuth, Field(strict=False)] = ClientAuth.NONE
    client_ca_file: _File = ""
    client_allowed_sans: Annotated[list[Annotated[str, Field(min_length=1)]], Field(min_length=1)] = []


class WebDocument(_Section):
    """The whole file."""

    tls_server_config: TlsServer | None = None
    basic_auth_users: dict[str, Annotated[str, PlainValidator(_hash)]] = {}


@dataclass(frozen=True, kw_only=True, slots=True)
class Protection:
    """Requirements on connections.

    Parameters
    ----------
    tls : context that wraps connections, None = plain
    requires_certificate : True if a client needs a certificate of the CA
    allowed_sans : alternative names, one of which the certificate must have; empty = any
    users : name → bcrypt hash, empty = no authentication
    files : files that all this was read from
    """

    tls: ssl.SSLContext | None = None
    requires_certificate: bool = False
    allowed_sans: frozenset[str] = frozenset()
    users: Mapping[bytes, bytes] = field(default_factory=lambda: MappingProxyType({}), repr=False)
    files: tuple[Path, ...] = ()


def web_config_path(http: HttpSettings, *, directory: Path) -> Path | None:
    """Return the file that ``http.web_config`` names, None if it names none; relative paths start in ``directory``."""
    return None if http.web_config is None else directory / http.web_config


def check_web_config(http: HttpSettings, *, directory: Path) -> None:
    """Check the file that ``http.web_config`` names, if any, and its certificates.

    Raises
    ------
    ConfigError
        With every fault.
    """
    if path := web_config_path(http, directory=directory):
        load_protection(path)


def load_protection(path: Path) -> Protection:
    """Read and check a web-config file and its certificates.

    Raises
    ------
    ConfigError
        With every fault of the file, in its order.
    """
    source = read_source(path, minimal=_MINIMAL)
    faults, document = [*source.faults], WebDocument()
    try:
        document = WebDocument.model_validate(source.data)
    except ValidationError as error:
        faults += (_reworded(details, source) for details in error.errors(include_url=False, include_input=False))
    else:
        faults += (source.fault(location, text) for location, text in _broken_rules(document, source))
    if faults:
        raise config_error(path, faults)
    section = document.tls_server_config
    try:
        context = _context(section, path.parent) if section else None
    except _FileError as error:
        raise config_error(path, [source.fault((_TLS, error.key), error.text)]) from None
    named = (section.cert_file, section.key_file, section.client_ca_file) if section else ()
    return Protection(
        tls=context,
        requires_certificate=section is not None and section.client_auth_type is ClientAuth.REQUIRED,
        allowed_sans=frozenset(section.client_allowed_sans if section else ()),
        users=MappingProxyType({name.encode(): h.encode() for name, h in document.basic_auth_users.items()}),
        files=(path, *(path.parent / name for name in named if name)),
    )


def has_allowed_name(certificate: Mapping[str, Any] | None, allowed: Collection[str]) -> bool:
    """Return whether an alternative name (DNS, IP, e-mail, URI) of a decoded certificate is allowed."""
    names = {
        _plain_ip(name.strip()) for _, name in (certificate or {}).get("subjectAltName", ()) if isinstance(name, str)
    }
    return not names.isdisjoint(map(_plain_ip, allowed))


def _plain_ip(name: str) -> str:
    """Return an address in its short form, because OpenSSL spells IPv6 out, and any other name unchanged."""
    try:
        return str(ipaddress.ip_address(name))
    except ValueError:
        return name


def _broken_rules(document: WebDocument, source: YamlSource) -> Iterator[tuple[Location, str]]:
    """Yield the faults that no single value shows."""
    for name in document.basic_auth_users:
        if not name or ":" in name:
            yield ("basic_auth_users", name), "cannot be a name (RFC 7617); write one without a colon"
    tls = document.tls_server_config
    if tls is None:
        if _TLS in source.data:
            yield (_TLS,), "has no value; give it keys or leave it out"
        return
    asks = tls.client_auth_type is not ClientAuth.NONE
    if tls.client_ca_file and not asks:
        wrong = f"does nothing while client_auth_type is {ClientAuth.NONE}; write {ClientAuth.REQUIRED} there"
        yield (_TLS, "client_ca_file"), wrong
    if asks and not tls.client_ca_file:
        wrong = f"{tls.client_auth_type} needs a CA to verify with; name its file in client_ca_file"
        yield (_TLS, "client_auth_type"), wrong
    if tls.client_allowed_sans and tls.client_auth_type is not ClientAuth.REQUIRED:
        wrong = f"needs a certificate from every client; set client_auth_type to {ClientAuth.REQUIRED}"
        yield (_TLS, "client_allowed_sans"), wrong


def _reworded(details: ErrorDetails, source: YamlSource) -> Fault:
    location: Location = details["loc"]
    key = location[1] if location[0] == _TLS and len(location) > 1 else ""
    if key in _WRONG and details["type"] != "missing":
        return source.fault(location[:2], _WRONG[str(key)])
    match details["type"]:
        case "extra_forbidden":
            name = str(location[-1])
            known = (TlsServer if len(location) > 1 else WebDocument).model_fields
            wrong = f"is not a key of a web-config; known here: {', '.join(known)}"
            if name in _UNSUPPORTED:
                wrong = f"is a key of Prometheus exporters that arpd does not support; {_UNSUPPORTED[name]}"
            return Fault(place=source.keys[location], key=dotted(location), text=wrong)
        case "missing":
            text = "is missing; TLS needs a certificate and its key"
        case "value_error":
            text = str(details["ctx"]["error"])
        case _:
            wrong = "has no value" if source.value(location) is None else "is not a mapping"
            text = f"{wrong}; give it keys or leave it out"
    return source.fault(location, text)


class _FileError(Exception):
    """A file of ``tls_server_config`` cannot be used: its key, and ``what is wrong; what would be right``."""

    def __init__(self, key: str, text: str) -> None:
        super().__init__(text)
        self.key = key
        self.text = text


def _context(section: TlsServer, directory: Path) -> ssl.SSLContext:
    certificate, key = directory / section.cert_file, directory / section.key_file
    _check_pem("cert_file", certificate, "CERTIFICATE")
    _check_pem("key_file", key, "PRIVATE KEY")
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    context.set_alpn_protocols(["http/1.1"])
    context.options |= ssl.OP_NO_RENEGOTIATION
    context.verify_mode = _VERIFY[section.client_auth_type]
    try:
        context.load_cert_chain(certificate, key, password=_no_passphrase)
    except ssl.SSLError as error:
        if "MISMATCH" in (error.reason or ""):
            text = "does not belong to the certificate in cert_file; name the key made with it"
            raise _FileError("key_file", text) from None
        text = f"cannot be used with key_file ({error.reason or 'not PEM'}); create both again"
        raise _FileError("cert_file", text) from None
    if section.client_ca_file:
        authority = directory / section.client_ca_file
        _check_pem("client_ca_file", authority, "CERTIFICATE")
        try:
            context.load_verify_locations(authority)
        except ssl.SSLError as error:
            text = f"holds no usable certificate ({error.reason or 'not PEM'}); renew it"
            raise _FileError("client_ca_file", text) from None
    return context


def _check_pem(key: str, path: Path, label: str) -> None:
    """Raise an error for each fault that OpenSSL reports alike."""
    shown = printable(str(path), longest=200)
    try:
        with path.open("rb") as file:
            text = file.read(_MAX_PEM_BYTES)
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or error
        raise _FileError(key, f"{shown} cannot be read ({why}); name a PEM file that this user may read") from None
    if not re.search(rb"-----BEGIN ([A-Z0-9]+ )*" + label.encode() + b"-----", text):
        raise _FileError(key, f"{shown} holds no {label} in PEM; convert it with openssl")


def _no_passphrase() -> str:
    """Refuse a passphrase; OpenSSL would ask the terminal for it."""
    raise _FileError("key_file", "has a passphrase, which a daemon cannot enter; decrypt it with openssl pkey")
