"""arpd's units under a real systemd, on a robot and a base computer joined by a shaped link."""

import json
import re
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from arpd.report.conditions import MESSAGE_IDS, Happening
from tests.all.system.computers import CONFIG, ENV, SYSTEM_PYTHON, as_user
from tests.waiting import eventually

pytestmark = [pytest.mark.link, pytest.mark.ros, pytest.mark.timeout(900)]  # the first one builds a package

NODE = "/srv/node.py"
RELAYED, OWN = "/link/numbered", "/own"
SETTINGS = """\
relay:
  topics:
    - {name: /numbered, overflow: queue, depth: 2000}
topics:
  # At least twice the rate and 40 s of the samples: pacing withholds nothing, whatever arpd thinks of the link.
  - {name: /link/numbered, min_rate_hz: 50, max_rate_hz: 50, min_depth: 1000, max_depth: 1000, latency_budget: none}
  - {name: /own, min_rate_hz: 50, max_rate_hz: 50, min_depth: 1000, max_depth: 1000, latency_budget: none}
"""
BROKEN = "\nlink:\n  headrom: 0.5\n"
CONFIRMED = "2 of 2 publishers confirmed"


class Deployment:
    """The installed package at work on both computers, and a user's application on them."""

    def __init__(self, computers):
        self.robot, self.base = computers.robot, computers.base
        self.numbers = {RELAYED: [], OWN: []}  # that the base computer has read
        self._readers = []
        for host, units in ((self.robot, ("arpd-relay", "arpd")), (self.base, ("arpd-peer",))):
            computers.install("first", host)
            host.write(NODE, Path(__file__).parents[1].joinpath("node.py").read_text())
            host.write(CONFIG, SETTINGS)
            enabled = host.call("systemctl", "enable", "--now", *units)
            assert enabled.returncode == 0, enabled.stderr + "".join(map(host.journal, units))
        self.run_application()
        eventually("all units work", lambda: all_up(self))  # until then there is no relay that could carry samples

    def run_application(self):
        """Run a node on each computer: one that publishes on the robot, and one that reads."""
        kind = "std_msgs/String"
        for host, name, parts in (
            (self.robot, "source", (f"write:/numbered:{kind}", f"adapt:{OWN}:{kind}")),
            (self.base, "sink", (f"read:{topic}:{kind}" for topic in self.numbers)),
        ):
            profile = "FASTRTPS_DEFAULT_PROFILES_FILE=/usr/share/arpd/fastdds.xml"
            process = host.popen(*as_user("env", profile, SYSTEM_PYTHON, "-u", NODE, name, *parts))
            self._readers.append(threading.Thread(target=self._read, args=(process.stdout,), daemon=True))
            self._readers[-1].start()

    def end_application(self):
        for host in (self.robot, self.base):
            host.call("pkill", "-KILL", "--uid", "4242")
        while self._readers:
            self._readers.pop().join()
        for numbers in self.numbers.values():
            numbers.clear()

    def _read(self, lines):
        for line in lines:
            if line.startswith(tuple(self.numbers)):
                topic, number = line.split()
                self.numbers[topic].append(int(number))
            else:
                print(line, end="")

    def faults(self):
        """Return how many samples of each topic are missing, and how many have come twice."""
        known = len(self.numbers[OWN])
        eventually("samples arrive", lambda: self.numbers[RELAYED] and len(self.numbers[OWN]) > known + 10)
        read = {topic: list(numbers) for topic, numbers in self.numbers.items()}
        lost = {topic: max(found) - min(found) + 1 - len(set(found)) for topic, found in read.items()}
        return lost, {topic: len(found) - len(set(found)) for topic, found in read.items()}

    @property
    def config(self):
        return self.robot.path(CONFIG)

    def state(self, *properties):
        return self.robot.show("arpd", *properties)

    def status_text(self):
        return self.state("StatusText")["StatusText"]

    def is_confirmed(self):
        return CONFIRMED in self.status_text()

    def status(self):
        """Run `arpd status` on the robot."""
        return self.robot.call("arpd", "status", "--json")

    def entries(self, host, *matches):
        """Return the matching entries of a computer's journal."""
        listed = host.call("journalctl", "--output=json", "--all", "--no-pager", *matches)
        return [json.loads(line) for line in listed.stdout.splitlines()]

    def journal_of_this_start(self):
        return self.robot.journal("arpd").rpartition("Starting arpd.service")[2]

    def hosts(self):
        """Return each unit and its computer."""
        return (("arpd", self.robot), ("arpd-relay", self.robot), ("arpd-peer", self.base))


