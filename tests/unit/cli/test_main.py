"""The `arpd` command: its output, its errors and its exit codes."""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from types import ModuleType

import pytest

from arpd import __version__
from arpd.adapters.config.schema import flatten
from arpd.cli import main as cli
from arpd.model.errors import LinkError, RosUnavailableError
from arpd.model.settings import Settings

COMMANDS = ("run", "relay", "peer", "topics", "check", "solve", "simulate", "status", "top", "doctor")
ALIAS_BOMB = "a: &a [x, x]\nb: &b [*a, *a]\nc: &c [*b, *b]\n"


def test_version_is_the_installed_one(run):
    """`--version` prints the installed version."""
    assert run("--version") == (0, f"arpd {__version__}\n", "")


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_teaches_itself(run, command):
    """Help has a description and examples."""
    code, out, _ = run(command, "--help")
    assert code == 0
    assert f"usage: arpd {command}" in out
    assert f"examples:\n  arpd {command}" in out


@pytest.mark.parametrize("arguments", [[], ["fly"], ["solve"], ["check", "--yaml"], ["run", "--log-level", "loud"]])
def test_wrong_usage_exits_2(run, arguments):
    """The fault is on stderr."""
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
    """The file is checked against the interfaces of this host."""
    path = config("link:\n  interface: nosuch0\n")
    code, out, err = run("check", path)
    assert (code, out) == (78, "")
    assert err.startswith(f"{path}:2:14: link.interface: 'nosuch0' does not exist on this host; write auto or one of ")
    assert "lo" in err
    assert run("check", "--no-interfaces", path)[0] == 0


def test_interfaces_that_the_kernel_does_not_list_are_not_checked(run, config, monkeypatch):
    """Where this host's interfaces are unknown, the check says so and accepts any name."""

    def refuse():
        raise OSError(38, "Function not implemented")

    monkeypatch.setattr("arpd.adapters.host.interface.socket.if_nameindex", refuse)
    code, out, err = run("check", config("link:\n  interface: nosuch0\n"))
    assert (code, out.startswith("OK"), "link.interface" in err) == (0, True, True)


def test_check_says_what_a_file_changes(run, config):
    """After OK come the keys that differ from the default."""
    path = config("link: {headroom: 0.5}\ntopics: [{name: /a}]\nrelay: {topics: [{name: /b}, {name: /c}]}")
    code, out, err = run("check", path)
    assert (code, err) == (0, "")
    assert out.startswith("OK (topics: 1, relayed: 2, keys that differ from the default: 13)\n")
    assert "  link.headroom: 0.85 -> 0.5\n" in out
    everything_default = "OK (topics: 0, relayed: 0, keys that differ from the default: 0)\n"
    assert run("check", config("{}")) == (0, everything_default, "")


TWO_ENDS = """\
relay:
  link_domain: 77
  robot: 10.0.0.1
  ceddp: 10.0.0.2
  namespace: /r1
  to_robot: [/cmd_vel, /goal]
  to_ceddp: []
  deny: [/x]
  services: ["/map/*"]
  actions: [/go]
  groups: [{topics: [/a, /b]}]
"""


def test_check_says_what_the_file_means_for_each_end(run, config):
    """After OK comes what the relay carries, and where the other end is."""
    path = config(TWO_ENDS)
    carried = "to the CEDDP nothing; to the robot /cmd_vel, /goal"
    rest = "deny /x; services /map/*; actions /go; groups /a; names on the CEDDP under /r1"
    for options, there in (((), "10.0.0.2"), (("--far",), "10.0.0.1")):
        code, out, _ = run("check", *options, path)
        assert code == 0
        told = [f"two ends: link domain 77, the other end at {there}; {carried}", rest]
        assert out.splitlines()[1:3] == told
    path = config("relay: {link_domain: 77, robot: 10.0.0.1}")
    assert "77, the other end finds this one at 10.0.0.1; to the CEDDP /**; to the robot /**\n" in run("check", path)[1]
    assert "77, the other end at 10.0.0.1; to the CEDDP /**" in run("check", "--far", path)[1]


def test_check_says_who_works_with_one_end(run, config):
    """With a prefix the far end has no relay."""
    path = config("relay: {prefix: /air, topics: [{name: /scan}]}")
    assert "\none end: the CEDDP reads the relayed topics under /air\n" in run("check", path)[1]
    assert "\none end, on the robot: the relay has nothing to do on this side\n" in run("check", "--far", path)[1]


