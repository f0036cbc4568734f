"""`arpd status`: one screen, and an exit code for scripts."""

from __future__ import annotations

import copy
import json
import time
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from arpd.adapters.systemd.services import ServiceState
from arpd.cli import main as cli
from arpd.cli.status import findings, screen
from arpd.model.endpoints import RefusalReason
from arpd.model.interface import InterfaceState
from arpd.model.link import LinkState
from arpd.model.relay import RelaySummary, RelayTopics
from tests.unit.fake_daemon import calm, demo_robot, document, event, serving


@pytest.fixture
def status(run, monkeypatch):
    """Run ``arpd status`` against a document."""
    monkeypatch.delenv("COLUMNS", raising=False)

    def status(answered, *options, code=200):
        body = answered if isinstance(answered, str) else json.dumps(answered)
        with serving(body, code) as url:
            return run("status", "--url", url, *options)

    return status


def test_the_daemon_fits_on_one_screen(status):
    """It has verdict, link, budget, plan, program and every publisher, announced and planned in one cell."""
    answered = document(config_error="arpd.yaml:1:1: x: y; z")
    answered["link"] |= {"loss_ratio": 0.004, "return_delay_seconds": 0.0042}
    answered["topics"][0] |= {
        "published_rate_hz": 11.6,
        "withheld_by_cause": {"price": 38, "rate": 12, "blocked": 0},
        "deadlines_missed": 3,
    }
    answered["verdict"]["text"] = "Not everything fits: so."
    answered["events"] = [event(1, "link fell to 5.0 Mbit/s")]
    code, out, err = status(answered)
    at = time.strftime("%H:%M:%S", time.localtime(1e9))
    assert (code, err) == (1, "")
    assert (
        out
        == f"""\
arpd 1.2.3 on wlan0, 50 ms ago; memory 512 MiB of 1 GiB available
wrong: Not everything fits: so.
wrong: Reload refused: arpd.yaml:1:1: x: y; z (the configuration in force stays).

link     5 Mbit/s (peer, congested), delivering 4.8 Mbit/s
         queueing 120 ms, loss 0.4 %, return delay 4.2 ms
         down: the queue grew
budget   4 Mbit/s, admits 50 % above the floors
plan     3 for 4.25 Mbit/s: 0 of 1 publishers confirmed
         held: dwell
         refused: up: dwell
program  degraded, bound by link, solved by osqp in 400 us
dropped  50 of 200 messages (25 %): price 38, rate 12

TOPIC   ALLOWED  SENT  SOURCE  DEPTH  DEADLINE  DROPS            CAUSES  LATE  BOUND BY
/image     12.5  11.6      30    7→8    100 ms   25 %  price:38 rate:12     3  link

{at}  link fell to 5.0 Mbit/s
"""
    )


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
    """The fault is on the screen; with --json it is on stderr."""
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


def test_the_demo_robots_status_fits_a_terminal_of_80_by_24():
    """A dozen topics and a failed interface neither scroll nor wrap."""
    answered = calm(publishers=demo_robot(), interface_state=InterfaceState.NO_CARRIER)
    answered["plan"] |= {"reason": "", "refusals": []}
    answered["events"] = [event(number, "link fell to 4.8 Mbit/s: " + "/a 30 → 2 Hz, " * 9) for number in range(50)]
    lines = screen(answered, width=80, height=24).splitlines()
    assert len(lines) < 24
    assert max(map(len, lines)) <= 80
    assert sum("/link/" in line or "…" in line for line in lines) >= 11
    assert "DEPTH" in next(line for line in lines if line.startswith("TOPIC"))


RELAY = RelaySummary(
    other_host="ceddp",
    is_reachable=True,
    to_ceddp=RelayTopics(offered=14, wanted=4),
    to_robot=RelayTopics(offered=3, wanted=1),
)


def test_a_relay_with_two_ends_has_a_line(status):
    """It says what crosses, and what went wrong where something did."""
    _, out, _ = status(calm(relay=RELAY))
    assert "\nrelay    4 of 14 topics cross to the CEDDP (ceddp), 1 of 3 to the robot\n" in out
    _, out, _ = status(calm(relay=RelaySummary()))
    assert "\nrelay    0 of 0 topics wait to cross to the CEDDP, 0 of 0 to the robot\n" in out
    troubled = replace(
        RELAY, incomplete=40, calls_failed={"timeout": 2, "type": 1}, strangers=("rviz",), types_differ={"/a": "A, B"}
    )
    _, out, _ = status(calm(relay=troubled))
    line = next(line for line in out.splitlines() if line.startswith("relay"))
    assert line.split("; ")[1:] == [
        "40 samples of incomplete groups dropped",
        "3 calls failed",
        "1 topics with two types",
        "1 nodes in the link domain that are not arpd's",
    ]


def test_readers_that_no_plan_touches_are_counted(status):
    """A relay has one for every topic; those that are planned, or refuse to be, have a line each."""
    answered = calm()
    reader = {"topic": "/a", "node": "/n", "planned": None, "confirmed": {"depth": 10}, "refusal": ""}
    answered["readers"] = [reader] * 3
    assert "\nreaders that no plan touches: 3\n" in status(answered)[1]
    answered["readers"].append(reader | {"topic": "/b", "planned": {"depth": 5, "deadline_ns": 10**8}})
    assert (
        "\n/b            10        5      none   100 ms  /n\nreaders that no plan touches: 3\n" in status(answered)[1]
    )


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


