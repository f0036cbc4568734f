"""The web-config: users, TLS and client certificates, in the format of Prometheus exporters (exporter-toolkit)."""

from __future__ import annotations

import re
import ssl
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, cast

from pydantic import BeforeValidator, PlainValidator, TypeAdapter, ValidationInfo

from arpd.host.config.keys import sections_of
from arpd.host.config.load import validated
from arpd.host.config.yaml_source import YamlSource, read_bounded
from arpd.model.quantities import printable
from arpd.model.settings import HttpSettings, Section

MAX_COST = 14  # each step doubles the time of bcrypt; 14 takes seconds on a Pi
_HASH = re.compile(r"\$2[aby]\$([0-9]{2})\$[./A-Za-z0-9]{53}")
_MAKE_HASH = "make one with `htpasswd -nBC 10 NAME`"
_MINIMAL = "a minimal one is `basic_auth_users: {NAME: HASH}`, or leave http.web_config out"
_CLIENTS = {
    "NoClientCert": ssl.CERT_NONE,
    "VerifyClientCertIfGiven": ssl.CERT_OPTIONAL,
    "RequireAndVerifyClientCert": ssl.CERT_REQUIRED,
}


def _hash(raw: Any) -> bytes:
    """Accept a bcrypt hash; no message shows it, because it is a secret."""
    match = _HASH.fullmatch(raw) if isinstance(raw, str) else None
    if match is None:
        raise ValueError(f"is not a bcrypt hash; {_MAKE_HASH}")
    if not 4 <= int(match[1]) <= MAX_COST:
        raise ValueError(f"has bcrypt cost {match[1]}, arpd takes 4..{MAX_COST}; {_MAKE_HASH}")
    return match[0].encode()


def _name(raw: str) -> bytes:
    if not raw or ":" in raw:
        raise ValueError("cannot be a name (RFC 7617); write one without a colon")
    return raw.encode()


def _file(raw: Any, info: ValidationInfo) -> Path:
    if not raw or not isinstance(raw, str):
        raise ValueError("is not a path; write the path of a PEM file")
    path = cast("dict[str, Path]", info.context)["directory"] / raw
    shown = printable(str(path), longest=200)
    try:
        read_bounded(path)
    except ValueError as error:
        raise ValueError(f"{shown} {error}") from None
    if not path.is_file():  # OpenSSL opens it again, and would wait for the next writer of a FIFO
        raise ValueError(f"{shown} is no regular file; name a PEM file")
    return path


def _clients(raw: Any) -> ssl.VerifyMode:
    if not isinstance(raw, str) or raw not in _CLIENTS:
        raise ValueError(f"is not one of the choices; write {' or '.join(_CLIENTS)}")
    return _CLIENTS[raw]


def _given(raw: Any) -> Any:
    if raw is None:
        raise ValueError("has no value; give it keys or leave it out")
    return raw


_File = Annotated[Path, PlainValidator(_file)]


@dataclass(frozen=True, kw_only=True)
class TlsServer(Section):
    """``tls_server_config``."""

    cert_file: _File
    key_file: _File
    client_auth_type: Annotated[ssl.VerifyMode, PlainValidator(_clients)] = ssl.CERT_NONE
    client_ca_file: _File | None = None

    def __post_init__(self) -> None:
        """Refuse files that do not fit, and those that are no certificates."""
        if bool(self.client_auth_type) != bool(self.client_ca_file):
            raise ValueError(
                "client_ca_file needs a client_auth_type that asks for certificates, and one that asks needs the file; "
                "write both or neither"
            )
        _ = self.context

    @cached_property
    def context(self) -> ssl.SSLContext:
        """What wraps connections."""
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.minimum_version = ssl.TLSVersion.TLSv1_2
        context.set_alpn_protocols(["http/1.1"])
        context.options |= ssl.OP_NO_RENEGOTIATION
        context.verify_mode = self.client_auth_type
        keys, way_out = "cert_file and key_file", "name a certificate and its own key, both in PEM"
        try:
            context.load_cert_chain(self.cert_file, self.key_file, password=_no_passphrase)
            if self.client_ca_file:
                keys, way_out = "client_ca_file", "name a certificate in PEM"
                context.load_verify_locations(self.client_ca_file)
        except OSError as error:  # ssl.SSLError is one, and a file may vanish while it is read
            why = getattr(error, "reason", None) or error.strerror or "not PEM"
            raise ValueError(f"{keys} cannot be used ({why}); {way_out}") from None
        return context


@dataclass(frozen=True, kw_only=True)
class Protection(Section):
    """The whole file: what is required of connections, which is nothing without it."""

    tls_server_config: Annotated[TlsServer | None, BeforeValidator(_given)] = None
    basic_auth_users: dict[Annotated[bytes, PlainValidator(_name)], Annotated[bytes, PlainValidator(_hash)]] = field(
        default_factory=dict, repr=False
    )

    @property
    def tls(self) -> ssl.SSLContext | None:
        """What wraps connections, None = plain."""
        return self.tls_server_config.context if self.tls_server_config else None

    @property
    def requires_certificate(self) -> bool:
        """True if a client needs a certificate of the CA."""
        return self.tls is not None and self.tls.verify_mode is ssl.CERT_REQUIRED

    @property
    def files(self) -> tuple[Path, ...]:
        """The files that it names."""
        tls = self.tls_server_config
        return tuple(filter(None, (tls.cert_file, tls.key_file, tls.client_ca_file) if tls else ()))


_FILE = TypeAdapter(Protection)
_SECTIONS = sections_of(_FILE.json_schema())


def load_protection(http: HttpSettings, *, directory: Path) -> Protection:
    """Read and check the file that ``http.web_config`` names, if any, and its certificates.

    Parameters
    ----------
    directory : folder of the configuration, where a relative path starts

    Raises
    ------
    ConfigError
        With every fault of the file, in its order.
    """
    if http.web_config is None:
        return Protection()
    path = directory / http.web_config
    source = YamlSource(path, minimal=_MINIMAL)
    return validated(_FILE, source.data, source, sections=_SECTIONS, context={"directory": path.parent})


def _no_passphrase() -> str:
    """Refuse a passphrase; OpenSSL would ask the terminal for it."""
    raise ValueError("key_file has a passphrase, which a daemon cannot enter; decrypt it with openssl pkey")
