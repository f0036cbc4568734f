"""The `arpd` command: its output, its errors and its exit codes."""

from __future__ import annotations

import io
import json
import subprocess
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from unittest.mock import Mock

import pytest

from arpd.cli.options import is_missing
from arpd.daemon.run import load
from arpd.host import addresses
from arpd.host.config.keys import flatten
from arpd.host.config.load import load_settings
from arpd.model.errors import ConfigError, LinkError, RosUnavailableError
from arpd.model.settings import Backend

TOPICS = "--sensing 11 --actuation 0"


@pytest.mark.parametrize(
    ("line", "word"),
    [
        ("", "arpd"),
        ("fly", "fly"),
        ("simulate", "--trace"),
        ("simulate --rate 0:8mbit --trace walk.csv", "--trace"),
        ("simulate --rate 20mbit", "--rate"),
        ("simulate --rate 0:8mbit --loss 5%", "--loss"),
        ("simulate --rate 0:8mbit --delay 30", "--delay"),
        ("simulate --rate 0:8mbit --actuation /odom", "--actuation"),
        ("topics --seconds nan", "--seconds"),
        ("topics --robot 10.0.0.1", "--suggest"),
        ("topics --suggest --base 10.0.0", "--base"),
        ("topics --suggest --base none", "--base"),
        ("topics --suggest --json", "not allowed with"),
        ("peer --name a\x07b", "--name"),
        (f"peer --name {'x' * 65}", "--name"),
        ("doctor --listen soon", "--listen"),
        ("doctor --interface nosuch0", "--interface"),
        ("relay --node-name a-b", "--node-name"),
        ("status --url localhost:9464", "--url"),
        ("status --url file:///etc/passwd", "--url"),
        ("status --url http://[::1", "--url"),
        ("status --url http://me:secret@localhost:9464", "--user NAME"),
        (f"solve --rmax nan {TOPICS}", "--rmax"),
        (f"solve --rmax 1e-320 {TOPICS} --rmin 1e-322", "--rmax"),
        (f"solve --rmax 100 {TOPICS} --dmax 99999999999999999999", "--dmax"),
        ("solve --rmax 100 --sensing 0 --actuation 0", "arpd"),
        (f"solve --rmax 100 {TOPICS} --dmin 9 --dmax 3", "arpd"),
        ("solve --config x --capacity 5mbit --rmin 5", "--rmax"),
        ("solve --config x", "--capacity"),
        ("solve --config x --capacity 5mbit --backend qp", "from 'osqp'"),
        ("solve --config x --capacity 5", "--capacity"),
        ("solve --config x --capacity 5mbit,0mbit", "8kbit"),
        ("status --cacert ca.crt --url http://robot:9464", "https://"),
    ],
)
def test_wrong_usage_exits_2(run, line, word):
    """The fault is on stderr before anything is read, measured or simulated."""
    code, out, err = run(*line.split())
    assert (code, out) == (2, "")
    assert word in err


@pytest.mark.parametrize(
    ("text", "faults"),
    [
        ("link:\n  headroom: much\n", ["2:13: link.headroom: "]),
        ("link:\n  headrom: 0.5\n", ["2:3: link.headrom: "]),
        ("", ["1:1: file: "]),
        ("http: {port: x}\non_stop: 1\n", ["1:14: http.port: ", "2:10: on_stop: "]),
    ],
    ids=["wrong type", "unknown key", "empty", "two faults"],
)
def test_a_bad_configuration_exits_78_with_one_line_per_fault(run, config, text, faults):
    """Check and run refuse the same file in the same words, before ROS is needed."""
    path = config(text)
    code, out, err = run("check", path)
    assert (code, out) == (78, "")
    assert all(line.startswith(f"{path}:{fault}") for line, fault in zip(err.splitlines(), faults, strict=True))
    assert run("run", "--config", path) == (code, out, err)
    code, out, told = run("check", "--json", path)
    assert (code, json.loads(out)["faults"], told) == (78, err.splitlines(), "")


def test_the_interface_of_the_file_is_one_of_this_host(run, config):
    """The far end has other ones, and an option says that the file is for another computer."""
    path = config("link: {interface: nosuch0}")
    assert [
        run("check", *options, path)[0] for options in ((), ("--no-interfaces",), ("--late-interface",), ("--far",))
    ] == [78, 0, 0, 0]


