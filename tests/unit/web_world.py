"""Certificates, web-configs and a real server for the tests of HTTP's exposure."""

import socket
import ssl
import subprocess
import threading
from contextlib import contextmanager, suppress
from dataclasses import replace
from http.client import HTTPConnection, HTTPSConnection
from pathlib import Path
from types import SimpleNamespace

from arpd.model.settings import HttpSettings
from arpd.report.history import History
from arpd.web.server import HttpServer
from tests.waiting import eventually

HASH = "$2b$04$V6AVDWFlCxZ0TMny6MV7/OWaCOypm86N.zgDpkWCy0lTN9.r63kki"
PASSWORD = "correct horse"


def make_certificate(folder, name, *, issuer="", names="DNS:localhost,IP:127.0.0.1"):
    """Make name.crt and name.key, self-signed or issued by another made here."""
    command = ["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes"]
    command += ["-days", "3650", "-subj", f"/CN={name}", "-keyout", f"{name}.key", "-out", f"{name}.crt"]
    command += ["-addext", f"subjectAltName={names}"]
    if issuer:
        command += ["-CA", f"{issuer}.crt", "-CAkey", f"{issuer}.key"]
    subprocess.run(command, cwd=folder, check=True, capture_output=True)


class Running:
    """A server under a web-config, and a client for it."""

    def __init__(self, server):
        self.server = server
        self.address = ("127.0.0.1", server.port)

    def get(self, path="/", *, tls=None, **headers):
        connection = (
            HTTPSConnection("localhost", self.server.port, timeout=60.0, context=tls)
            if tls
            else HTTPConnection("127.0.0.1", self.server.port, timeout=60.0)
        )
        try:
            connection.request("GET", path, headers=headers)
            answer = connection.getresponse()
            return SimpleNamespace(
                status=answer.status, headers=answer.headers, text=answer.read().decode(errors="replace")
            )
        finally:
            connection.close()

    def send(self, data):
        """Send bytes and their end, and return all that comes back."""
        with socket.create_connection(self.address, timeout=60.0) as raw:
            try:
                raw.sendall(data)
                with suppress(OSError):  # a server that has refused already leaves no connection to half-close
                    raw.shutdown(socket.SHUT_WR)
                return raw.makefile("rb").read()
            except ConnectionError:
                return b""

    def count(self, name, **labels):
        return self.server.registry.get_sample_value(name, labels) or 0


def server_of(http, **options):
    """Return a server; what the options do not name is there and empty, and no tick runs."""
    resting = threading.Event()
    resting.set()
    empty = {"snapshot": lambda: None, "directory": Path(), "history": History(), "durations": (), "resting": resting}
    return HttpServer(http, **empty | options)


@contextmanager
def running(folder=None, text=None, **options):
    """Run a server, under a web-config of ``text`` in ``folder`` if there is one."""
    http = HttpSettings(port=0)
    if text is not None:
        (folder / "web.yaml").write_text(text)
        http = replace(http, web_config="web.yaml")
        options["directory"] = folder
    server = server_of(http, **options)
    with server.up():
        eventually("it listens", lambda: server.port)
        yield Running(server)


def trusting(folder, *, client=""):
    context = ssl.create_default_context(cafile=folder / "server.crt")
    if client:
        context.load_cert_chain(folder / f"{client}.crt", folder / f"{client}.key")
    return context
