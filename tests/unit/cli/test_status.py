"""`arpd status`: what it prints where, and an exit code for scripts."""

from __future__ import annotations

import io
import json
import sys

import pytest

from arpd.adapters.systemd.services import ServiceState
from arpd.cli import main as cli
from arpd.model.interface import InterfaceState
from arpd.model.link import LinkState
from arpd.model.relay import RelaySummary
from tests.unit.fake_daemon import HISTORY, busy, calm, demo_robot, document, event, serving


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
    code, out, err = status(calm())
    assert (code, err) == (0, "")
    assert "wrong" not in out


@pytest.mark.parametrize(
    ("answered", "said"),
    [
        (calm(is_ready=False), "Not ready"),
        (calm(now_s=17.0), "No tick finishes"),
        (calm(active_daemon="spare"), "Standing by"),
        (calm(interface_state=InterfaceState.NO_CARRIER), "The link is down: wlan0 has no carrier"),
        (calm(link_state=LinkState.OUTAGE), "The link carries nothing"),
        (calm(config_error="a.yaml:1:1: x: y; z"), "Reload refused: a.yaml:1:1: x: y; z"),
        (calm(is_relay_silent=True), "The relay on the robot is silent"),
        (calm(relay=RelaySummary(other_host="ceddp")), "The relay's ends do not meet"),
        (document(), "Not everything asked for fits"),
    ],
    ids=[
        "not ready",
        "stuck",
        "standing by",
        "no carrier",
        "outage",
        "reload refused",
        "relay silent",
        "relay cut",
        "infeasible",
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


def test_a_key_that_needs_a_restart_is_a_note(status):
    """The daemon governs, so the exit code stays 0."""
    code, out, _ = status(calm(keys_awaiting_restart=("http.port",)))
    assert code == 0
    assert "\nRestart needed: " in out
    assert "http.port" in out


def test_the_daemons_own_words_are_the_sentences(status):
    """The verdict and the faults are those of the document, in its order."""
    answered = calm()
    answered["verdict"] |= {"text": "One: so.", "wrong": False}
    answered["faults"] = [{"text": "Two: so.", "wrong": True}, {"text": "Three: so.", "wrong": False}]
    assert status(answered)[1].splitlines()[1:4] == ["One: so.", "wrong: Two: so.", "Three: so."]


def test_a_pipe_gets_whole_names_and_five_events(status):
    """A pipe gets everything uncut."""
    name = "/a" * 60
    answered = calm()
    answered["topics"][0]["topic"] = name
    answered["events"] = [event(number, f"event {number} {'x' * 200}") for number in range(9)]
    out = status(answered)[1]
    assert name in out
    assert [line.split()[2] for line in out.splitlines() if "event " in line] == ["4", "5", "6", "7", "8"]


def test_columns_in_the_environment_give_a_pipe_a_width(status, monkeypatch):
    """`watch` sets it."""
    monkeypatch.setenv("COLUMNS", "60")
    out = status(calm(publishers=demo_robot()))[1]
    assert max(map(len, out.splitlines())) <= 60


def test_json_is_the_daemons_own(status):
    """The output is the document as the daemon sent it."""
    code, out, _ = status(calm(), "--json")
    assert (code, json.loads(out)) == (0, calm())


def test_it_says_how_to_begin_when_nothing_is_managed(status):
    """Without a publisher the verdict names the next step, and there is no table."""
    code, out, _ = status(calm(publishers=()))
    assert (code, "AdaptivePublisher" in out, "TOPIC" in out) == (0, True, False)


def test_it_says_who_is_missing_for_the_capacity(status):
    """Without a peer all is well, and the screen names the unit to start."""
    code, out, _ = status(calm(peer_ages_s={}))
    assert (code, "wrong" in out, "arpd-peer" in out) == (0, False, True)


@pytest.mark.parametrize("command", [("status",), ("top", "--once")])
def test_a_silent_daemon_here_is_explained_by_its_unit(run, monkeypatch, command):
    """Where nothing listens on this computer, the state of the unit tells the next step."""
    failed = ServiceState(is_installed=True, is_enabled=True, active="failed", result="exit-code", exit_code=78)
    monkeypatch.setattr("arpd.adapters.systemd.services.service_states", lambda *_names: {"arpd": failed})
    with serving("{}") as url:
        pass
    code, out, err = run(*command, "--url", url)
    assert (code, out) == (3, "")
    assert "arpd check" in err
    assert "arpd.service" not in run(*command, "--url", "http://robot.invalid:9464")[2]


@pytest.mark.parametrize(("severity", "age_s", "exits"), [("warning", 0.1, 0), ("error", 0.1, 1), ("info", 7.0, 1)])
def test_an_older_daemon_has_its_verdict_and_its_age(status, severity, age_s, exits):
    """Without a list of faults, an error is wrong, and so is an old document."""
    older = calm() | {"age_seconds": age_s}
    del older["faults"]
    older["verdict"] = {"severity": severity, "headline": "So", "text": "So: it is."}
    code, out, _ = status(older)
    assert code == exits
    assert "So: it is." in out
    assert ("No tick finishes" in out) == (age_s > 5)


def test_a_terminal_with_ascii_only_gets_nothing_else(monkeypatch):
    """Sparklines, ellipses and arrows have a plain form."""
    written = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    monkeypatch.setattr(sys, "stdout", written)
    monkeypatch.setenv("COLUMNS", "80")
    with serving(json.dumps(busy()), history=json.dumps(HISTORY)) as url:
        assert cli.main(["status", "--url", url]) == 0
    written.seek(0)
    shown = written.read()
    assert "?" not in shown
    assert "~ra/image/compressed" in shown
    assert "__#__" in shown


@pytest.mark.parametrize("body", ['{"api_version": "v1", "ready": false}', json.dumps(calm(is_ready=False))])
def test_it_exits_1_while_the_daemon_is_not_ready(status, body):
    """A daemon that answers but does not govern is a failure, also without a screen."""
    code, out, err = status(body, code=503)
    assert code == 1
    assert "Not ready" in out + err


def test_it_exits_1_when_it_cannot_read_the_document(status):
    """A document of another version is one line of error."""
    code, _, err = status('{"api_version": "v9", "ready": true, "link": {}}')
    assert code == 1
    assert "another version" in err


@pytest.mark.parametrize(("body", "code"), [("<html>", 200), ("[]", 200), ("{}", 404), ("503 busy\n", 503)])
def test_it_exits_3_when_something_else_answers(status, body, code):
    """Only arpd's own document counts as an answer."""
    ended, out, err = status(body, code=code)
    assert (ended, out) == (3, "")
    assert "is not arpd" in err


def test_it_exits_3_when_nothing_answers(capsys, monkeypatch):
    """The message says where to look; a proxy in the environment does not matter."""
    monkeypatch.setenv("http_proxy", "http://127.0.0.1:9")
    with serving("{}") as url:
        pass
    assert cli.main(["status", "--url", url]) == 3
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith(f"arpd: no daemon answers at {url} (")
    assert "systemctl status arpd" in err


@pytest.mark.parametrize("url", ["localhost:9464", "file:///etc/passwd", "http://[::1", "http://a b/"])
@pytest.mark.parametrize("command", ["status", "top"])
def test_what_is_no_http_address_is_refused(capsys, command, url):
    """Only http:// and https:// are accepted."""
    assert cli.main([command, "--url", url, *(["--once"] if command == "top" else [])]) in {2, 3, 69}
    err = capsys.readouterr().err
    assert err.startswith("arpd: ")
    assert err.count("\n") == 1