@pytest.fixture(scope="module")
def deployment(computers):
    deployed = Deployment(computers)
    yield deployed
    deployed.end_application()


@pytest.fixture
def relay_ends():
    """Mark a test that ends the relay, so that relayed samples may be lost."""


@pytest.fixture(autouse=True)
def no_sample_is_lost(request, deployment):
    """During every test the application's samples arrive, each of them once; pacing is told to withhold none."""
    before, _ = deployment.faults()
    yield
    lost, doubled = deployment.faults()
    assert set(doubled.values()) == {0}
    assert lost[OWN] == before[OWN]
    assert lost[RELAYED] == before[RELAYED] or "relay_ends" in request.fixturenames


@pytest.fixture
def stopped(deployment):
    deployment.robot.call("systemctl", "stop", "arpd")
    return deployment


@pytest.fixture
def running(deployment):
    deployment.robot.call("systemctl", "start", "arpd")
    eventually("both publishers confirm the plan", deployment.is_confirmed)
    return deployment


def all_up(deployment):
    """Return whether every unit runs, the peer hears the daemon, and the relay carries its topic."""
    said = {unit: host.show(unit, "ActiveState", "StatusText") for unit, host in deployment.hosts()}
    return (
        all(one["ActiveState"] == "active" for one in said.values())
        and CONFIRMED in said["arpd"]["StatusText"]
        and "relaying 1 of 1" in said["arpd-relay"]["StatusText"]
        and "probes arrive since" in said["arpd-peer"]["StatusText"]
    )


def come_back(unit, host, *, restarts):
    """Wait until systemd has restarted a unit the given number of times, and it is ready."""
    wanted = {"NRestarts": str(restarts), "ActiveState": "active"}
    eventually(f"{unit} is restarted", lambda: host.show(unit, *wanted) == wanted)


def test_a_bad_configuration_fails_the_start_for_good(stopped):
    """A daemon that ends with 78 has failed, and systemd does not restart it; `arpd status` knows the next step."""
    good = stopped.config.read_text()
    stopped.config.write_text(good + BROKEN)
    try:
        assert stopped.robot.call("systemctl", "start", "arpd").returncode != 0
        # Before a restart it would be activating, in auto-restart.
        assert stopped.state("ActiveState", "SubState", "Result", "ExecMainStatus", "NRestarts") == {
            "ActiveState": "failed",
            "SubState": "failed",
            "Result": "exit-code",
            "ExecMainStatus": "78",
            "NRestarts": "0",
        }
        assert "/etc/arpd/arpd.yaml:" in stopped.journal_of_this_start()
        asked = stopped.status()
        assert (asked.returncode, "arpd check" in asked.stderr) == (3, True), asked.stderr
    finally:
        stopped.config.write_text(good)


def test_start_returns_when_the_daemon_runs(stopped):
    """`systemctl start` waits for READY, which python sends from the launcher's process."""
    starting = stopped.robot.popen("systemctl", "start", "arpd")
    states = set()
    while starting.poll() is None:
        states.add(stopped.state("ActiveState")["ActiveState"])
        time.sleep(0.1)
    assert starting.returncode == 0, starting.stdout.read() + stopped.robot.journal("arpd")
    assert "activating" in states

    state = stopped.state("ActiveState", "MainPID", "NRestarts")
    assert (state["ActiveState"], state["NRestarts"]) == ("active", "0")
    command = (stopped.robot.path("/proc") / state["MainPID"] / "cmdline").read_text().split("\0")
    assert command[0].startswith(f"{ENV}/bin/python")
    assert command[1:3] == [f"{ENV}/bin/arpd", "run"]
    log = stopped.journal_of_this_start()
    assert log.index("metrics at http://127.0.0.1:9464") < log.index("Started arpd.service")
    eventually("the daemon is ready", lambda: json.loads(stopped.status().stdout or "{}").get("ready"))