def test_check_says_what_differs_from_the_defaults(run, config):
    """After OK come the keys that the file changes, of a topic its own alone; as JSON it is every key."""
    own = "relay: {link_domain: 77, robot: 10.0.0.1}, topics: [{name: /scan, weight: 2, min_rate_hz: 5}, {name: /odom}]"
    path = config(f"{{defaults: {{max_depth: 9}}, {own}}}")
    code, out, err = run("check", path)
    assert (code, out.split()[0], err) == (0, "OK", "")
    assert [line.strip() for line in out.splitlines()[1:]] == [
        "defaults.max_depth: 5000 -> 9",
        "topics[/scan].weight: 1.0 -> 2.0",
        "topics[/scan].min_rate_hz: not set -> 5.0",
        "relay.link_domain: none -> 77",
        "relay.robot: none -> 10.0.0.1",
    ]
    code, out, _ = run("check", "--json", path)
    assert (code, json.loads(out)["settings"]) == (0, flatten(load_settings(path, interfaces=None)))


def test_check_knows_the_domain_of_this_computers_nodes(run, config, monkeypatch):
    """A link domain that the local nodes use is a fault on either end."""
    monkeypatch.setenv("ROS_DOMAIN_ID", "77")
    path = config("relay: {link_domain: 77, robot: 10.0.0.1}")
    for options in ((), ("--far",), ("--no-interfaces",)):
        code, out, err = run("check", *options, path)
        assert (code, out) == (78, "")
        assert err.startswith(f"{path}:1:22: relay.link_domain: 77 ")
    monkeypatch.setenv("ROS_DOMAIN_ID", "7")
    assert run("check", path)[0] == 0


def test_check_knows_this_computers_addresses(run, config, monkeypatch):
    """One that stands for the other end is a fault there, as when arpd starts; not where the file is for another."""
    monkeypatch.setattr(addresses, "ends_of_route", lambda name: ("10.0.0.1", name))
    path = config("relay: {link_domain: 77, base: 10.0.0.1}")
    code, out, err = run("check", path)
    assert (code, out) == (78, "")
    assert err.startswith(f"{path}:1:32: relay.base: 10.0.0.1 is an address of this computer, where arpd-peer ")
    assert [run("check", option, path)[0] for option in ("--far", "--no-interfaces")] == [0, 0]
    assert run("check", "--late-interface", path)[0] == 78
    with pytest.raises(ConfigError, match=r"relay.base: 10.0.0.1 is an address of this computer"):
        load(Path(path))  # so a reload is refused as well


@pytest.mark.parametrize(
    ("capacity", "options", "is_warned"),
    [("2mbit", (), True), ("2mbit", ("--no-interfaces",), True), ("2mbit", ("--far",), False), ("10mbit", (), False)],
)
def test_check_warns_of_minimum_rates_that_exceed_the_link(run, config, capacity, options, is_warned):
    """Floors whose payload is known must fit the capacity, less the headroom; a warning is no fault."""
    path = config(
        f"link: {{capacity: {capacity}}}\n"
        "topics: [{name: /a, payload: 60kB, source_rate_hz: 30, min_rate_hz: 4}, {name: /b, min_rate_hz: 100}]\n"
    )
    code, _, err = run("check", *options, path)
    assert (code, "topics: warning: " in err, "1.7 Mbit/s" in err) == (0, is_warned, is_warned)


@pytest.mark.parametrize(
    ("error", "code", "message"),
    [
        (LinkError("wlan0 is gone"), 1, "arpd: wlan0 is gone\n"),
        (RosUnavailableError("rclpy is not here"), 69, "arpd: rclpy is not here\n"),
        (KeyboardInterrupt(), 130, ""),
    ],
)
def test_errors_become_one_line_and_an_exit_code(run, monkeypatch, error, code, message):
    """Expected errors and Ctrl-C print no traceback."""
    peer = ModuleType("arpd.ros.peer")
    monkeypatch.setattr(peer, "run_peer", Mock(side_effect=error), raising=False)
    monkeypatch.setitem(sys.modules, peer.__name__, peer)
    assert run("peer") == (code, "", message)


@pytest.mark.parametrize("options", [[], ["--far"]])
def test_a_relay_with_nothing_to_carry_says_so(config, options):
    """It names the keys to write, stays, and ends with 0 when it is told to."""
    pytest.importorskip("rclpy", reason="ROS 2 is not installed")
    command = [sys.executable, "-m", "arpd.cli", "relay", "--config", config("link: {interface: auto}"), *options]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as relay:
        try:
            assert "relay.link_domain" in relay.stderr.readline()
        finally:
            relay.terminate()
    assert relay.returncode == 0


