"""`arpd status`: what it prints where, and an exit code for scripts."""

from __future__ import annotations

import json
import socket
import threading
import time
from contextlib import contextmanager, suppress

import pytest

from arpd.cli import client
from arpd.host.services import ServiceState
from arpd.model.relay import RelaySummary
from tests.golden.sample import FINISHED_AT_S
from tests.unit.fake_daemon import document, serving


@pytest.fixture
def status(run):
    """Run ``arpd status`` against a document."""

    def status(answered, *options, code=200):
        body = answered if isinstance(answered, str) else json.dumps(answered)
        with serving(body, code) as url:
            return run("status", "--url", url, *options)

    return status


def test_all_is_well_exits_0(status):
    """A slow link that arpd copes with is well."""
    code, out, err = status(document())
    assert (code, err) == (0, "")
    assert "wrong" not in out


@pytest.mark.parametrize(
    ("answered", "said"),
    [
        (document(now_s=FINISHED_AT_S + 7.0), "No tick finishes"),
        (document(config_error="a.yaml:1:1: x: y; z"), "Reload refused: a.yaml:1:1: x: y; z"),
        (
            document(held_s=12.0, observation={"relay": RelaySummary(is_reachable=True, fault="it speaks version 2")}),
            "The relay cannot reach its other end: the base computer's end cannot be used: it speaks version 2",
        ),
    ],
)
def test_what_is_wrong_exits_1_and_is_said(status, answered, said):
    """The frame has the fault; with --json it is on stderr."""
    code, out, err = status(answered)
    assert (code, err) == (1, "")
    assert f"\nwrong: {said}" in out
    code, out, err = status(answered, "--json")
    assert (code, json.loads(out)) == (1, answered)
    assert err.startswith(f"arpd: {said}")


@pytest.mark.parametrize(
    ("body", "code", "exits", "said"),
    [
        ('{"api_version": "v1", "ready": false}', 503, 1, "Not ready"),
        ('{"api_version": "v9", "ready": true, "link": {}}', 200, 1, "another version"),
        ("<html>", 200, 3, "is not arpd"),
        ("503 busy\n", 503, 3, "is not arpd"),
        (f'{{"api_version": "v1", "link": {"[" * 900}{"]" * 900}}}', 200, 3, "is not arpd"),
        ("421 Misdirected Request\n", 421, 3, "a name of its own"),
    ],
)
def test_only_a_document_of_arpd_that_is_ready_is_well(status, body, code, exits, said):
    """A daemon that does not govern yet or has another version is a failure, and anything else no answer."""
    ended, out, err = status(body, code=code)
    assert ended == exits
    assert said in out + err


def unit(active, **fields):
    return ServiceState(**{"is_installed": True, "is_enabled": True, "active": active, **fields})


STOPPED = unit("inactive", is_enabled=False)


@pytest.mark.parametrize(
    ("robot", "other_end", "said"),
    [
        (unit("active"), "inactive", "compare http.host"),
        (unit("active", says="x; no metrics: port taken"), "inactive", "arpd has no metrics: port taken"),
        (unit("inactive", says="no metrics: port taken"), "inactive", "systemctl start arpd"),
        (unit("activating"), "inactive", "ask again"),
        (unit("deactivating"), "inactive", "restores the publishers"),
        (unit("activating", is_restarted=True, exit_code=1), "inactive", "exit code 1"),
        (unit("activating", is_restarted=True, result="success"), "inactive", "arpd failed, see journalctl -u arpd; s"),
        (unit("failed", exit_code=78, result="exit-code"), "inactive", "sudo -u arpd arpd check"),
        (unit("failed", result="watchdog"), "inactive", "watchdog"),
        (unit("inactive"), "inactive", "systemctl start arpd"),
        (STOPPED, "inactive", "systemctl enable --now arpd"),
        (unit("inactive", is_enabled=False, is_masked=True), "inactive", "systemctl unmask arpd"),
        (STOPPED, "active", "with arpd-peer@robot1: run arpd status on the robot"),
        (unit("inactive", is_enabled=False, is_installed=False), "inactive", "arpd run --config"),
    ],
)
def test_it_exits_3_when_nothing_answers_and_says_why(run, monkeypatch, robot, other_end, said):
    """On this computer the units tell the next step; a proxy in the environment does not matter."""
    monkeypatch.setenv("http_proxy", "http://127.0.0.1:9")
    units = {"arpd": robot, "arpd-peer@robot1": unit(other_end, is_enabled=False)}
    monkeypatch.setattr("arpd.host.services.service_states", lambda *_names: units)
    with serving("{}") as url:
        pass
    code, out, err = run("status", "--url", url)
    assert (code, out) == (3, "")
    assert err.startswith(f"arpd: no daemon answers at {url} (")
    assert said in err
    assert said not in run("status", "--url", "http://robot.invalid:9464")[2]


