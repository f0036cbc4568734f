"""Users of an installed arpd: their Python programs, and a node that the installed daemon tunes over a link."""

from __future__ import annotations

import json
import os
import sys
from contextlib import ExitStack
from pathlib import Path

from tests.all.system.fake_pi import REPO, SYSTEM_PYTHON
from tests.all.system.user_node import TOPIC
from tests.waiting import eventually

PROFILE = "/usr/share/arpd/fastdds.xml"
IMPORT = "from arpd import AdaptivePublisher; print(AdaptivePublisher.__module__)"
NODE = "/srv/user_node.py"
FILES = {NODE: Path(__file__).with_name("user_node.py")}
READER = """
import sys, rclpy
from std_msgs.msg import String
rclpy.init()
node = rclpy.create_node("listener")
node.create_subscription(String, sys.argv[1], lambda _: None, 10)
rclpy.spin(node)
"""
_USER = 4242  # neither root nor arpd


def as_user(script, *argv, ros=True):
    """Return the command line of a shell script that a user other than arpd runs, with ROS sourced or not."""
    setup = ". /opt/ros/jazzy/setup.bash; " if ros else ""
    user = ("setpriv", f"--reuid={_USER}", f"--regid={_USER}", "--clear-groups")
    environment = ("env", "-i", "PATH=/usr/bin:/bin", "HOME=/tmp", "PYTHONDONTWRITEBYTECODE=1")
    return (*user, *environment, "bash", "-c", setup + script, "bash", *argv)


def python_says(booted, script, *, python=str(SYSTEM_PYTHON), ros=True):
    """Return the end of a Python program that a user runs."""
    return booted.call(*as_user('exec "$1" -c "$2"', python, script, ros=ros))


def from_a_venv(booted, script):
    """Return the end of a program in the user's own virtual environment with system site-packages."""
    made = booted.call(*as_user(f"{SYSTEM_PYTHON} -m venv --without-pip --system-site-packages /tmp/ws", ros=False))
    assert made.returncode == 0, made.stderr
    try:
        return python_says(booted, script, python="/tmp/ws/bin/python")
    finally:
        booted.call("rm", "-rf", "/tmp/ws")


def rows(booted):
    """Return the rows of the node's topic in the status of the installed daemon."""
    shown = booted.call("arpd", "status", "--json").stdout
    return [row for row in json.loads(shown or '{"topics": []}')["topics"] if row["topic"] == TOPIC]


def is_swapped(row):
    """Return whether the node has swapped its writer to the plan of the daemon."""
    planned, confirmed = row["planned"], row["confirmed"]
    return bool(
        confirmed["swaps_by_result"]
        and planned
        and (planned["depth"], planned["deadline_ns"]) == (confirmed["depth"], confirmed["deadline_ns"])
    )


def run_node(booted, link, log):
    """Run the node, with a reader and a peer on the other end, until the daemon has swapped its writer.

    Return the row of its topic, and what it told.
    """
    with ExitStack() as stack:
        for argv in (("-m", "arpd.cli", "peer"), ("-c", READER, TOPIC)):
            process = link.popen(
                "base", [sys.executable, *argv], env=dict(os.environ), cwd=REPO, stdout=log, stderr=log
            )
            stack.callback(process.wait)
            stack.callback(process.terminate)
        node = booted.popen(
            *as_user('FASTRTPS_DEFAULT_PROFILES_FILE=$1 exec "$2" "$3"', PROFILE, str(SYSTEM_PYTHON), NODE)
        )
        try:
            eventually("the node has swapped its writer", lambda: any(map(is_swapped, rows(booted))))
            row = rows(booted)[0]
        except AssertionError:
            print(json.dumps(rows(booted), indent=1), booted.journal("arpd"))
            raise
        finally:
            # nsenter, which `node` is, does not pass a signal on.
            booted.call("pkill", "-KILL", "--uid", str(_USER))
            told, _ = node.communicate()
            print(told)
        return row, told