def test_status_says_what_the_link_carries(running):
    """`systemctl status` shows the link's rate and the plan, and finished work feeds all three watchdogs."""
    assert re.search(
        r"^[\d.]+ Mbit/s \(.*\), allowed [\d.]+ %, plan \d+: 2 of 2 publishers confirmed$", running.status_text()
    )
    for unit, host in running.hosts():
        assert host.show(unit, "StatusText")["StatusText"] in host.call("systemctl", "status", unit).stdout
        assert host.show(unit, "WatchdogUSec")["WatchdogUSec"].endswith("0s")
        pinged = host.show(unit, "WatchdogTimestampMonotonic")
        eventually(
            f"{unit} feeds its watchdog",
            lambda: host.show(unit, "WatchdogTimestampMonotonic") != pinged,  # noqa: B023 - not kept
        )


def test_the_daemon_tunes_a_users_node(running):
    """The writer of a plain script, which has the package's library and the system's Python, is swapped to the plan."""
    (own,) = (row["confirmed"] for row in json.loads(running.status().stdout)["topics"] if row["topic"] == OWN)
    assert (own["depth"], own["refusal"]) == (1000, "")
    assert own["swaps_by_result"]


def test_the_journal_has_the_decision_log_as_fields(running):
    """`journalctl ARPD_EVENT=plan` finds plans with their cause, -x explains them, and all three units use fields."""
    plans = running.entries(running.robot, "ARPD_EVENT=plan", "_SYSTEMD_UNIT=arpd.service")
    assert plans
    assert {entry["MESSAGE_ID"] for entry in plans} == {MESSAGE_IDS[Happening.PLAN]}
    assert {entry["_TRANSPORT"] for entry in plans} == {"journal"}
    for entry in plans:
        assert entry["SYSLOG_IDENTIFIER"] == "arpd"
        assert entry["PRIORITY"] in {"4", "6"}
        assert float(entry["ARPD_CAPACITY_BYTES_PER_SECOND"]) > 0
        assert entry["ARPD_CAUSE"]
        assert int(entry["ARPD_GENERATION"]) > 0
    explained = running.robot.call("journalctl", "--no-pager", "-x", "-n", "1", "ARPD_EVENT=plan").stdout
    assert "There is a new plan" in explained
    assert f"Cause: {plans[-1]['ARPD_CAUSE']}." in explained
    for unit, host in running.hosts():
        entries = running.entries(host, f"_SYSTEMD_UNIT={unit}.service", "_TRANSPORT=journal")
        assert {entry["SYSLOG_IDENTIFIER"] for entry in entries} == {unit}
        assert all(entry["LOGGER"].startswith("arpd.") for entry in entries)


@pytest.mark.parametrize("unit", ["arpd", "arpd-relay", "arpd-peer"])
def test_the_sandbox_is_in_force_while_data_flows(running, unit):
    """Each unit has a user of arpd's, no capabilities, few system calls and a read-only system, and DDS works."""
    computer = dict(running.hosts())[unit]
    main = computer.path("/proc") / computer.show(unit, "MainPID")["MainPID"]
    assert main.stat().st_uid == int(computer.call("id", "--user", "arpd").stdout) != 0
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
    assert {"/tmp", "/var/tmp", "/home", "/root"} <= set(options)
    judged = computer.call("systemd-analyze", "security", "--no-pager", "--threshold=20", f"{unit}.service")
    assert judged.returncode == 0, judged.stdout
    assert not re.search("not permitted|denied", computer.journal(unit), re.IGNORECASE)


