"""The two hosts of a simulated link, for tests with ROS on them."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("pyroute2", reason="pyroute2 is not installed")
pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from scripts.netns.namespaces import executable
from scripts.netns.simlink import available

CAN, WHY = available()
NEEDS_LINK = [pytest.mark.link, pytest.mark.ros, pytest.mark.skipif(not CAN, reason=WHY)]
REPO = Path(__file__).parents[3]


def ip(host, *argv):
    """Run `ip` in a host's namespace."""
    subprocess.run([executable("ip"), "-n", host.namespace, *argv], check=True, capture_output=True)


def python(link, host, *argv, environment=(), **options):
    """Start this checkout's Python on a host; its output is text, and goes to where Popen's options say."""
    command = ["env", *environment, sys.executable, "-u", *argv]
    return link.popen(host, command, env={**os.environ, "PYTHONPATH": str(REPO)}, text=True, **{"cwd": REPO, **options})