@pytest.mark.parametrize(("command", "ended"), [(("status",), 3), (("top", "--once"), 69)])
def test_a_silent_daemon_here_is_explained_by_its_unit(run, monkeypatch, command, ended):
    """Where nothing listens on this computer, the state of the unit tells the next step."""
    failed = ServiceState(is_installed=True, is_enabled=True, active="failed", result="exit-code", exit_code=78)
    monkeypatch.setattr("arpd.adapters.systemd.services.service_states", lambda *_names: {"arpd": failed})
    with serving("{}") as url:
        pass
    code, out, err = run(*command, "--url", url)
    assert (code, out) == (ended, "")
    assert "arpd check" in err
    assert "arpd.service" not in run(*command, "--url", "http://robot.invalid:9464")[2]


def test_it_says_what_a_silent_daemon_leaves(status):
    """A lease that ends the plan shows; a plan that stays has no line."""
    said = "\nlease    after 30 s without this daemon, publishers and readers return"
    assert said in status(calm(lease_s=30.0))[1]
    assert "lease" not in status(calm())[1]


def test_it_names_a_middleware_that_cannot_swap(status):
    """Fast DDS has no line; another middleware has one that says what does not happen."""
    assert "\nrmw      rmw_x is only paced\n" in status(calm(rmw_refusal="rmw_x is only paced"))[1]
    assert "rmw" not in status(calm())[1]


def test_it_understands_an_older_daemon(status):
    """What an older daemon does not say is missing."""
    older = calm()
    for key in ("lease", "readers", "rmw", "verdict", "faults", "events"):
        older.pop(key, None)
    for key in ("readers", "readers_confirmed", "paced_only"):
        del older["plan"][key]
    for key in ("loss_ratio", "return_delay_seconds", "events"):
        older["link"].pop(key, None)
    del older["topics"][0]["confirmed"]["paced_rate_hz"]
    for key in (
        "refusal_lasts",
        "refusal_reason",
        "published_rate_hz",
        "withheld_by_cause",
        "deadlines_missed",
        "kept_ratio",
    ):
        older["topics"][0].pop(key, None)
    code, out, _ = status(older)
    assert code == 0
    assert "1 of 1 publishers confirmed\n" in out
    for newer in ("lease", "loss", "SENT", "LATE", "CAUSES"):
        assert newer not in out


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


def test_it_tells_a_refusal_for_good_from_one_that_may_pass(status):
    """A publisher that never swaps is marked; a refusal that may pass is as it came."""
    for reason, shown, counted in (
        (RefusalReason.TRANSIENT_LOCAL, "rate only: latched", " (1 by rate only) confirmed\n"),
        (RefusalReason.UNMATCHED, "  latched", "publishers confirmed\n"),
    ):
        out = status(calm(refusal="latched", refusal_reason=reason))[1]
        assert shown in out
        assert counted in out


HOSTILE = ("\x1b[2J", "\r\n\x07", "\u202e", "\x9b31m", "\ud800", "A" * 5000, "\u0301", "日本")


def leaves(document, path=()):
    """Return the path to every value of a document."""
    items = document.items() if isinstance(document, dict) else enumerate(document)
    for key, value in items:
        yield (*path, key)
        if isinstance(value, (dict, list)):
            yield from leaves(value, (*path, key))


def rich_document():
    """Return a document with something everywhere."""
    answered = calm(lease_s=3.0, refusal="it refuses", refusal_reason=RefusalReason.UNMATCHED)
    answered["readers"] = [
        {
            "topic": "/a",
            "node": "/n",
            "planned": {"depth": 1, "deadline_ns": 1},
            "confirmed": {"depth": 1},
            "refusal": "",
        }
    ]
    answered["events"] = [event(1, "text")]
    answered["faults"] = [{"text": "Reload refused: so.", "severity": "error", "wrong": True}]
    answered["topics"][0]["withheld_by_cause"] = {"rate": 3}
    return answered


RICH = rich_document()
JUNK = st.one_of(
    st.none(), st.booleans(), st.floats(), st.integers(), st.sampled_from(HOSTILE), st.just([]), st.just({})
)


@st.composite
def broken_documents(draw):
    """Return the document with values anywhere gone, or replaced by something else."""
    answered = copy.deepcopy(RICH)
    for path in draw(st.lists(st.sampled_from(list(leaves(RICH))), max_size=6)):
        holder = answered
        for key in path[:-1]:
            holder = holder[key] if isinstance(holder, dict) and key in holder else None
            if not isinstance(holder, (dict, list)):
                break
        if isinstance(holder, dict):
            if draw(st.booleans()):
                holder.pop(path[-1], None)
            else:
                holder[path[-1]] = draw(JUNK)
    return answered


@given(broken_documents(), st.integers(1, 200))
def test_whatever_answers_neither_breaks_the_screen_nor_steers_the_terminal(answered, width):
    """Keys that are missing or hold something else leave a gap; control characters are shown, not sent."""
    findings(answered)
    shown = screen(answered, width=width, height=24)
    assert all(character.isprintable() or character == "\n" for character in shown)


def test_a_terminal_without_unicode_gets_question_marks(monkeypatch):
    """A character set without arrows causes no traceback."""
    import io
    import sys

    written = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    monkeypatch.setattr(sys, "stdout", written)
    with serving(json.dumps(document(publishers=demo_robot()))) as url:
        assert cli.main(["status", "--url", url]) == 0
    written.seek(0)
    assert "TOPIC" in written.read()


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