def test_check_knows_the_domain_of_this_computers_nodes(run, config, monkeypatch):
    """A link domain that the local nodes use is a fault on either end."""
    monkeypatch.setenv("ROS_DOMAIN_ID", "77")
    path = config("relay: {link_domain: 77, robot: 10.0.0.1}")
    fault = "1:22: relay.link_domain: 77 is the domain of this computer's own nodes (ROS_DOMAIN_ID); choose another"
    for options in ((), ("--far",), ("--no-interfaces",)):
        assert run("check", *options, path) == (78, "", f"{path}:{fault}\n")
    monkeypatch.setenv("ROS_DOMAIN_ID", "7")
    assert run("check", path)[0] == 0


def test_the_far_end_ignores_what_is_the_robots(run, config):
    """Interface and web server are those of the robot."""
    path = config("link: {interface: nosuch0}\nhttp: {web_config: nosuch.yaml}")
    assert run("check", path)[0] == 78
    assert run("check", "--far", path)[0] == 0


def test_check_speaks_json(run, config):
    """A good file gives its settings, a bad one its faults."""
    path = config("{}")
    code, out, _ = run("check", "--json", path)
    assert code == 0
    assert json.loads(out) == {"ok": True, "file": str(path), "warnings": [], "settings": flatten(Settings())}
    path = config("")
    code, out, err = run("check", "--json", path)
    assert (code, err) == (78, "")
    assert json.loads(out)["faults"] == [f"{path}:1:1: file: is empty; a minimal one is `link: {{interface: auto}}`"]


OSQP, CVXPY = "link: {}\nprogram:\n  backend: osqp\n", "program: {backend: cvxpy}"


@pytest.mark.parametrize(
    ("text", "host_mib", "warning"),
    [
        (OSQP, 906, "osqp takes 14 MiB more than exact, 1.5 % of"),
        ("{}", 906, "osqp takes 14 MiB more than exact, 1.5 % of"),
        (CVXPY, 3800, "cvxpy takes 82 MiB more than exact, 2.2 % of"),
    ],
)
def test_check_warns_of_a_solver_that_takes_much_of_the_memory(run, config, host_memory, *, text, host_mib, warning):
    """A solver that takes more than a hundredth of the host's memory is no fault, but a warning."""
    host_memory(host_mib * 2**20)
    path = config(text)
    expected = f"{path}: program.backend: warning: {warning} this host's memory, for the same plans; write exact\n"
    code, out, err = run("check", path)
    assert (code, out[:4], err) == (0, "OK (", expected)
    code, out, err = run("check", "--json", path)
    assert (code, json.loads(out)["warnings"], err) == (0, [expected[:-1]], "")


@pytest.mark.parametrize(
    ("text", "host_mib"), [(OSQP, 1906), (CVXPY, 15800), ("program: {backend: exact}", 400), (CVXPY, 0)]
)
def test_check_does_not_warn_of_a_solver_that_the_host_can_afford(run, config, host_memory, text, host_mib):
    """A host with memory for its solver, or of unknown memory, is not nagged."""
    host_memory(host_mib * 2**20)
    assert run("check", config(text))[2] == ""


@pytest.mark.parametrize("option", ["--far", "--no-interfaces"])
def test_check_warns_only_on_the_robot(run, config, host_memory, option):
    """The memory of a computer that will not solve the program does not matter."""
    host_memory(400 * 2**20)
    assert run("check", option, config(CVXPY))[2] == ""


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
            "arpd.daemon.run:run_daemon",
            {"config_path": "a.yaml", "log_level": "debug"},
        ),
        (["run"], "arpd.daemon.run:run_daemon", {"config_path": "/etc/arpd/arpd.yaml", "log_level": "info"}),
        (
            ["relay", "--node-name", "r"],
            "arpd.adapters.ros.relay:run_relay",
            {"config_path": "/etc/arpd/arpd.yaml", "node_name": "r", "log_level": "info", "is_far": "False"},
        ),
        (
            ["relay", "--far"],
            "arpd.adapters.ros.relay:run_relay",
            {"config_path": "/etc/arpd/arpd.yaml", "node_name": None, "log_level": "info", "is_far": "True"},
        ),
        (
            ["peer", "--interface", "wlan0", "--name", "laptop", "--config", "a.yaml"],
            "arpd.adapters.ros.peer:run_peer",
            {"interface": "wlan0", "name": "laptop", "config_path": "a.yaml", "log_level": "info"},
        ),
    ],
)
def test_long_running_commands_are_handed_over(run, entry_point, arguments, function, given):
    """The command line only parses; the module returns the exit code."""
    seen = {}

    def record(**keywords):
        seen.update({key: value if value is None else str(value) for key, value in keywords.items()})
        return 7

    entry_point(*function.split(":"), record)
    assert run(*arguments)[0] == 7
    assert seen == given


