"""The `arpd` command: what it prints, where, and with which exit code."""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import threading
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from types import MappingProxyType, ModuleType

import pytest

from arpd import cli
from arpd.config_schema import flatten
from arpd.errors import LinkError, RosUnavailableError
from arpd.interface import InterfaceState, LinkCounters
from arpd.model import (
    Allocation,
    AllocationStatus,
    Binding,
    CapacityKind,
    Decision,
    LinkEstimate,
    LinkState,
    MemoryState,
    Observation,
    QosPlan,
    TopicAllocation,
    TopicPlan,
)
from arpd.refusal import RefusalReason
from arpd.settings import Settings
from arpd.sim.robot import DEMO_TOPICS
from arpd.snapshot import Snapshot, Totals
from arpd.version import VERSION
from arpd.web.status import status_document
from tests.sample_publishers import publisher

COMMANDS = ("run", "relay", "peer", "check", "solve", "simulate", "status")
ALIAS_BOMB = "a: &a [x, x]\nb: &b [*a, *a]\nc: &c [*b, *b]\n"


@pytest.fixture
def run(capsys):
    """Run the command line; returns exit code, stdout and stderr."""

    def run(*arguments):
        code: int | str | None
        try:
            code = cli.main([str(argument) for argument in arguments])
        except SystemExit as exiting:
            code = exiting.code
        captured = capsys.readouterr()
        return code, captured.out, captured.err

    return run


@pytest.fixture
def config(tmp_path):
    def config(text):
        path = tmp_path / "arpd.yaml"
        path.write_text(text)
        return path

    return config


def test_version_is_the_installed_one(run):
    """`--version` prints what is installed."""
    assert run("--version") == (0, f"arpd {VERSION}\n", "")


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_teaches_itself(run, command):
    """Help has a description and examples."""
    code, out, _ = run(command, "--help")
    assert code == 0
    assert f"usage: arpd {command}" in out
    assert f"examples:\n  arpd {command}" in out


@pytest.mark.parametrize("arguments", [[], ["fly"], ["solve"], ["check", "--yaml"], ["run", "--log-level", "loud"]])
def test_wrong_usage_exits_2(run, arguments):
    """What is wrong stands on stderr."""
    code, out, err = run(*arguments)
    assert (code, out) == (2, "")
    assert "arpd" in err


@pytest.mark.parametrize(
    ("text", "faults"),
    [
        ("link:\n  headroom: much\n", ["2:13: link.headroom: 'much' is not a number; write 0.05..1"]),
        ("link:\n  headrom: 0.5\n", ["2:3: link.headrom: is not a key arpd knows; did you mean headroom?"]),
        (
            "topics:\n  - name: /a\n    min_rate_hz: 50\n    max_rate_hz: 20\n",
            ["3:18: topics[0].min_rate_hz: 50.0 is above max_rate_hz 20.0; lower it or raise max_rate_hz"],
        ),
        (
            "topics:\n  - name: /a\n  - name: /a\n",
            ["3:11: topics[1].name: '/a' is already given on line 2; keep one of the two"],
        ),
        ("", ["1:1: file: is empty; a minimal one is `link: {interface: auto}`"]),
        (ALIAS_BOMB, ["1:4: yaml: anchor &a is not allowed; remove it"]),
        (
            "http: {port: x}\non_stop: 1\n",
            [
                "1:14: http.port: 'x' is not a whole number; write 0..65535",
                "2:10: on_stop: 1 is not one of the choices; write restore or keep",
            ],
        ),
    ],
    ids=["wrong type", "unknown key", "min above max", "duplicate topic", "empty", "alias bomb", "two faults"],
)
def test_a_bad_configuration_exits_78_with_one_line_per_fault(run, config, text, faults):
    """Check and run refuse the same file in the same words, before ROS is needed."""
    path = config(text)
    expected = "".join(f"{path}:{fault}\n" for fault in faults)
    assert run("check", path) == (78, "", expected)
    assert run("run", "--config", path) == (78, "", expected)


