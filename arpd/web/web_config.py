"""Turns a web-config file into `Protection`, or reports every fault with its line and column."""

from __future__ import annotations

from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING

from pydantic import ValidationError

from arpd.host.config.load import reworded
from arpd.host.config.yaml_source import Fault, config_error, dotted, read_source
from arpd.web.tls import TlsFileError, make_context
from arpd.web.web_config_schema import (
    UNSUPPORTED,
    WEB_SECTIONS,
    ClientAuth,
    TlsServer,
    TlsVersion,
    WebDocument,
)

if TYPE_CHECKING:
    import ssl
    from collections.abc import Iterator, Mapping
    from pathlib import Path

    from pydantic_core import ErrorDetails

    from arpd.host.config.yaml_source import Location, YamlSource
    from arpd.model.settings import HttpSettings

_KNOWN = {
    path: [field.alias or name for name, field in section.model_fields.items()]
    for path, section in WEB_SECTIONS.items()
}
_TLS = ("tls_server_config",)
_MINIMAL = "a minimal one is `basic_auth_users: {NAME: HASH}`, or leave http.web_config out"


@dataclass(frozen=True, kw_only=True, slots=True)
class Protection:
    """Requirements on connections, and headers of answers.

    Parameters
    ----------
    tls : context that wraps connections, None = plain
    requires_certificate : True if a client needs a certificate of the CA
    allowed_sans : alternative names, one of which the certificate must have; empty = any
    users : name → bcrypt hash, empty = no authentication
    headers : headers of every answer, beside or instead of arpd's own
    files : files that all this was read from
    """

    tls: ssl.SSLContext | None = None
    requires_certificate: bool = False
    allowed_sans: frozenset[str] = frozenset()
    users: Mapping[bytes, bytes] = field(default_factory=lambda: MappingProxyType({}), repr=False)
    headers: Mapping[str, str] = field(default_factory=lambda: MappingProxyType({}))
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
    faults = [*source.faults]
    document = None
    try:
        document = WebDocument.model_validate(source.data)
    except ValidationError as error:
        faults += (_reworded(details, source) for details in error.errors(include_url=False, include_input=False))
    if document is not None:
        faults += _broken_rules(document, source)
    if faults or document is None:
        raise config_error(path, faults)
    section = document.tls_server_config
    try:
        context = make_context(section, directory=path.parent) if section else None
    except TlsFileError as error:
        raise config_error(path, [source.fault((*_TLS, error.key), error.text)]) from None
    named = (section.cert_file, section.key_file, section.client_ca_file) if section else ()
    return Protection(
        tls=context,
        requires_certificate=section is not None and section.client_auth_type is ClientAuth.REQUIRED,
        allowed_sans=frozenset(section.client_allowed_sans if section else ()),
        users=MappingProxyType({name.encode(): h.encode() for name, h in document.basic_auth_users.items()}),
        headers=MappingProxyType(
            {name: text for name, text in document.http_server_config.headers.model_dump(by_alias=True).items() if text}
        ),
        files=(path, *(path.parent / name for name in named if name)),
    )


def _broken_rules(document: WebDocument, source: YamlSource) -> Iterator[Fault]:
    """Yield the faults that no single value shows."""
    for name in document.basic_auth_users:
        if not name or ":" in name:
            yield source.fault(("basic_auth_users", name), "cannot be a name (RFC 7617); write one without a colon")
    if document.tls_server_config is None:
        if _TLS[0] in source.data:
            yield source.fault(_TLS, "has no value; give it keys or leave it out")
    else:
        yield from _broken_tls_rules(document.tls_server_config, source)


def _broken_tls_rules(tls: TlsServer, source: YamlSource) -> Iterator[Fault]:
    if (tls.min_version, tls.max_version) == (TlsVersion.TLS13, TlsVersion.TLS12):
        yield source.fault((*_TLS, "min_version"), "is above max_version TLS12; lower it or raise max_version")
    asks = tls.client_auth_type is not ClientAuth.NONE
    if tls.client_ca_file and not asks:
        wrong = f"does nothing while client_auth_type is {ClientAuth.NONE}; write {ClientAuth.REQUIRED} there"
        yield source.fault((*_TLS, "client_ca_file"), wrong)
    if asks and not tls.client_ca_file:
        wrong = f"{tls.client_auth_type} needs a CA to verify with; name its file in client_ca_file"
        yield source.fault((*_TLS, "client_auth_type"), wrong)
    if tls.client_allowed_sans and tls.client_auth_type is not ClientAuth.REQUIRED:
        wrong = f"needs a certificate from every client; set client_auth_type to {ClientAuth.REQUIRED}"
        yield source.fault((*_TLS, "client_allowed_sans"), wrong)


def _reworded(details: ErrorDetails, source: YamlSource) -> Fault:
    location: Location = details["loc"]
    if remedy := UNSUPPORTED.get(tuple(str(step) for step in location)):
        wrong = f"is a key of Prometheus exporters that arpd does not support; {remedy}"
        return Fault(place=source.keys[location], key=dotted(location), text=wrong)
    return reworded(details, source, _KNOWN)