@pytest.mark.parametrize("is_there", [True, False])
def test_a_peer_reads_the_installed_configuration_if_there_is_one(run, entry_point, config, monkeypatch, is_there):
    """A peer without a configuration is fine."""
    path = config("{}")
    if not is_there:
        path.unlink()
    monkeypatch.setattr(cli, "DEFAULT_CONFIG", path)
    seen = {}
    entry_point("arpd.adapters.ros.peer", "run_peer", lambda **keywords: seen.update(keywords) or 0)
    assert run("peer")[0] == 0
    assert seen == {
        "interface": "auto",
        "name": None,
        "config_path": path if is_there else None,
        "log_level": "info",
    }


@pytest.mark.parametrize(
    ("error", "code", "message"),
    [
        (LinkError("wlan0 is gone"), 1, "arpd: wlan0 is gone\n"),
        (RosUnavailableError("rclpy is not here"), 69, "arpd: rclpy is not here\n"),
        (KeyboardInterrupt(), 130, ""),
    ],
)
def test_errors_become_one_line_and_an_exit_code(run, entry_point, error, code, message):
    """Expected errors and Ctrl-C print no traceback."""

    def fail(**_keywords):
        raise error

    entry_point("arpd.adapters.ros.peer", "run_peer", fail)
    assert run("peer") == (code, "", message)


def test_a_bug_is_not_hidden(run, entry_point):
    """An unexpected exception keeps its traceback."""

    def fail(**_keywords):
        raise ZeroDivisionError

    entry_point("arpd.adapters.ros.peer", "run_peer", fail)
    with pytest.raises(ZeroDivisionError):
        run("peer")


def test_a_closed_pipe_is_quiet(config):
    """`arpd check | true` prints no traceback."""
    reader, writer = os.pipe()
    os.close(reader)
    ran = subprocess.run(
        [sys.executable, "-m", "arpd.cli", "check", config("{}")],
        stdout=writer,
        stderr=subprocess.PIPE,
        check=False,
    )
    os.close(writer)
    assert (ran.returncode, ran.stderr) == (141, b"")


def test_check_needs_neither_ros_nor_solvers(config):
    """A check is fast and works on any computer."""
    loaded = "print(sorted({'rclpy', 'osqp', 'cvxpy'} & set(sys.modules)))"
    script = f"import sys; from arpd.cli import main; main.main(); {loaded}"
    ran = subprocess.run(
        [sys.executable, "-c", script, "check", config("{}")], capture_output=True, text=True, check=True
    )
    assert ran.stdout.splitlines()[-1] == "[]"


TABLE_2 = {100: (7, 365), 200: (15, 390), 500: (40, 405), 1000: (82, 410)}


@pytest.mark.parametrize(("rmax", "published"), TABLE_2.items())
@pytest.mark.parametrize("backend", ["exact", "osqp"])
def test_solve_gives_the_published_table(run, backend, rmax, published):
    """Every back end gives all rows of Table 2."""
    code, out, err = run("solve", "--rmax", rmax, "--sensing", 11, "--actuation", 1, "--backend", backend, "--json")
    answer = json.loads(out)
    assert (code, err) == (0, "")
    assert (answer["rate_hz_floor"], answer["depth_floor"]) == published
    assert answer["status"] == "optimal"
    assert answer["backend"] == backend
    assert {"rate_hz", "depth", "deadline_ns", "depth_applied", "binding"} <= set(answer)
    assert answer["rate_hz"] == pytest.approx(rmax / 12 - 1, rel=1e-5)


def test_solve_explains_its_answer(run):
    """It prints a sentence and a small table."""
    code, out, err = run("solve", "--rmax", 100, "--sensing", 11, "--actuation", 1, "--backend", "exact")
    assert (code, err) == (0, "")
    assert out.startswith("12 topics share Rmax 100 Hz: publish each at 7 Hz with a history of 365 samples.\n")
    assert "136363637 ns" in out
    assert "solved by exact" in out


def test_solve_exits_1_with_the_reason_when_infeasible(run):
    """Text and JSON name the constraint that cannot be met."""
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
    """Meaningless numbers exit 2."""
    code, out, err = run("solve", "--rmax", 100, "--sensing", 11, "--actuation", 0, *changed)
    assert (code, out) == (2, "")
    assert err.startswith("arpd: ")


def test_solve_names_a_back_end_that_is_not_installed(run, monkeypatch):
    """A missing library is one line, without a traceback."""
    monkeypatch.setitem(sys.modules, "arpd.solve.cvxpy_", None)
    code, _, err = run("solve", "--rmax", 100, "--sensing", 11, "--actuation", 1, "--backend", "cvxpy")
    assert code == 2
    assert "try --backend exact" in err


def test_check_reads_the_web_config_too(run, tmp_path):
    """Faults of a web-config beside the file are one line each, like the file's own."""
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
    """The list of commands in this test is complete."""
    actions = [a for a in cli._parser()._actions if isinstance(a, argparse._SubParsersAction)]
    assert tuple(actions[0].choices) == COMMANDS