def test_an_interface_that_does_not_exist_exits_78_and_names_those_that_do(run, config):
    """The real interfaces of this host are asked for."""
    path = config("link:\n  interface: nosuch0\n")
    code, out, err = run("check", path)
    assert (code, out) == (78, "")
    assert err.startswith(f"{path}:2:14: link.interface: 'nosuch0' does not exist on this host; write auto or one of ")
    assert "lo" in err
    assert run("check", "--no-interfaces", path)[0] == 0


def test_check_says_what_a_file_changes(run, config):
    """OK comes with the difference from the defaults."""
    path = config("link: {headroom: 0.5}\ntopics: [{name: /a}]\nrelay: {topics: [{name: /b}, {name: /c}]}")
    code, out, err = run("check", path)
    assert (code, err) == (0, "")
    assert out.startswith("OK (topics: 1, relayed: 2, keys that differ from the default: 13)\n")
    assert "  link.headroom: 0.85 -> 0.5\n" in out
    everything_default = "OK (topics: 0, relayed: 0, keys that differ from the default: 0)\n"
    assert run("check", config("{}")) == (0, everything_default, "")


def test_check_speaks_json(run, config):
    """Settings in force when the file is good, faults when it is not."""
    path = config("{}")
    code, out, _ = run("check", "--json", path)
    assert code == 0
    assert json.loads(out) == {"ok": True, "file": str(path), "settings": flatten(Settings())}
    path = config("")
    code, out, err = run("check", "--json", path)
    assert (code, err) == (78, "")
    assert json.loads(out)["faults"] == [f"{path}:1:1: file: is empty; a minimal one is `link: {{interface: auto}}`"]


@pytest.fixture
def entry_point(monkeypatch):
    """Replace a long-running module's entry point by a recorder."""

    def entry_point(module, function, behaviour):
        fake = ModuleType(module)
        setattr(fake, function, behaviour)
        monkeypatch.setitem(sys.modules, module, fake)

    return entry_point


@pytest.mark.parametrize(
    ("arguments", "function", "given"),
    [
        (
            ["run", "--config", "a.yaml", "--log-level", "debug"],
            "arpd.supervisor:run_daemon",
            {"config_path": "a.yaml", "log_level": "debug"},
        ),
        (["run"], "arpd.supervisor:run_daemon", {"config_path": "/etc/arpd/arpd.yaml", "log_level": "info"}),
        (
            ["relay", "--node-name", "r"],
            "arpd.ros.relay:run_relay",
            {"config_path": "/etc/arpd/arpd.yaml", "node_name": "r", "log_level": "info"},
        ),
        (["peer"], "arpd.ros.peer:run_peer", {"interface": "auto", "name": None, "log_level": "info"}),
        (
            ["peer", "--interface", "wlan0", "--name", "laptop"],
            "arpd.ros.peer:run_peer",
            {"interface": "wlan0", "name": "laptop", "log_level": "info"},
        ),
    ],
)
def test_long_running_commands_are_handed_over(run, entry_point, arguments, function, given):
    """The command line only parses; the exit code is the module's."""
    seen = {}

    def record(**keywords):
        seen.update({key: value if value is None else str(value) for key, value in keywords.items()})
        return 7

    entry_point(*function.split(":"), record)
    assert run(*arguments)[0] == 7
    assert seen == given


@pytest.mark.parametrize(
    ("error", "code", "message"),
    [
        (LinkError("wlan0 is gone"), 1, "arpd: wlan0 is gone\n"),
        (RosUnavailableError("rclpy is not here"), 69, "arpd: rclpy is not here\n"),
        (KeyboardInterrupt(), 130, ""),
    ],
)
def test_errors_become_one_line_and_an_exit_code(run, entry_point, error, code, message):
    """No traceback for what arpd raises on purpose, nor for Ctrl-C."""

    def fail(**_keywords):
        raise error

    entry_point("arpd.ros.peer", "run_peer", fail)
    assert run("peer") == (code, "", message)


