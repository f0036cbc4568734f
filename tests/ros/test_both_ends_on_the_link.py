"""Both ends of the relay as real processes on two hosts, with the simulated link between them."""

import os
import re
import sys
from pathlib import Path

import pytest

from scripts.netns.namespaces import inside
from scripts.netns.simlink import SimLink, available
from tests.all.link.hosts import Hosts
from tests.ros.world import DOMAIN

ENOUGH = 100
RATE = 500_000  # bytes/s: a picture needs most of a second


@pytest.fixture
def hosts(tmp_path):
    """Join two hosts; root can, so there a link that cannot be had is a failure."""
    works, obstacle = available()
    if not works:
        (pytest.fail if os.geteuid() == 0 else pytest.skip)(f"no simulated link: {obstacle}")
    with SimLink(f"both-ends-{os.getpid()}", domain_id=DOMAIN, rate_bytes_per_second=RATE) as link:
        yield Hosts(link, tmp_path)


def heard(hosts, name, topic):
    """Return the numbers that a process printed for a topic, in the order of their arrival."""
    return [int(number) for number in re.findall(rf"^{topic} (\d+)\n", hosts.text(name), re.MULTILINE)]


def cut_datagrams(host):
    """Return how many datagrams of this host IP has cut."""
    read = Path("/proc/thread-self/net/snmp").read_text
    names, values = re.findall(r"^Ip: (.*)", inside(host.namespace, read), re.MULTILINE)
    return int(dict(zip(names.split(), values.split(), strict=True))["FragOKs"])


def passed(hosts):
    """Return for each picture how many samples published after it had arrived before it."""
    told, newest = [], 0
    for kind, number in re.findall(r"^/(odom|picture) (\d+)\n", hosts.text("base"), re.MULTILINE):
        if kind == "odom":
            newest = int(number)
        else:
            told.append(newest - int(number))
    return told


def test_both_ends_carry_everything_over_the_simulated_link(hosts, eventually):
    """Samples and commands arrive in order and once, a call is answered, and a picture comes whole and delays none.

    IP cuts no datagram before: some networks drop what it has cut.
    """
    relay = {"services": "[/add]", "link_domain": DOMAIN + 1, "robot": hosts.robot.address, "base": hosts.base.address}
    lines = [f"  {key}: {value}" for key, value in relay.items()]
    (hosts.folder / "arpd.yaml").write_text("\n".join(["relay:", *lines, ""]))
    own = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}  # nobody sees the other host unless arpd connects them
    for host, end, far in (("robot", "near", ()), ("base", "far", ("--far",))):
        hosts.start(host, end, "arpd", "relay", "--config", "arpd.yaml", *far, **own)
    eventually("the ends meet", lambda: all("the other end is" in hosts.text(end) for end in ("near", "far")))
    assert [cut_datagrams(host) for host in (hosts.robot, hosts.base)] == [0, 0]
    for host in ("robot", "base"):
        hosts.start(host, host, sys.executable, "-u", Path(__file__).with_name("host_nodes.py"), host, **own)
    eventually("the robot's samples reach the base computer", lambda: len(heard(hosts, "base", "/odom")) > ENOUGH)
    eventually("the commands reach the robot", lambda: len(heard(hosts, "robot", "/cmd")) > ENOUGH)
    eventually("the call of the robot's service is answered", lambda: heard(hosts, "base", "/add") == [42])
    eventually("pictures reach the base computer", lambda: len(passed(hosts)) > 2)
    assert min(passed(hosts)) > 5  # of 50 Hz
    assert not heard(hosts, "base", "/torn")
    for arrived in (heard(hosts, "base", "/odom"), heard(hosts, "robot", "/cmd")):
        assert arrived == sorted(set(arrived))
