"""Certificates, web-configs and a real server for the tests of HTTP's exposure."""

from __future__ import annotations

import socket
import ssl
import subprocess
from contextlib import contextmanager, suppress
from http.client import HTTPConnection, HTTPSConnection
from types import SimpleNamespace

from prometheus_client import CollectorRegistry

from arpd.web.http_metrics import HttpCounts
from arpd.web.server import HttpServer

HASH = "$2b$04$V6AVDWFlCxZ0TMny6MV7/OWaCOypm86N.zgDpkWCy0lTN9.r63kki"
PASSWORD = "correct horse"


def make_certificate(folder, name, *, issuer="", extensions=("subjectAltName=DNS:localhost,IP:127.0.0.1",)):
    """Make name.crt and name.key, self-signed or issued by another made here."""
    command = ["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes"]
    command += ["-days", "3650", "-subj", f"/CN={name}", "-keyout", f"{name}.key", "-out", f"{name}.crt"]
    for extension in extensions:
        command += ["-addext", extension]
    if issuer:
        command += ["-CA", f"{issuer}.crt", "-CAkey", f"{issuer}.key"]
    subprocess.run(command, cwd=folder, check=True, capture_output=True)


class Clock:
    """A clock that a test sets."""

    now_s = 0.0

    def __call__(self):
        return self.now_s


class Running:
    """A server under a web-config, and a client for it."""

    def __init__(self, server, counts):
        self.server, self.counts = server, counts
        self.address = ("127.0.0.1", server.port)

    def get(self, path="/-/healthy", *, tls=None, method="GET", **headers):
        connection = (
            HTTPSConnection("localhost", self.server.port, timeout=60.0, context=tls)
            if tls
            else HTTPConnection("127.0.0.1", self.server.port, timeout=60.0)
        )
        try:
            connection.request(method, path, headers=headers)
            answer = connection.getresponse()
            raw = answer.read()
            return SimpleNamespace(
                status=answer.status, headers=answer.headers, raw=raw, text=raw.decode(errors="replace")
            )
        finally:
            connection.close()

    def send(self, data, *, end=True):
        """Send bytes, and perhaps their end, and return all that comes back."""
        with socket.create_connection(self.address, timeout=60.0) as raw:
            try:
                raw.sendall(data)
                if end:
                    with suppress(OSError):  # a server that has refused already leaves no connection to half-close
                        raw.shutdown(socket.SHUT_WR)
                return raw.makefile("rb").read()
            except ConnectionError:
                return b""

    def count(self, name, **labels):
        registry = CollectorRegistry()
        registry.register(self.counts)
        return registry.get_sample_value(name, labels)


@contextmanager
def running(folder=None, text=None, *, snapshot=lambda: None, collector=None, **options):
    """Run a server, under a web-config of ``text`` in ``folder`` if there is one."""
    path = None
    if text is not None:
        path = folder / "web.yaml"
        path.write_text(text)
    counts, registry = HttpCounts(), CollectorRegistry()
    registry.register(counts)
    if collector is not None:
        registry.register(collector)
    server = HttpServer("127.0.0.1", 0, snapshot=snapshot, registry=registry, web_config=path, counts=counts, **options)
    server.start()
    try:
        yield Running(server, counts)
    finally:
        server.stop()


def trusting(folder, *, client=""):
    context = ssl.create_default_context(cafile=folder / "server.crt")
    if client:
        context.load_cert_chain(folder / f"{client}.crt", folder / f"{client}.key")
    return context