def test_a_bug_is_not_hidden(run, entry_point):
    """What arpd does not raise on purpose keeps its traceback."""

    def fail(**_keywords):
        raise ZeroDivisionError

    entry_point("arpd.ros.peer", "run_peer", fail)
    with pytest.raises(ZeroDivisionError):
        run("peer")


def test_a_closed_pipe_is_quiet(config):
    """`arpd check | true` prints no traceback."""
    reader, writer = os.pipe()
    os.close(reader)
    ran = subprocess.run(
        [sys.executable, "-m", "arpd", "check", config("{}")],
        stdout=writer,
        stderr=subprocess.PIPE,
        check=False,
    )
    os.close(writer)
    assert (ran.returncode, ran.stderr) == (141, b"")


def test_check_needs_neither_ros_nor_solvers(config):
    """Checking a file is fast, and works on any computer."""
    script = (
        "import sys; from arpd.cli import main; main(); print(sorted({'rclpy', 'osqp', 'cvxpy'} & set(sys.modules)))"
    )
    ran = subprocess.run(
        [sys.executable, "-c", script, "check", config("{}")], capture_output=True, text=True, check=True
    )
    assert ran.stdout.splitlines()[-1] == "[]"


TABLE_2 = {100: (7, 365), 200: (15, 390), 500: (40, 405), 1000: (82, 410)}


@pytest.mark.parametrize(("rmax", "published"), TABLE_2.items())
@pytest.mark.parametrize("backend", ["exact", "osqp"])
def test_solve_gives_the_published_table(run, backend, rmax, published):
    """All rows of Table 2, from either back end."""
    code, out, err = run("solve", "--rmax", rmax, "--sensing", 11, "--actuation", 1, "--backend", backend, "--json")
    answer = json.loads(out)
    assert (code, err) == (0, "")
    assert (answer["rate_hz_floor"], answer["depth_floor"]) == published
    assert answer["status"] == "optimal"
    assert answer["backend"] == backend
    assert {"rate_hz", "depth", "deadline_ns", "depth_applied", "binding"} <= set(answer)
    assert answer["rate_hz"] == pytest.approx(rmax / 12 - 1, rel=1e-5)


def test_solve_explains_its_answer(run):
    """A sentence and a small table."""
    code, out, err = run("solve", "--rmax", 100, "--sensing", 11, "--actuation", 1, "--backend", "exact")
    assert (code, err) == (0, "")
    assert out.startswith("12 topics share Rmax 100 Hz: publish each at 7 Hz with a history of 365 samples.\n")
    assert "136363637 ns" in out
    assert "solved by exact" in out


def test_solve_exits_1_with_the_reason_when_infeasible(run):
    """The constraint that cannot be met is named, in words and in JSON."""
    arguments = ("solve", "--rmax", 100, "--sensing", 80, "--actuation", 1)
    code, out, err = run(*arguments)
    assert (code, out) == (1, "")
    assert err.startswith("arpd: infeasible: (2) leaves ")
    code, out, _ = run(*arguments, "--json")
    assert code == 1
    assert json.loads(out)["status"] == "infeasible"


@pytest.mark.parametrize(
    "changed",
    [["--rmax", "nan"], ["--rmax", "0"], ["--sensing", "-1"], ["--sensing", "0"], ["--dmin", "9", "--dmax", "3"]],
)
def test_solve_refuses_nonsense_as_usage(run, changed):
    """Numbers that mean nothing exit 2."""
    code, out, err = run("solve", "--rmax", 100, "--sensing", 11, "--actuation", 0, *changed)
    assert (code, out) == (2, "")
    assert err.startswith("arpd: ")