@pytest.mark.parametrize(
    ("command", "name", "value", "said"),
    [
        (
            "topics",
            "ROS_DOMAIN_ID",
            "233",
            "ROS 2 does not start (there is no domain above 232, and ROS_DOMAIN_ID is 233",
        ),
        ("peer", "RMW_IMPLEMENTATION", "nosuch", "RMW_IMPLEMENTATION is nosuch, and there is no such middleware here"),
    ],
)
def test_a_domain_or_middleware_that_cannot_be_is_refused_in_words(monkeypatch, command, name, value, said):
    """Either would end the process."""
    pytest.importorskip("rclpy", reason="ROS 2 is not installed")
    monkeypatch.setenv(name, value)
    ran = subprocess.run([sys.executable, "-m", "arpd.cli", command], capture_output=True, text=True, check=False)
    assert (ran.returncode, ran.stderr.startswith(f"arpd: {said}"), ran.stderr.count("\n")) == (69, True, 1)


@pytest.mark.parametrize(
    ("line", "exits", "said"),
    [("status --help", 0, "now?planned"), ("solve --rmax 100 --sensing 80 --actuation 1", 1, "Rmax/N ? Rmin")],
)
def test_a_terminal_that_lacks_a_character_gets_a_question_mark(run, monkeypatch, line, exits, said):
    """Nothing ends with a traceback in a locale without Unicode, on either stream."""
    streams = [io.TextIOWrapper(io.BytesIO(), encoding="ascii") for _ in range(2)]
    for name, stream in zip(("stdout", "stderr"), streams, strict=True):
        monkeypatch.setattr(sys, name, stream)
    assert run(*line.split())[0] == exits
    for stream in streams:
        stream.flush()
    assert said.encode() in b"".join(stream.buffer.getvalue() for stream in streams)


@pytest.mark.parametrize(
    ("line", "exits", "said"),
    [
        (f"solve --rmax 100 {TOPICS} >/dev/full", 1, b"arpd: No space left on device\n"),
        (f"solve --rmax 100 {TOPICS} >$FILE", 1, b"arpd: File too large\n"),
        ("simulate --rate 0:8mbit --duration 20s >&-", 0, b""),
        ("simulate --rate 0:8mbit --duration 20s >&- 2>&-", 0, b""),
    ],
)
def test_an_output_that_takes_nothing_ends_with_no_traceback(tmp_path, line, exits, said):
    """A full disk, or a file at its limit, is a failure, in one sentence; a closed stream is none."""
    command = f"ulimit -f 0; FILE={tmp_path}/file; {sys.executable} -m arpd.cli {line}"
    ran = subprocess.run(command, shell=True, check=False, stderr=subprocess.PIPE)
    assert (ran.returncode, ran.stderr) == (exits, said)


TABLE_2 = {100: (7, 365), 200: (15, 390), 500: (40, 405), 1000: (82, 410)}


@pytest.mark.parametrize("backend", Backend)
def test_solve_gives_the_published_table(run, backend):
    """Every back end gives all rows of Table 2."""
    for rmax, published in TABLE_2.items():
        code, out, err = run("solve", "--rmax", rmax, "--sensing", 11, "--actuation", 1, "--backend", backend, "--json")
        answer = json.loads(out)
        assert (code, err, answer["status"], answer["backend"]) == (0, "", "optimal", backend)
        assert (answer["rate_hz_floor"], answer["depth_floor"]) == published
        assert answer["rate_hz"] == pytest.approx(rmax / 12 - 1, rel=1e-6)


def test_what_is_infeasible_says_so_as_json_too(run):
    """The exit code is 1, as it is for text."""
    code, out, _ = run("solve", "--rmax", 100, "--sensing", 80, "--actuation", 1, "--json")
    assert (code, json.loads(out)["status"]) == (1, "infeasible")


def test_check_reads_the_web_config_too(run, tmp_path):
    """A fault of a web-config beside the file is a line like the file's own."""
    (tmp_path / "arpd.yaml").write_text("http: {web_config: web.yaml}")
    (tmp_path / "web.yaml").write_text("basic_auth_users: {a: x}")
    code, out, err = run("check", tmp_path / "arpd.yaml")
    assert (code, out, err.startswith(f"{tmp_path}/web.yaml:1:23: basic_auth_users.a: ")) == (78, "", True)


def test_a_file_in_a_folder_that_is_closed_is_not_missing(tmp_path):
    """Who may not look whether it is there hears that it cannot be read, and gets no defaults."""
    closed = SimpleNamespace(stat=Mock(side_effect=PermissionError(13, "Permission denied")))
    paths = tmp_path / "no.yaml", Path(__file__) / "no.yaml", tmp_path, closed
    assert [*map(is_missing, paths)] == [True, True, False, False]
