"""arpd as it is deployed: its units under a real systemd, on a robot and a CEDDP joined by a shaped link."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import threading
import time
import urllib.error
import urllib.request
from contextlib import ExitStack
from itertools import pairwise
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")
pytest.importorskip("pyroute2", reason="pyroute2 is not installed: pip install pyroute2")

import machine

from arpd.sim import simlink
from arpd.sim.namespaces import NETNS_DIR
from scripts.robot.proxy import window

pytestmark = [pytest.mark.link, pytest.mark.ros]

REPO = Path(__file__).parents[2]
CONFIG = REPO / "scripts/robot/arpd.yaml"
BROKEN = "\nlink:\n  headrom: 0.5\n"
HTTP_PORT = 9464
SENSORS = ("/scan/front", "/imu")
LONGEST_SILENCE_S = 4.0  # the reader counts by the second, and two shared cores stall


def installed_files(domain_id):
    """List what an installation leaves behind, with arpd and ROS from this venv."""
    units = {f"/etc/systemd/system/{unit.name}": unit for unit in REPO.glob("systemd/*.service")}
    environment = (REPO / "systemd/arpd.default").read_text() + (
        f"ARPD_ROS_SETUP=\nARPD_BIN=/usr/lib/arpd/arpd\nROS_DOMAIN_ID={domain_id}\n"
    )
    return {
        **units,
        "/usr/lib/arpd/arpd-launch": REPO / "systemd/arpd-launch",
        "/usr/lib/arpd/arpd": Path(__file__).with_name("arpd-from-checkout"),
        "/etc/default/arpd": environment,
        "/etc/arpd/arpd.yaml": CONFIG,
    }


class Reader:
    """The planner on the CEDDP, and when it heard each sensor."""

    def __init__(self, process):
        self._process = process
        self.heard_s = {topic: [] for topic in SENSORS}
        threading.Thread(target=self._read, daemon=True).start()

    def longest_silence_s(self, since_s):
        """Return the longest time until now in which a sensor was not heard."""
        return max(
            after - before
            for heard_s in self.heard_s.values()
            for before, after in pairwise([since_s, *(at_s for at_s in heard_s if at_s > since_s), time.monotonic()])
        )

    def _read(self):
        for line in self._process.stdout:
            arrived = json.loads(line)
            for topic in SENSORS:
                if arrived[topic]["rate_hz"]:
                    self.heard_s[topic].append(time.monotonic())


class Deployment:
    """A robot and a CEDDP, each with a systemd, and what runs on them beside arpd."""

    def __init__(self, robot, ceddp, reader, url):
        self.robot = robot
        self.ceddp = ceddp
        self.reader = reader
        self._url = url

    @property
    def config(self):
        return self.robot.root / "etc/arpd/arpd.yaml"

    def state(self, *properties):
        return self.robot.show("arpd", *properties)

    def status_text(self):
        return self.state("StatusText")["StatusText"]

    def is_confirmed(self):
        return f"{len(SENSORS)} of {len(SENSORS)} publishers confirmed" in self.status_text()

    def is_ready(self):
        try:
            with urllib.request.urlopen(f"{self._url}/-/ready", timeout=3.0) as answer:
                return answer.status == 200
        except (OSError, urllib.error.URLError):
            return False

    def journal_of_this_start(self):
        return self.robot.journal("arpd").rpartition("Starting arpd.service")[2]


def eventually(condition, timeout_s=30.0):
    until_s = time.monotonic() + timeout_s
    while time.monotonic() < until_s:
        if condition():
            return
        time.sleep(0.2)
    assert condition(), "did not happen in time"


def start(link, host, log, *module):
    return link.popen(
        host,
        [sys.executable, "-u", "-m", *module],
        env={**os.environ, "PYTHONPATH": str(REPO)},
        cwd=REPO,
        stderr=log,
        stdout=subprocess.PIPE,
        text=True,
    )


@pytest.fixture(scope="module")
def deployment(tmp_path_factory):
    for can, why in (simlink.available(), machine.available()):
        if not can:
            pytest.skip(why)
    folder = tmp_path_factory.mktemp("boot")
    with ExitStack() as stack:
        link = stack.enter_context(simlink.SimLink(f"boot-{os.getpid()}"))
        log = stack.enter_context((folder / "log").open("w"))
        sources = [
            start(link, "ceddp", log, "scripts.robot.planner", "/link", "adaptive", str(folder / "planner.json")),
            *(
                start(link, "robot", log, "scripts.robot.sensors", topic, str(folder / "sensor.json"))
                for topic in SENSORS
            ),
        ]
        robot, ceddp = (
            stack.enter_context(
                machine.booted(
                    f"arpd-{os.getpid()}-{host.name}",
                    network=NETNS_DIR / host.namespace,
                    files=installed_files(link.domain_id),
                )
            )
            for host in link.hosts
        )
        for computer, unit in ((robot, "arpd-relay"), (ceddp, "arpd-peer")):
            started = computer.call("systemctl", "start", unit)
            assert started.returncode == 0, started.stderr + computer.journal(unit)
        for source in sources:
            assert source.stdout.readline() == "ready\n", (folder / "log").read_text()
            source.send_signal(signal.SIGUSR1)
        reader = Reader(sources[0])
        url = stack.enter_context(window(link.robot, HTTP_PORT))
        eventually(lambda: all(reader.heard_s.values()))
        yield Deployment(robot, ceddp, reader, url)


@pytest.fixture(autouse=True)
def data_keeps_arriving(deployment):
    """Whatever a test does to the daemon, the relayed sensors reach their reader meanwhile."""
    since_s = time.monotonic()
    yield
    for computer, unit in ((deployment.robot, "arpd-relay"), (deployment.ceddp, "arpd-peer")):
        assert computer.show(unit, "ActiveState", "NRestarts") == {"ActiveState": "active", "NRestarts": "0"}
    assert deployment.reader.longest_silence_s(since_s) < LONGEST_SILENCE_S


@pytest.fixture
def stopped(deployment):
    deployment.robot.call("systemctl", "stop", "arpd")
    return deployment


@pytest.fixture
def running(deployment):
    deployment.robot.call("systemctl", "start", "arpd")
    eventually(deployment.is_confirmed)
    return deployment


def test_a_bad_configuration_fails_the_start_for_good(stopped):
    """A daemon that ends with 78 is failed at once, and systemd does not start it again."""
    good = stopped.config.read_text()
    stopped.config.write_text(good + BROKEN)
    try:
        assert stopped.robot.call("systemctl", "start", "arpd").returncode != 0
        # With a restart to come it would be activating, in auto-restart.
        assert stopped.state("ActiveState", "SubState", "Result", "ExecMainStatus", "NRestarts") == {
            "ActiveState": "failed",
            "SubState": "failed",
            "Result": "exit-code",
            "ExecMainStatus": "78",
            "NRestarts": "0",
        }
        assert "/etc/arpd/arpd.yaml:" in stopped.journal_of_this_start()
    finally:
        stopped.config.write_text(good)


def test_start_returns_when_the_daemon_runs(stopped):
    """`systemctl start` waits for READY, which python sends from the process the launcher was."""
    starting = stopped.robot.popen("systemctl", "start", "arpd")
    states = set()
    while starting.poll() is None:
        states.add(stopped.state("ActiveState")["ActiveState"])
        time.sleep(0.1)
    assert starting.returncode == 0, starting.stdout.read() + stopped.robot.journal("arpd")
    assert "activating" in states

    state = stopped.state("ActiveState", "MainPID", "NRestarts")
    assert (state["ActiveState"], state["NRestarts"]) == ("active", "0")
    command = (stopped.robot.root / "proc" / state["MainPID"] / "cmdline").read_text().split("\0")
    assert "python" in command[0]
    assert command[1:4] == ["-m", "arpd", "run"]
    log = stopped.journal_of_this_start()
    assert log.index("metrics at http://127.0.0.1:9464") < log.index("Started arpd.service")
    eventually(stopped.is_ready, timeout_s=5.0)


def test_status_says_what_the_link_carries(running):
    """`systemctl status` shows the link's rate and the plan in words, and every finished tick feeds the watchdog."""
    assert re.search(
        r"^[\d.]+ Mbit/s \(.*\), gate \d.\d\d, plan \d+: 2 of 2 publishers confirmed$", running.status_text()
    )
    shown = running.robot.call("systemctl", "status", "arpd", "arpd-relay", "--no-pager").stdout
    print(shown)
    assert "Mbit/s" in shown
    pinged = int(running.state("WatchdogTimestampMonotonic")["WatchdogTimestampMonotonic"])
    eventually(lambda: int(running.state("WatchdogTimestampMonotonic")["WatchdogTimestampMonotonic"]) > pinged, 5.0)