def test_solve_names_a_back_end_that_is_not_installed(run, monkeypatch):
    """A missing library is no traceback."""
    monkeypatch.setitem(sys.modules, "arpd.solvers.cvxpy_", None)
    code, _, err = run("solve", "--rmax", 100, "--sensing", 11, "--actuation", 1, "--backend", "cvxpy")
    assert code == 2
    assert "try --backend exact" in err


@contextmanager
def serving(body, code=200):
    class Handler(BaseHTTPRequestHandler):
        def do_GET(self):
            self.send_response(code if self.path == "/api/v1/status" else 404)
            self.end_headers()
            self.wfile.write(body.encode())

        def log_message(self, *_arguments):
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_address[1]}"
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


def document(**changes):
    camera = publisher(
        "/camera",
        "/image",
        source_rate_hz=30.0,
        offered=200,
        published=150,
        withheld=50,
        rate_hz=12.5,
        depth=7,
        deadline_ns=100_000_000,
        generation=3,
        refusal=changes.pop("refusal", ""),
        refusal_reason=changes.pop("refusal_reason", RefusalReason.NONE),
    )
    plan = TopicPlan(rate_hz=12.5, min_rate_hz=1.0, deadline_ns=100_000_000, depth=8)
    allocation = TopicAllocation(
        name="/image",
        share=0.5,
        max_rate_hz=25.0,
        rate_hz=12.5,
        depth=8.2,
        deadline_ns=80_000_000,
        depth_applied=8,
        binding=Binding.LINK,
        depth_binding=Binding.LATENCY_BUDGET,
    )
    snapshot = Snapshot(
        version="1.2.3",
        interface="wlan0",
        finished_at_s=10.0,
        unix_time_s=1e9,
        tick_s=0.002,
        observation=Observation(
            now_s=10.0,
            counters=LinkCounters(
                interface="wlan0",
                rx_bytes=0,
                tx_bytes=0,
                rx_packets=0,
                tx_packets=0,
                tx_dropped=0,
                state=changes.pop("interface_state", InterfaceState.UP),
            ),
            reports=(),
            publishers=changes.pop("publishers", (camera,)),
            memory=MemoryState(total_bytes=2**30, available_bytes=2**29),
            sensing_topics=1,
            actuation_topics=0,
            rmw="rmw_x",
            rmw_refusal=changes.pop("rmw_refusal", ""),
        ),
        link=LinkEstimate(
            capacity_bytes_per_second=625_000.0,
            kind=CapacityKind.PEER,
            state=LinkState.CONGESTED,
            queue_delay_s=0.12,
            delivery_rate_bytes_per_second=600_000.0,
            age_s=0.1,
            evidence="down: the queue grew",
        ),
        allocation=Allocation(
            topics=(allocation,),
            status=AllocationStatus.DEGRADED,
            binding=Binding.LINK,
            capacity_bytes_per_second=5e5,
            degradation="reserve of depth",
            backend="osqp",
            solve_s=0.0004,
        ),
        decision=Decision(
            gate=0.5,
            plan=QosPlan(generation=3, topics=MappingProxyType({"/image": plan}), level_bytes_per_second=531_250.0),
            level_changed=False,
            reason="held: dwell",
            refusals=("up: dwell",),
        ),
        totals=Totals(),
        config_error=changes.pop("config_error", ""),
        confirmed=0,
        lease_s=changes.pop("lease_s", 0.0),
    )
    return status_document(snapshot, now_s=10.05, **changes)


