"""The HTTP server under TLS, users, floods and noise, with real sockets on loopback."""

import base64
import json
import random
import socket
import ssl
import subprocess
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import replace
from http.server import BaseHTTPRequestHandler, HTTPServer
from types import SimpleNamespace

import pytest

from arpd.cli.main import main
from arpd.web import access, server
from arpd.web.server import MAX_CONNECTIONS
from tests.unit.web_world import HASH, PASSWORD, make_certificate, running, trusting

TLS = "tls_server_config:\n  cert_file: server.crt\n  key_file: server.key\n"
USERS = f"basic_auth_users:\n  alice: {HASH}\n"
LOGIN = "Basic " + base64.b64encode(f"alice:{PASSWORD}".encode()).decode()
WRONG = "Basic " + base64.b64encode(b"alice:guess").decode()


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("network")
    make_certificate(folder, "server")
    make_certificate(folder, "renewed")
    make_certificate(folder, "ca")
    make_certificate(folder, "robot", issuer="ca")
    return folder


# -- TLS and users


def test_client_certificates_are_required(folder, status):
    """Only a client with a certificate of the CA is served; `arpd status`, which has none, says so."""
    text = f"""{TLS}
  client_auth_type: RequireAndVerifyClientCert
  client_ca_file: ca.crt
"""
    with running(folder, text) as world:
        assert world.get(tls=trusting(folder, client="robot")).status == 200
        for client in ("", "server"):
            with pytest.raises((OSError, ssl.SSLError)):
                world.get(tls=trusting(folder, client=client))
        code, _, err = status(world.server.url, "--cacert", str(folder / "server.crt"))
        assert (code, "curl --cert" in err) == (3, True)


def test_every_path_asks_for_the_password(folder, caplog):
    """Every path, also a missing one, answers 401 without the password, and the journal names who sends a wrong one."""
    with running(folder, USERS) as world:
        for path in ("/", "/metrics", "/api/v1/status", "/nothing"):
            answer = world.get(path)
            assert (answer.status, answer.text) == (401, "401 Unauthorized\n")
            assert answer.headers["WWW-Authenticate"].startswith('Basic realm="arpd"')
        assert world.get("/nothing", Authorization=LOGIN).status == 404
        assert world.get(Authorization=LOGIN).status == 200
        assert world.get(Authorization=WRONG).status == 401
        got = {
            v: world.count("arpd_http_authentications_total", result=v) for v in ("missing", "ok", "cached", "wrong")
        }
        assert got == {"missing": 4, "ok": 1, "cached": 1, "wrong": 1}
        assert world.count("arpd_http_requests_total", path="other", code="401") == 1
        assert world.count("arpd_http_requests_total", path="/", code="200") == 1
        while (answer := world.get(Authorization=WRONG)).status == 401:
            pass
        assert (answer.status, answer.headers["Retry-After"]) == (429, "5")
        assert caplog.text.count("a wrong password from 127.0.0.1") == 1
        assert world.get(Authorization=LOGIN).status == 200


# -- arpd status


@pytest.fixture
def status(capsys, monkeypatch):
    def status(url, *options, password=PASSWORD):
        monkeypatch.setenv("ARPD_PASSWORD", password)
        code = main(["status", "--url", url.replace("127.0.0.1", "localhost"), "--json", *options])
        return code, *capsys.readouterr()

    return status


def test_status_reads_a_protected_daemon(folder, status, sample_snapshot, monkeypatch):
    """`arpd status` takes CA and name as options, and the password from the environment only."""
    stopped = replace(sample_snapshot, finished_at_s=time.monotonic() - 3600.0)  # before this machine booted, perhaps
    with running(folder, TLS + USERS, snapshot=lambda: stopped) as world:
        right = ("--cacert", str(folder / "server.crt"), "--user", "alice")
        url = world.server.url
        code, out, _ = status(url, *right)
        assert (code, json.loads(out)["api_version"]) == (1, "v1")
        for options, password, wrong in (
            (right, "guess", "the password of alice"),
            (right[:2], "", "--user NAME"),
            (("--user", "alice"), PASSWORD, "not trusted"),
            (("--cacert", str(folder / "renewed.crt")), "", "not trusted"),
        ):
            code, out, err = status(url, *options, password=password)
            assert (code, out) == (3, "")
            assert wrong in err
        monkeypatch.delenv("ARPD_PASSWORD")
        assert main(["status", "--user", "alice"]) == 2
        assert status(url, "--cacert", str(folder / "no.crt"))[0] == 2
        code, _, err = status(url.replace("https", "http"))
        assert (code, "write https://" in err) == (3, True)


