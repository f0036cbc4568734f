"""Both ends of the relay as real processes on two hosts, with the simulated link between them."""

import os
import sys
from pathlib import Path

import pytest

from scripts.netns.simlink import SimLink, available
from tests.ros.world import DOMAIN

HERE = Path(__file__).parent
ENOUGH = 100
RATE = 500_000  # bytes/s: a picture needs most of a second


class Link:
    """The link, and the processes on its two hosts."""

    def __init__(self, wire, folder):
        self._wire = wire
        self._folder = folder
        self.config = folder / "arpd.yaml"
        relay = {"link_domain": DOMAIN + 1, "robot": wire.robot.address, "base": wire.base.address}
        lines = [f"  {key}: {value}" for key, value in relay.items()]
        self.config.write_text("\n".join(["relay:", "  services: [/add]", *lines, ""]))

    def start(self, host, name, *command):
        """Start a Python process that sees its own host alone, unless arpd connects it with the other."""
        environment = [f"PYTHONPATH={HERE.parents[1]}", "ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST"]
        with self._path(name).open("w") as said, (self._folder / f"{name}.log").open("w") as log:
            argv = ["env", *environment, sys.executable, "-u", *map(str, command)]
            self._wire.popen(host, argv, stdout=said, stderr=log)

    def heard(self, name, topic):
        """Return the numbers that a process printed for a topic, in the order of their arrival."""
        lines = (line.split() for line in self._path(name).read_text().split("\n")[:-1])
        return [int(number) for kind, number in lines if kind == topic]

    def passed(self):
        """Return for each picture how many samples published after it had arrived before it."""
        passed, newest = [], 0
        for line in self._path("base").read_text().split("\n")[:-1]:
            kind, number = line.split()
            if kind == "/odom":
                newest = int(number)
            elif kind == "/picture":
                passed.append(newest - int(number))
        return passed

    def _path(self, name):
        return self._folder / f"{name}.out"


@pytest.fixture
def link(tmp_path):
    """Join two hosts; root can, so there a link that cannot be had is a failure."""
    works, obstacle = available()
    if not works:
        (pytest.fail if os.geteuid() == 0 else pytest.skip)(f"no simulated link: {obstacle}")
    with SimLink(f"both-ends-{os.getpid()}", domain_id=DOMAIN, rate_bytes_per_second=RATE) as wire:
        yield Link(wire, tmp_path)


def test_both_ends_carry_everything_over_the_simulated_link(link, eventually):
    """Samples and commands arrive in order and once, a call is answered, and a picture comes whole and delays none."""
    link.start("robot", "near", "-m", "arpd.cli", "relay", "--config", link.config)
    link.start("base", "far", "-m", "arpd.cli", "relay", "--config", link.config, "--far")
    link.start("robot", "robot", HERE / "host_nodes.py", "robot")
    link.start("base", "base", HERE / "host_nodes.py", "base")
    eventually("the robot's samples reach the base computer", lambda: len(link.heard("base", "/odom")) > ENOUGH)
    eventually("the commands reach the robot", lambda: len(link.heard("robot", "/cmd")) > ENOUGH)
    eventually("the call of the robot's service is answered", lambda: link.heard("base", "/add") == [42])
    eventually("pictures reach the base computer", lambda: len(link.passed()) > 2)
    assert min(link.passed()) > 5  # of 50 Hz
    assert not link.heard("base", "/torn")
    for arrived in (link.heard("base", "/odom"), link.heard("robot", "/cmd")):
        assert arrived == sorted(set(arrived))