def test_status_fits_the_daemon_on_one_screen(run):
    """Link, gate, plan and every publisher, planned beside confirmed."""
    with serving(json.dumps(document(config_error="arpd.yaml:1:1: x: y; z"))) as url:
        code, out, err = run("status", "--url", f"{url}/")
    assert (code, err) == (0, "")
    assert (
        out
        == """\
arpd 1.2.3 on wlan0, 50.0 ms ago

link     5.00 Mbit/s (peer, congested), delivering 4.80 Mbit/s, queueing 120 ms
         down: the queue grew
gate     0.5
plan     3 for 4.25 Mbit/s: 0 of 1 publishers confirmed
         held: dwell
         refused: up: dwell
program  degraded, bound by link, solved by osqp in 400 us
         given up: reserve of depth
lease    the plan stays when this daemon falls silent
memory   512 MiB of 1.00 GiB available
config   the last reload was refused: arpd.yaml:1:1: x: y; z

TOPIC   RATE Hz  planned  source  DEPTH  planned  DEADLINE  planned  WITHHELD  BOUND BY
/image     12.5     12.5      30      7        8    100 ms   100 ms  50 (25%)  link
"""
    )


def test_status_says_why_the_interface_carries_nothing(run):
    """One line more, and only while that is so."""
    with serving(json.dumps(document(interface_state=InterfaceState.NO_CARRIER))) as url:
        faulty = run("status", "--url", url)[1].splitlines()
    with serving(json.dumps(document())) as url:
        sound = run("status", "--url", url)[1].splitlines()
    assert [line for line in faulty if line not in sound] == ["         wlan0 has no carrier"]
    assert len(faulty) == len(sound) + 1


def test_the_demo_robots_status_fits_a_terminal_of_24_lines(run):
    """A dozen topics and an interface that has failed, and nothing scrolls."""
    robot = tuple(publisher("/arpd_relay", topic.prefix + topic.name) for topic in DEMO_TOPICS)
    status = document(publishers=robot, interface_state=InterfaceState.NO_CARRIER)
    status["allocation"]["degradation"] = status["plan"]["reason"] = ""
    status["plan"]["refusals"] = []
    with serving(json.dumps(status)) as url:
        out = run("status", "--url", url)[1]
    assert len(out.splitlines()) <= 24


def test_status_prints_the_documents_json(run):
    """JSON is the daemon's own."""
    with serving(json.dumps(document())) as url:
        code, out, _ = run("status", "--url", url, "--json")
    assert code == 0
    assert json.loads(out) == document()


def test_status_says_how_to_begin_when_nothing_is_managed(run):
    """An empty table teaches."""
    with serving(json.dumps(document(publishers=()))) as url:
        assert "no publisher announces itself" in run("status", "--url", url)[1]


def test_status_says_what_a_silent_daemon_leaves(run):
    """The lease of the plan shows, in words and in the document."""
    with serving(json.dumps(document(lease_s=30.0))) as url:
        assert (
            "\nlease    after 30 s without this daemon, publishers and readers return" in run("status", "--url", url)[1]
        )
    assert document(lease_s=30.0)["lease"] == {"on_lost": "baseline", "after_seconds": 30.0}
    assert document()["lease"] == {"on_lost": "keep", "after_seconds": None}


def test_status_names_a_middleware_that_cannot_swap(run):
    """On Fast DDS nothing is said; on another middleware, what does not happen there."""
    with serving(json.dumps(document(rmw_refusal="rmw_x is paced and gated only"))) as url:
        assert "\nrmw      rmw_x is paced and gated only\n" in run("status", "--url", url)[1]
    with serving(json.dumps(document())) as url:
        assert "rmw" not in run("status", "--url", url)[1]


def test_status_understands_an_older_daemon(run):
    """What an older daemon does not tell is left out."""
    older = document()
    for key in ("lease", "readers", "rmw"):
        del older[key]
    for key in ("readers", "readers_confirmed", "paced_only"):
        del older["plan"][key]
    for key in ("refusal_lasts", "refusal_reason"):
        del older["topics"][0][key]
    with serving(json.dumps(older)) as url:
        code, out, _ = run("status", "--url", url)
    assert code == 0
    assert "0 of 1 publishers confirmed\n" in out
    assert "lease" not in out