@pytest.mark.parametrize(("host", "unit"), [("robot", "arpd"), ("robot", "arpd-relay"), ("ceddp", "arpd-peer")])
def test_the_sandbox_is_in_force_while_data_flows(running, host, unit):
    """No capability, no new privilege, filtered system calls, a read-only system; and DDS works under it."""
    computer = getattr(running, host)
    main = computer.root / "proc" / computer.show(unit, "MainPID")["MainPID"]
    status = dict(line.split(":\t", 1) for line in (main / "status").read_text().splitlines() if ":\t" in line)
    assert {key: status[key].strip() for key in ("CapBnd", "CapEff", "NoNewPrivs", "Seccomp")} == {
        "CapBnd": "0" * 16,
        "CapEff": "0" * 16,
        "NoNewPrivs": "1",
        "Seccomp": "2",
    }
    options = {
        fields[4]: fields[5].split(",") for fields in map(str.split, (main / "mountinfo").read_text().splitlines())
    }
    assert "ro" in options["/"]
    assert {"/dev", "/tmp"} <= set(options)
    judged = computer.call("systemd-analyze", "security", "--no-pager", "--threshold=25", f"{unit}.service")
    assert judged.returncode == 0, judged.stdout


def test_a_bad_reload_fails_and_keeps_the_daemon(running):
    """`systemctl reload` of a broken file fails; status and journal show the fault, and a good file clears it."""
    before = running.state("MainPID", "NRestarts")
    good = running.config.read_text()
    running.config.write_text(good + BROKEN)
    try:
        assert running.robot.call("systemctl", "reload", "arpd").returncode != 0
        eventually(lambda: "reload refused: /etc/arpd/arpd.yaml:" in running.status_text())
        assert "headrom" in running.status_text()
        assert running.state("ActiveState", "SubState") == {"ActiveState": "active", "SubState": "running"}
        assert "reload refused; the configuration in force stays" in running.journal_of_this_start()
    finally:
        running.config.write_text(good)
    reloaded = running.robot.call("systemctl", "reload", "arpd")
    assert reloaded.returncode == 0, reloaded.stderr
    eventually(lambda: "refused" not in running.status_text())
    assert running.state("MainPID", "NRestarts") == before