def test_status_names_the_clocks_where_a_certificate_is_not_valid_now(folder, status):
    """A robot that boots in 1970 takes every certificate for one of the future; its CA would change nothing."""
    again = ["openssl", "x509", "-in", "server.crt", "-signkey", "server.key", "-days", "-1", "-out", "expired.crt"]
    subprocess.run(again, cwd=folder, check=True, capture_output=True)
    with running(folder, TLS.replace("server.crt", "expired.crt")) as world:
        code, _, err = status(world.server.url, "--cacert", str(folder / "expired.crt"))
        assert (code, "compare the clocks of both computers" in err, "--cacert" in err) == (3, True, False)


def test_status_asks_for_a_name_of_the_certificate(folder, status):
    """Where the certificate is the robot's, and the address another one of its names, a CA would change nothing."""
    make_certificate(folder, "named", names="DNS:robot.local")
    with running(folder, TLS.replace("server.", "named.")) as world:
        code, _, err = status(world.server.url, "--cacert", str(folder / "named.crt"))
        assert (code, "a name that it has in --url" in err, "--cacert" in err) == (3, True, False)


def test_status_gives_its_password_to_nobody_else(folder, status):
    """If the daemon's address leads elsewhere, `arpd status` says so, and does not go there."""
    seen = []

    class Elsewhere(BaseHTTPRequestHandler):
        def do_GET(self):
            seen.append(self.headers["Authorization"])
            self.send_response(302 if self.path == "/api/v1/status" else 404)
            self.send_header("Location", "/elsewhere")
            self.end_headers()

        def log_message(self, *_arguments):
            pass

    with HTTPServer(("127.0.0.1", 0), Elsewhere) as server:
        threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01}, daemon=True).start()
        assert status(f"http://127.0.0.1:{server.server_port}", "--user", "alice")[0] == 3
        server.shutdown()
    assert seen == [LOGIN]


# -- floods and noise


def test_a_trickle_does_not_hold_a_connection(folder, monkeypatch):
    """The deadline covers all bytes of a head together, a handshake included."""
    monkeypatch.setitem(server._LIMITS, "idle_connection_timeout", 0.2)
    with running(folder) as world, socket.create_connection(world.address, timeout=60.0) as raw:
        raw.settimeout(0.05)
        with suppress(ConnectionError):
            while True:
                raw.sendall(b"A")
                with suppress(TimeoutError):
                    if raw.recv(1) == b"":
                        break


def test_a_change_of_users_ends_the_connections_of_before(folder, monkeypatch):
    """Nobody keeps an access that is gone, neither by a password nor by a connection that is still open."""
    monkeypatch.setattr(server, "_LOOK_S", 0.02)
    with running(folder, f"basic_auth_users: {{bob: {HASH}}}\n") as world:
        with socket.create_connection(world.address, timeout=60.0) as raw:
            raw.sendall(b"GET / HTTP/1.1\r\nHost: x\r\n\r\n")
            answer = raw.makefile("rb")
            assert answer.readline().startswith(b"HTTP/1.1 401")
            assert world.get(Authorization=LOGIN).status == 401
            (folder / "web.yaml").write_text(USERS)
            answer.read()  # to its end
        assert world.get(Authorization=LOGIN).status == 200