def test_a_bad_reload_fails_and_keeps_the_daemon(running):
    """`systemctl reload` fails for a broken file; status and journal show the fault until a good file clears it."""
    before = running.state("MainPID", "NRestarts")
    good = running.config.read_text()
    running.config.write_text(good + BROKEN)
    try:
        assert running.robot.call("systemctl", "reload", "arpd").returncode != 0
        eventually("the status has the fault", lambda: "reload refused: /etc/arpd/arpd.yaml:" in running.status_text())
        assert "headrom" in running.status_text()
        assert running.state("ActiveState", "SubState") == {"ActiveState": "active", "SubState": "running"}
        assert re.search("reload refused.*the configuration in force stays", running.journal_of_this_start())
    finally:
        running.config.write_text(good)
    reloaded = running.robot.call("systemctl", "reload", "arpd")
    assert reloaded.returncode == 0, reloaded.stderr
    eventually("the fault is cleared", lambda: "refused" not in running.status_text())
    assert running.state("MainPID", "NRestarts") == before


def test_a_killed_daemon_comes_back_to_its_plan(running):
    """After kill -9 systemd restarts the daemon, with full disks, too, and every publisher confirms its plan again."""
    fill = (
        "for at in /var/log /var/lib /tmp /var/tmp; do mount -t tmpfs -o size=64k,nr_inodes=8 full $at;"
        " cat /dev/zero >$at/fill; for n in 1 2 3 4 5 6 7 8; do touch $at/$n; done; done; df -i /var/log"
    )
    filled = running.robot.call("sh", "-c", fill)
    assert " 100% " in filled.stdout, filled
    try:
        before = running.state("MainPID", "NRestarts")
        running.robot.call("kill", "-KILL", before["MainPID"])
        come_back("arpd", running.robot, restarts=int(before["NRestarts"]) + 1)
        eventually("both publishers confirm the plan", running.is_confirmed)
        assert running.state("MainPID")["MainPID"] != before["MainPID"]
    finally:
        running.robot.call("umount", "/var/log", "/var/lib", "/tmp", "/var/tmp")


@pytest.mark.usefixtures("relay_ends")
def test_a_killed_relay_and_a_killed_peer_come_back(running):
    """After kill -9 of both, data flows again, and only relayed samples are lost."""
    for unit, host in running.hosts()[1:]:
        host.call("systemctl", "kill", "--signal=KILL", "--kill-who=main", unit)
    for unit, host in running.hosts()[1:]:
        come_back(unit, host, restarts=1)
    eventually("all units work", lambda: all_up(running))
    newest = max(running.numbers[RELAYED])
    eventually("relayed samples arrive", lambda: max(running.numbers[RELAYED]) > newest)


@pytest.mark.usefixtures("relay_ends")
def test_a_hung_process_is_restarted_by_its_watchdog(running):
    """Systemd ends and restarts a daemon, a relay and a peer that hang, within the time in their units."""
    before = {unit: host.show(unit, "MainPID", "NRestarts") for unit, host in running.hosts()}
    for unit, host in running.hosts():
        host.call("kill", "-STOP", before[unit]["MainPID"])
    for unit, host in running.hosts():
        come_back(unit, host, restarts=int(before[unit]["NRestarts"]) + 1)
        log = host.journal(unit)
        assert "Watchdog timeout" in log
        assert "Fatal Python error: Aborted" in log  # with the stack of every thread
    eventually("all units work", lambda: all_up(running))


def test_stop_gives_the_publishers_their_qos_back(running):
    """`systemctl stop` ends cleanly after every publisher has its original QoS back."""
    stopped = running.robot.call("systemctl", "stop", "arpd")
    assert stopped.returncode == 0, stopped.stderr
    assert running.state("ActiveState", "Result", "ExecMainStatus") == {
        "ActiveState": "inactive",
        "Result": "success",
        "ExecMainStatus": "0",
    }
    assert "every publisher has its original QoS back" in running.journal_of_this_start()


@pytest.mark.usefixtures("relay_ends")
def test_a_reboot_brings_everything_back(deployment):
    """After a reboot of both computers the enabled units start, and the plan is in force again."""
    deployment.end_application()  # it is no unit, so systemd would wait for it
    with ThreadPoolExecutor() as both:
        list(both.map(lambda host: host.reboot(), (deployment.robot, deployment.base)))
    deployment.run_application()
    eventually("all units work", lambda: all_up(deployment))
