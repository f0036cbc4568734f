"""The keys of a web-config file of Prometheus exporters (prometheus/exporter-toolkit)."""

from __future__ import annotations

import re
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, PlainValidator

from arpd.model.kinds import choice, shown, text

if TYPE_CHECKING:
    from collections.abc import Mapping

MAX_COST = 14  # each step doubles the time of bcrypt; 14 takes seconds on a Pi
_HASH = re.compile(r"\$2[aby]\$([0-9]{2})\$[./A-Za-z0-9]{53}")
_MAKE_HASH = "make one with `htpasswd -nBC 10 NAME`"

# Go's names of the TLS 1.2 ciphers that OpenSSL has, too. The TLS 1.3 ciphers are always on in both.
CIPHERS = {
    f"TLS_ECDHE_{key}_WITH_{go}": f"ECDHE-{key}-{openssl}"
    for key in ("ECDSA", "RSA")
    for go, openssl in (
        ("AES_128_GCM_SHA256", "AES128-GCM-SHA256"),
        ("AES_256_GCM_SHA384", "AES256-GCM-SHA384"),
        ("CHACHA20_POLY1305_SHA256", "CHACHA20-POLY1305"),
    )
} | dict.fromkeys(("TLS_AES_128_GCM_SHA256", "TLS_AES_256_GCM_SHA384", "TLS_CHACHA20_POLY1305_SHA256"), "")

# Keys that exporters have and arpd has not, each with the way out.
UNSUPPORTED: Mapping[tuple[str, ...], str] = {
    ("tls_server_config", "cert"): "write the certificate to a file and name it in cert_file",
    ("tls_server_config", "key"): "write the key to a file that only arpd may read and name it in key_file",
    ("tls_server_config", "client_ca"): "write the CA to a file and name it in client_ca_file",
    ("tls_server_config", "curve_preferences"): "remove it; OpenSSL chooses a curve that both sides have",
    ("rate_limit",): "remove it; arpd limits the connections of every client by itself",
}


class ClientAuth(StrEnum):
    """Values of ``client_auth_type``."""

    NONE = "NoClientCert"
    IF_GIVEN = "VerifyClientCertIfGiven"
    REQUIRED = "RequireAndVerifyClientCert"


class TlsVersion(StrEnum):
    """Versions of TLS that arpd allows."""

    TLS12 = "TLS12"
    TLS13 = "TLS13"


def _bcrypt_hash(raw: Any) -> str:
    """Accept a bcrypt hash; no message shows it, because it is a secret."""
    match = _HASH.fullmatch(raw) if isinstance(raw, str) else None
    if match is None:
        raise ValueError(f"is not a bcrypt hash; {_MAKE_HASH}")
    if not 4 <= int(match[1]) <= MAX_COST:
        raise ValueError(f"has bcrypt cost {match[1]}, arpd takes 4..{MAX_COST}; {_MAKE_HASH}")
    return match[0]


def _header(*allowed: str) -> PlainValidator:
    def read(raw: Any) -> str:
        if not isinstance(raw, str) or not re.fullmatch(r"[\x20-\x7e]{0,1000}", raw):
            raise ValueError(f"{shown(raw)} is not a header's value; write up to 1000 printable ASCII characters")
        if raw and allowed and raw not in allowed:
            raise ValueError(f"{shown(raw)} is not one of the choices; write {' or '.join(allowed)}")
        return raw

    return PlainValidator(read)


def _cipher_list(raw: Any) -> tuple[str, ...]:
    if not isinstance(raw, list) or not raw or any(not isinstance(name, str) or name not in CIPHERS for name in raw):
        raise ValueError(f"is not a list of ciphers that arpd has; remove it or choose from {', '.join(CIPHERS)}")
    return tuple(CIPHERS[name] for name in raw)


def _name_list(raw: Any) -> tuple[str, ...]:
    if not isinstance(raw, list) or not raw or not all(isinstance(name, str) and name for name in raw):
        raise ValueError("is not a list of names; write `- name` for each, or leave it out")
    return tuple(raw)


def _switch(raw: Any) -> bool:
    if not isinstance(raw, bool):
        raise ValueError(f"{shown(raw)} is neither true nor false; write one of them")  # noqa: TRY004 - pydantic's way
    return raw


_FILE = text(r"[^\0]{1,4096}", "a path", "the path of a PEM file")


class _Section(BaseModel):
    model_config = ConfigDict(strict=True, extra="forbid", frozen=True)


class TlsServer(_Section):
    """``tls_server_config``."""

    cert_file: Annotated[str, _FILE]
    key_file: Annotated[str, _FILE]
    client_auth_type: Annotated[ClientAuth, choice(ClientAuth)] = ClientAuth.NONE
    client_ca_file: Annotated[str, _FILE] = ""
    client_allowed_sans: Annotated[tuple[str, ...], PlainValidator(_name_list)] = ()
    min_version: Annotated[TlsVersion, choice(TlsVersion)] = TlsVersion.TLS12
    max_version: Annotated[TlsVersion, choice(TlsVersion)] = TlsVersion.TLS13
    cipher_suites: Annotated[tuple[str, ...], PlainValidator(_cipher_list)] = ()
    prefer_server_cipher_suites: Annotated[bool, PlainValidator(_switch)] = True


class Headers(_Section):
    """``http_server_config.headers``: headers beside or instead of arpd's own."""

    content_security_policy: Annotated[str, _header()] = Field(default="", alias="Content-Security-Policy")
    x_frame_options: Annotated[str, _header("deny", "sameorigin")] = Field(default="", alias="X-Frame-Options")
    x_content_type_options: Annotated[str, _header("nosniff")] = Field(default="", alias="X-Content-Type-Options")
    x_xss_protection: Annotated[str, _header()] = Field(default="", alias="X-XSS-Protection")
    strict_transport_security: Annotated[str, _header()] = Field(default="", alias="Strict-Transport-Security")


class HttpServerSection(_Section):
    """``http_server_config``."""

    http2: Annotated[bool, PlainValidator(_switch)] = False  # both are right: clients negotiate HTTP/2, arpd declines
    headers: Headers = Field(default_factory=Headers)


class WebDocument(_Section):
    """The whole file."""

    tls_server_config: TlsServer | None = None
    http_server_config: HttpServerSection = HttpServerSection()
    basic_auth_users: dict[str, Annotated[str, PlainValidator(_bcrypt_hash)]] = {}


# Every section by its location.
WEB_SECTIONS: Mapping[tuple[str, ...], type[BaseModel]] = {
    (): WebDocument,
    ("tls_server_config",): TlsServer,
    ("http_server_config",): HttpServerSection,
    ("http_server_config", "headers"): Headers,
}