def test_a_name_that_nobody_knows_is_no_daemon_that_does_not_run(run, monkeypatch):
    """Where no name server knows the robot, its unit and its port are not what to look at."""

    def lookup(*_args, **_options):
        raise socket.gaierror(socket.EAI_NONAME, "Name or service not known")

    monkeypatch.setattr(socket, "getaddrinfo", lookup)
    code, _, err = run("status", "--url", "http://robot.example:9464")
    assert (code, "getent hosts" in err, "is it running" in err) == (3, True, False), err


def test_https_to_a_daemon_without_tls_does_not_call_it_busy(run, monkeypatch):
    """It waits for the rest of what is no request: the thing to do is to write http://, whatever its unit says."""
    monkeypatch.setattr(client, "_DEADLINE_S", 0.3)
    monkeypatch.setattr("arpd.host.services.service_states", lambda *_names: {"arpd": unit("active")})
    with socket.create_server(("127.0.0.1", 0)) as server:
        code, _, err = run("status", "--url", f"https://127.0.0.1:{server.getsockname()[1]}")
    assert (code, "write http://" in err, "too busy" in err) == (3, True, False), err


@contextmanager
def trickling(line):
    """Answer the line, then bytes of the body one by one, for as long as somebody reads them."""
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve():
            connection, _ = server.accept()
            with connection, suppress(OSError):
                connection.sendall(line)
                while True:
                    time.sleep(0.01)
                    connection.sendall(b" ")

        thread = threading.Thread(target=serve, daemon=True)
        thread.start()
        yield f"http://127.0.0.1:{server.getsockname()[1]}"
        thread.join()


@pytest.mark.parametrize(
    ("line", "said"),
    [
        (b"HTTP/1.0 200 OK\r\n\r\n", "timed out"),
        (b"HTTP/1.0 200 OK\r\nX: ", "timed out"),
        (b"x" * 100_000, "no whole answer"),
        (b"HTTP/1.0 200 OK\r\nContent-Encoding: gzip\r\n\r\nx", "no whole answer"),
    ],
    ids=range(4),
)
def test_an_answer_that_only_trickles_ends_at_one_deadline(run, monkeypatch, line, said):
    """Each byte comes in time, and the whole never does; nor does what is no HTTP become an answer."""
    monkeypatch.setattr(client, "_DEADLINE_S", 0.3)
    with trickling(line) as url:
        code, out, err = run("status", "--url", url)
        by_tls = run("status", "--url", url.replace("http", "https"))[2] if said == "timed out" else ""
    assert (code, out, said in err, err.count("\n")) == (3, "", True, 1)
    assert ("Does it speak https?" in err, "Does it speak https?" in by_tls) == (False, bool(by_tls))


@pytest.mark.parametrize("command", [["status"], ["doctor"]])
def test_a_password_does_not_cross_the_network_in_clear(run, monkeypatch, command):
    """Without TLS it goes to this computer only, or where the user says so."""
    asked = []
    monkeypatch.setenv("ARPD_PASSWORD", "secret")
    monkeypatch.setattr(client.Daemon, "_answer", lambda daemon, _path: asked.append(daemon.url))
    for url in ("http://robot.local:9464", "HTTP://192.0.2.1:9464", "http://127.0.0.1.example:9464"):
        code, out, err = run(*command, "--url", url, "--user", "alice")
        assert (code, out) == (2, "")
        assert "--password-in-clear" in err
        assert "https://" in err
    assert not asked
    wanted = ["http://127.0.0.2:1", "http://[::1]:1", "http://localhost:1", "https://robot:1", "http://robot:1"]
    for url in wanted:
        run("status", "--user", "alice", "--url", url, *(["--password-in-clear"] if url == wanted[-1] else []))
    assert asked == wanted