def test_a_page_of_another_name_reads_nothing(folder, monkeypatch):
    """A browser that a foreign name has led to this computer (DNS rebinding) is refused by the Host header."""
    name = "arpd-test"
    monkeypatch.setattr(socket, "gethostname", lambda: name)
    own = ("localhost:9464", "127.0.0.1", "[fe80::1%25wlan0]:9464", "robot", "robot.local:9464", "robot.example.com")
    others = ("rebound.example:9464", *(f"{name}.rebound.example" for name in ("robot", "127.0.0.1", "localhost")))
    with running(folder) as world:
        assert world.get("/api/v1/history", Host="arpd-test.local").status == 200
        name = "Robot.example.com"  # DHCP gave it another one
        for host in (*own, *others, "arpd-test"):
            assert world.get("/api/v1/history", Host=host).status == (200 if host in own else 421), host
        monkeypatch.setattr(socket, "getfqdn", lambda: "Robot.example.org")  # a name server is there now
        monkeypatch.setattr(access, "time", SimpleNamespace(monotonic=lambda: time.monotonic() + 60.0))
        assert world.get("/api/v1/history", Host="robot.example.org").status == 200


@pytest.mark.parametrize(("text", "part"), [(None, b"GET / HT"), (TLS, b"\x16\x03\x01\x02\x00")])
def test_a_scrape_gets_through_a_flood_of_half_open_connections(folder, text, part):
    """A thousand connections that send nothing or a part of a request evict each other, and cost no threads."""
    with running(folder, text) as world:
        tls = trusting(folder) if text else None
        assert world.get(tls=tls).status == 200
        before = threading.active_count()
        flood = []
        try:
            for number in range(1000):
                raw = socket.create_connection(world.address, timeout=60.0)
                with suppress(ConnectionError):
                    raw.sendall(b"" if number % 2 else part)
                flood.append(raw)
                if number % 100 == 99:
                    assert world.get(tls=tls).status == 200
            assert threading.active_count() <= before + 6
        finally:
            for raw in flood:
                raw.close()
        assert world.count("arpd_http_connections_evicted_total") >= 1000 - MAX_CONNECTIONS


def test_a_name_server_that_is_silent_keeps_no_scrape_out(monkeypatch):
    """However many ask by another name, who asks by an address waits for none of them."""
    answers = threading.Event()
    monkeypatch.setattr(access, "_own_names", lambda *_: answers.wait(60.0) and frozenset())
    with running() as world, ThreadPoolExecutor(MAX_CONNECTIONS // 2) as threads:
        others = [threads.submit(world.get, Host="rebound.example") for _ in range(MAX_CONNECTIONS // 2)]
        assert world.get("/metrics").status == 200
        answers.set()
        assert {each.result().status for each in others} == {421}


NOISE = 1000
GOOD = b"GET /metrics HTTP/1.1\r\nHost: x\r\nAuthorization: " + WRONG.encode() + b"\r\n\r\n"
PIECES = (
    *b"GET|HEAD|POST| |/|/metrics|/../../etc/passwd|HTTP/1.1|HTTP/9.9|\r\n|\n|Host: x\r\n|%00%2e%2e|\0".split(b"|"),
    *b"Authorization: Basic |Content-Length: 99999999999\r\n|Transfer-Encoding: chunked\r\n".split(b"|"),
    *(WRONG.encode(), LOGIN.encode()[:-3], b"A" * 5000, b"A: b\r\n" * 80),
)


def noise(rng):
    """Return random bytes, a mix of pieces, or a request with a part replaced by random bytes."""
    at, end = sorted(rng.sample(range(len(GOOD)), 2))
    junk = rng.randbytes(rng.randrange(400))
    return rng.choice([junk, b"".join(rng.choices(PIECES, k=rng.randrange(12))), GOOD[:at] + junk[:5] + GOOD[end:]])


def test_noise_breaks_nothing_and_learns_nothing(folder, caplog, capfd):
    """After any bytes the next good request is served; no answer shows a path, traceback, hash or password."""
    rng = random.Random(6)
    secrets = (str(folder).encode(), b"Traceback", b"site-packages", HASH.encode(), WRONG[6:].encode(), b"etc/passwd")
    with running(folder, USERS) as world:
        assert world.get(Authorization=LOGIN).status == 200
        for number in range(NOISE):
            answer = world.send(noise(rng))
            assert not answer or answer.startswith(b"HTTP/1.1 ")
            assert answer.split(b" ", 2)[1:2] != [b"500"]
            assert not [secret for secret in secrets if secret in answer]
            if number % 100 == 0:
                assert world.get(Authorization=LOGIN).status == 200
        assert world.get(Authorization=LOGIN).status == 200
    assert "Traceback" not in caplog.text + "".join(capfd.readouterr())