@pytest.mark.parametrize("death", [signal.SIGKILL, signal.SIGSTOP], ids=["killed", "hung"])
def test_a_daemon_that_dies_or_hangs_comes_back(running, death):
    """After kill -9, or ten seconds without a tick, systemd starts the daemon anew and it governs again."""
    before = running.state("MainPID", "NRestarts")
    running.robot.call("kill", f"-{death.name}", before["MainPID"])
    eventually(lambda: int(running.state("NRestarts")["NRestarts"]) == int(before["NRestarts"]) + 1)
    eventually(running.is_ready)
    after = running.state("MainPID", "ActiveState")
    assert after["ActiveState"] == "active"
    assert after["MainPID"] != before["MainPID"]
    assert ("Watchdog timeout" in running.robot.journal("arpd")) == (death is signal.SIGSTOP)


def test_stop_gives_the_publishers_their_qos_back(running):
    """`systemctl stop` ends cleanly, after every publisher has its original QoS back."""
    stopped = running.robot.call("systemctl", "stop", "arpd")
    assert stopped.returncode == 0, stopped.stderr
    assert running.state("ActiveState", "Result", "ExecMainStatus") == {
        "ActiveState": "inactive",
        "Result": "success",
        "ExecMainStatus": "0",
    }
    assert "every publisher has its original QoS back" in running.journal_of_this_start()
