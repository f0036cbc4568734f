"""The two hosts of a simulated link, and what a user runs on them."""

import json
import os
import subprocess
import sys
import urllib.request
from pathlib import Path

import pytest

pytest.importorskip("pyroute2", reason="pyroute2 is not installed")
pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from arpd.ros.runtime import PROFILE_VARIABLE
from scripts.netns.namespaces import executable, inside
from scripts.netns.simlink import available
from tests.scrape import metrics
from tests.waiting import eventually

CAN, WHY = available()
NEEDS_LINK = [pytest.mark.link, pytest.mark.ros, pytest.mark.skipif(not CAN, reason=WHY)]
REPO = Path(__file__).parents[3]
NODE = REPO / "tests/all/node.py"
_URL = "http://127.0.0.1:9464"


def ip(host, *argv):
    """Run `ip` in a host's namespace."""
    subprocess.run([executable("ip"), "-n", host.namespace, *argv], check=True, capture_output=True)


def second_network(host, other):
    """Give a computer a network, as of Docker, that the default route of the other one leads to."""
    ip(host, "link", "add", "docker0", "type", "veth", "peer", "name", "inside")
    ip(host, "addr", "add", "172.17.0.1/16", "dev", "docker0")
    for end in ("docker0", "inside"):
        ip(host, "link", "set", end, "up")
    ip(other, "route", "add", "default", "via", host.address)


class Hosts:
    """Starts programs on the hosts; `arpd` is this checkout's, and the working directory is the test's.

    Attributes
    ----------
    environment : of every program
    """

    def __init__(self, link, folder):
        self.link, self.robot, self.base, self.folder = link, link.robot, link.base, folder
        self.environment = {name: value for name, value in os.environ.items() if name != PROFILE_VARIABLE}
        self.environment |= {"PYTHONPATH": str(REPO), "PATH": f"{folder}:{os.environ['PATH']}"}
        command = folder / "arpd"
        command.write_text(f'#!/bin/sh\nexec {sys.executable} -u -m arpd.cli "$@"\n')
        command.chmod(0o755)

    def start(self, host, name, *argv, **environment):
        """Start a program; `text` returns what it says."""
        with (self.folder / f"{name}.log").open("w") as log:
            self._popen(host, argv, environment, stdout=log, stderr=log)

    def node(self, host, name, *parts, **environment):
        """Start a node of `tests/all/node.py`, and wait until it is there."""
        self.start(host, name, sys.executable, str(NODE), name, *parts, **environment)
        eventually(f"{name} is there", lambda: "ready" in self.text(name))

    def call(self, host, *argv):
        """Run a program to its end; return its output, its errors and its exit code."""
        process = self._popen(host, argv, {}, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        return *process.communicate(), process.returncode

    def _popen(self, host, argv, environment, **options):
        command = ["env", *(f"{key}={value}" for key, value in environment.items()), *argv]
        return self.link.popen(host, command, env=self.environment, cwd=self.folder, text=True, **options)

    def text(self, name):
        return (self.folder / f"{name}.log").read_text()

    def last(self, name):
        """Return the last line of JSON that a program has said, empty before the first."""
        lines = [line for line in self.text(name).splitlines(keepends=True) if line[0] == "{" and line.endswith("\n")]
        return json.loads(lines[-1]) if lines else {}

    def told(self):
        """Return the end of every log, for a failure."""
        return "\n".join(f"--- {log.name}\n{log.read_text()[-2000:]}" for log in sorted(self.folder.glob("*.log")))

    def status(self):
        """Return what the robot's daemon says, empty while it does not answer."""

        def ask():
            with urllib.request.urlopen(f"{_URL}/api/v1/status", timeout=5) as answer:
                return json.load(answer)

        try:
            return inside(self.robot.namespace, ask)
        except OSError:
            return {}

    def metric(self, name):
        """Return a metric of the robot's daemon, None while it does not answer."""
        return inside(self.robot.namespace, lambda: metrics(_URL)).get(name)
