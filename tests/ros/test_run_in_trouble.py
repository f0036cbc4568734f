"""`arpd run` among real nodes, with a node that hangs, signals at any time, faulty files and a taken port."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import time
import urllib.request
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from tests.chaos.nodes import BASELINE_DEPTH
from tests.chaos.world import World, free_port, insist, this_host_only

pytestmark = pytest.mark.ros
REPO = Path(__file__).parents[2]
TOPICS = {name: f"/{name}" for name in ("first", "second", "third")}
HANGS = "second"


class Stage:
    """Three nodes that publish across the assumed link, and a daemon that plans for them."""

    def __init__(self, world, path):
        self.world = world
        self.path = path
        world.start("listener", "listener", *TOPICS.values())
        self.talkers = {}
        for name, topic in TOPICS.items():
            self.talkers[name] = world.start("talker", name, topic)
        for talker in self.talkers.values():
            insist(lambda talker=talker: all(talker.tell("matched").values()), "the reader matches")
            talker.tell("publish", is_on=True, number=0)
        self.port = free_port()
        self.write(depth=100)
        self.daemon = world.start("daemon", path)
        self.process = self.daemon._popen
        insist(lambda: self.shows(100), "the first plan is in force")

    def write(self, *, depth, spoil=""):
        settings = {
            "link": {"interface": "lo", "capacity": "10gbit"},
            "http": {"port": self.port},
            "governor": {"hold": "1h"},
            "defaults": {"min_depth": depth, "max_depth": depth, "latency_budget": "none"},
        }
        self.path.write_text(json.dumps(settings) + spoil)

    def shows(self, depth, *names):
        return all(self.world.shows(TOPICS[name], depth=depth) for name in names or TOPICS)

    def send(self, name, number):
        self.talkers[name]._popen.send_signal(number)

    def metric(self, name):
        with urllib.request.urlopen(f"http://127.0.0.1:{self.port}/metrics", timeout=10.0) as answer:
            lines = answer.read().decode().splitlines()
        return next(float(line.split()[-1]) for line in lines if line.startswith(f"{name} "))


@pytest.fixture(scope="module")
def stage(tmp_path_factory):
    """Start everything once; the tests follow each other, and the last one stops the daemon."""
    folder = tmp_path_factory.mktemp("failures")
    with this_host_only(), World(folder) as world:
        yield Stage(world, folder / "arpd.yaml")


def test_a_node_that_hangs_delays_nobodys_plan(stage):
    """While one node is stopped the others take a new plan; when it continues, it follows."""
    stage.send(HANGS, signal.SIGSTOP)
    try:
        stage.write(depth=130)
        stage.process.send_signal(signal.SIGHUP)
        insist(lambda: stage.shows(130, *(name for name in TOPICS if name != HANGS)), "the others have the new plan")
        assert stage.shows(100, HANGS)
    finally:
        stage.send(HANGS, signal.SIGCONT)
    insist(lambda: stage.shows(130), "the stopped node follows")


def test_ten_reloads_of_a_file_that_is_being_written_end_with_what_it_says_last(stage):
    """Half files are refused and counted, the last file is in force, and the ticks go on."""
    begun, failed = "arpd_config_reloads_total", "arpd_config_reload_failures_total"
    before = stage.metric(begun) - stage.metric(failed)
    stage.write(depth=999, spoil="}")
    stage.process.send_signal(signal.SIGHUP)
    insist(lambda: stage.metric(failed) >= 1, "half a file is refused")
    assert stage.metric("arpd_config_last_reload_successful") == 0
    for depth in range(141, 151):
        stage.write(depth=depth)
        stage.process.send_signal(signal.SIGHUP)
    insist(lambda: stage.shows(150), "the last file is in force")
    insist(lambda: stage.metric("arpd_config_last_reload_successful") == 1, "the refusal is over")
    assert before < stage.metric(begun) - stage.metric(failed) <= before + 10
    assert stage.metric("arpd_tick_failures_total") == 0


def test_a_stop_during_a_swap_with_a_node_that_hangs_is_clean(stage):
    """After several stop signals it restores every node that answers, and exits 0."""
    stage.write(depth=170)
    stage.process.send_signal(signal.SIGHUP)
    generation = stage.metric("arpd_plan_generation")
    insist(lambda: stage.metric("arpd_plan_generation") > generation, "a new plan is asked for")
    stage.send(HANGS, signal.SIGSTOP)
    try:
        stage.process.terminate()
        for _ in range(3):
            time.sleep(0.3)
            stage.process.send_signal(signal.SIGTERM)
        assert stage.process.wait(timeout=60.0) == 0
    finally:
        stage.send(HANGS, signal.SIGCONT)
    others = [name for name in TOPICS if name != HANGS]
    insist(lambda: stage.shows(BASELINE_DEPTH, *others), "the others have their own QoS")
    assert "did not confirm" in stage.daemon.log() or "every publisher has its original QoS back" in stage.daemon.log()


# -- alone


@pytest.fixture
def alone(tmp_path, monkeypatch):
    """Start `arpd run` without other nodes."""
    monkeypatch.setenv("FASTDDS_BUILTIN_TRANSPORTS", "UDPv4")
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    started = []

    def start(port, **environment):
        path = tmp_path / "arpd.yaml"
        path.write_text(json.dumps({"link": {"interface": "wlan9"}, "http": {"port": port}}))
        log = (tmp_path / "log").open("w")
        command = [sys.executable, "-u", "-m", "arpd.cli", "run", "--config", str(path)]
        process = subprocess.Popen(command, env={**os.environ, **environment}, stderr=log, cwd=REPO)
        started.append(process)
        return process, (tmp_path / "log").read_text

    yield start
    for process in started:
        process.kill()
        process.wait()


def handles_stop(process):
    """Return whether the process has a handler for SIGTERM (proc(5))."""
    status = Path(f"/proc/{process.pid}/status").read_text()
    caught = next(int(line.split()[1], 16) for line in status.splitlines() if line.startswith("SigCgt"))
    return bool(caught & 1 << (signal.SIGTERM - 1))


def test_a_stop_before_ros_is_up_is_clean(alone):
    """While the daemon imports ROS it has nothing to restore, and exits 0 at once."""
    process, log = alone(0)
    insist(lambda: handles_stop(process), "it handles signals")
    process.terminate()
    assert process.wait(timeout=60.0) == 0
    assert "Traceback" not in log()


def test_without_a_port_and_an_interface_it_runs_and_stops_cleanly(alone):
    """It names a taken port and a missing interface, serves once the port is free, and exits 0."""
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        process, log = alone(port)
        insist(lambda: "wlan9 is not there yet" in log(), "it ticks")
        assert f"cannot listen on 127.0.0.1:{port}" in log()
    insist(lambda: "metrics at" in log(), "it serves")
    process.terminate()
    assert process.wait(timeout=60.0) == 0
    assert "Traceback" not in log()
