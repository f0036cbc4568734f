"""`arpd run` on its own: a signal at any time, a taken port, a missing interface."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from tests.ros.domain import DOMAIN
from tests.waiting import PATIENCE_S

REPO = Path(__file__).parents[2]


@pytest.fixture
def alone(tmp_path, monkeypatch):
    """Start `arpd run` without other nodes."""
    monkeypatch.setenv("FASTDDS_BUILTIN_TRANSPORTS", "UDPv4")
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.setenv("ROS_DOMAIN_ID", str(DOMAIN))
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


def test_without_a_port_and_an_interface_it_runs_and_stops_cleanly(alone, eventually):
    """It names a taken port and a missing interface, serves once the port is free, and exits 0."""
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        process, log = alone(port)
        eventually("it ticks", lambda: "wlan9 is not there yet" in log())
        assert f"cannot listen on 127.0.0.1:{port}" in log()
    eventually("it serves", lambda: "metrics at" in log())
    process.terminate()
    assert process.wait(timeout=PATIENCE_S) == 0
    assert "Traceback" not in log()