def test_status_tells_a_refusal_for_good_from_one_that_may_pass(run):
    """What will never swap is settled and said to be paced and gated only; what may, is the refusal as it came."""
    for reason, shown, counted in (
        (RefusalReason.TRANSIENT_LOCAL, "rate and gate only: latched", " (1 by rate and gate only) confirmed\n"),
        (RefusalReason.UNMATCHED, "  latched", "publishers confirmed\n"),
    ):
        with serving(json.dumps(document(refusal="latched", refusal_reason=reason))) as url:
            out = run("status", "--url", url)[1]
        assert shown in out
        assert counted in out


def test_nothing_from_the_network_steers_the_terminal(run):
    """Control characters in names and reasons are shown, not sent."""
    with serving(json.dumps(document(refusal="\x1b[2Jgone\n!"))) as url:
        out = run("status", "--url", url)[1]
    assert "\x1b" not in out
    assert "\\x1b[2Jgone\\n!" in out


@pytest.mark.parametrize(
    ("body", "code"), [('{"api_version": "v1", "ready": false}', 503), (json.dumps(document(is_ready=False)), 200)]
)
def test_status_exits_1_while_the_daemon_is_not_ready(run, body, code):
    """A daemon that answers but does not govern is a failure."""
    with serving(body, code) as url:
        exit_code, _, err = run("status", "--url", url)
    assert exit_code == 1
    assert err.startswith("arpd: the daemon is not ready")


def test_status_exits_1_when_it_cannot_read_the_document(run):
    """Another version's document is no traceback."""
    with serving('{"api_version": "v9", "ready": true, "link": {}}') as url:
        code, _, err = run("status", "--url", url)
    assert code == 1
    assert "another version" in err


@pytest.mark.parametrize(("body", "code"), [("<html>", 200), ("[]", 200), ("{}", 404), ("503 busy\n", 503)])
def test_status_exits_69_when_something_else_answers(run, body, code):
    """Only arpd's own document counts."""
    with serving(body, code) as url:
        exit_code, out, err = run("status", "--url", url)
    assert (exit_code, out) == (69, "")
    assert "is not arpd" in err


def test_status_exits_69_when_nothing_answers(run, monkeypatch):
    """The message says what to look at; a proxy in the environment does not matter."""
    monkeypatch.setenv("http_proxy", "http://127.0.0.1:9")
    with serving("{}") as url:
        pass
    code, out, err = run("status", "--url", url)
    assert (code, out) == (69, "")
    assert err.startswith(f"arpd: no daemon answers at {url} (")
    assert "systemctl status arpd" in err


@pytest.mark.parametrize("url", ["localhost:9464", "file:///etc/passwd", "http://[::1", "http://a b/"])
def test_status_refuses_what_is_no_http_address(run, url):
    """Only HTTP is spoken, and nothing is guessed."""
    code, _, err = run("status", "--url", url)
    assert code in {2, 69}
    assert err.startswith("arpd: ")
    assert err.count("\n") == 1


def test_check_reads_the_web_config_too(run, tmp_path):
    """A web-config beside the configuration is found, and its faults are one line each as the file's own."""
    path = tmp_path / "arpd.yaml"
    path.write_text("http: {web_config: web.yaml}")
    for text, wrong in (
        ("basic_auth_users: {a: x}", "1:23: basic_auth_users.a: is not"),
        ("#", "1:1: file: is empty; a"),
    ):
        (tmp_path / "web.yaml").write_text(text)
        code, out, err = run("check", "--no-interfaces", path)
        assert (code, out) == (78, "")
        assert err.startswith(f"{tmp_path}/web.yaml:{wrong}")
    (tmp_path / "web.yaml").write_text("http_server_config: {}")
    assert run("check", "--no-interfaces", path)[0] == 0


def test_commands_in_the_help_are_those_there_are():
    """The list in this test is complete."""
    actions = [a for a in cli._parser()._actions if isinstance(a, argparse._SubParsersAction)]
    assert tuple(actions[0].choices) == COMMANDS
