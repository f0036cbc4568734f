"""A real interface that loses its carrier, goes down, vanishes or stalls, and ROS nodes on it."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import threading
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import pytest

from scripts.netns.namespaces import executable, inside
from scripts.netns.simlink import INTERFACE, SimLink
from tests.all.link.hosts import NEEDS_LINK, ip, python
from tests.waiting import eventually

if TYPE_CHECKING:
    from pathlib import Path

pytestmark = NEEDS_LINK
READER = """
import json, logging, sys
from arpd.host.interface import InterfaceReader
from arpd.host.radio import radios_of
from arpd.model.interface import state_of
logging.basicConfig(stream=sys.stderr, format="%(message)s", level="INFO")
reader = InterfaceReader(sys.argv[1])
for _ in sys.stdin:
    seen = reader.read()
    print(json.dumps({
        "state": state_of(seen), "name": seen and seen.interface,
        "rx_bytes": seen and seen.rx_bytes, "tx_bytes": seen and seen.tx_bytes,
        "backlog_bytes": seen and seen.backlog_bytes, "tx_dropped": seen and seen.tx_dropped,
        "radios": radios_of(reader.name),
    }), flush=True)
"""
PUBLISHER = """
import json, sys, threading, time
from arpd import AdaptivePublisher
from arpd.ros.runtime import ros_node
from std_msgs.msg import String

class Listener(AdaptivePublisher):
    heard = 0
    def set_price(self, price):
        Listener.heard += price is not None  # from the daemon; without it, a node sets None by itself
        super().set_price(price)

with ros_node(sys.argv[1]) as node:
    publisher = Listener(node, String, "/chat", 10)
    while True:
        time.sleep(0.2)
        print(json.dumps({"count": Listener.heard}), flush=True)
"""
DAEMON = """
import json, sys, time
from arpd.model.price import Price
from arpd.model.probing import ProbeRequest
from arpd.ros.world import RosControl
from arpd.ros.runtime import control_node
from arpd.model.settings import GraphSettings

with control_node("arpd") as node:
    world = RosControl(node, interface=sys.argv[1], graph=GraphSettings(), on_report=lambda: None)
    heard = number = 0
    while True:
        seen = world.observe(time.monotonic())
        heard += len(seen.reports)
        world.set_price(Price(share_per_weight=0.5, capacity_bytes_per_second=1e6))
        number += 1
        world.probe(ProbeRequest(packets=8, packet_bytes=1300, number=number))
        ages = [one.age_s(seen.now_s) for one in seen.publishers]
        print(json.dumps({"count": number, "publishers": len(ages), "reports": heard}), flush=True)
        time.sleep(0.1)
"""


@pytest.fixture
def link():
    with SimLink(f"iface-{os.getpid()}") as link:
        yield link


def stop(host):
    """Stall the link: it keeps its carrier, queues without limit, and carries one datagram in two minutes."""
    shape(host, "replace", "tbf", "rate", "100bit", "burst", "2000", "limit", "100000000")


def resume(host):
    shape(host, "delete")


def shape(host, command, *kind):
    argv = ("-n", host.namespace, "qdisc", command, "dev", INTERFACE, "root", *kind)
    subprocess.run([executable("tc"), *argv], check=True, capture_output=True)


def start(link, host, *argv, transports="UDPv4", **options):
    environment = [f"FASTDDS_BUILTIN_TRANSPORTS={transports}"]
    return python(link, host, *argv, environment=environment, stdout=subprocess.PIPE, **options)


# -- states and counters


@dataclass
class Reader:
    link: SimLink
    log: Path
    process: subprocess.Popen = field(init=False)

    def __post_init__(self):
        with self.log.open("w") as log:
            self.process = start(
                self.link, "robot", "-c", READER, INTERFACE, stdin=subprocess.PIPE, stderr=log, bufsize=1
            )

    def read(self):
        self.process.stdin.write("\n")
        return json.loads(self.process.stdout.readline())

    def when(self, what, condition):
        """Return the first reading of which the condition holds."""
        return eventually(what, lambda: seen if condition(seen := self.read()) else None)

    def until(self, state):
        return self.when(f"the interface is {state}", lambda seen: seen["state"] == state)


def sender(host):
    return inside(host.namespace, lambda: socket.socket(socket.AF_INET, socket.SOCK_DGRAM))


def test_every_state_of_a_real_interface_has_its_name(link, tmp_path):
    """The reader names lost carrier, returned carrier, switched off and on, gone and made anew, each once."""
    reader = Reader(link, tmp_path / "log")
    first = reader.until("up")
    assert first["radios"] == []
    ip(link.base, "link", "set", INTERFACE, "down")
    reader.until("no_carrier")
    ip(link.base, "link", "set", INTERFACE, "up")
    reader.until("up")
    with sender(link.base) as source:
        for _ in range(20):
            source.sendto(bytes(958), (link.robot.address, 9))
    reader.when("what was sent is counted", lambda seen: seen["rx_bytes"] >= first["rx_bytes"] + 20_000)

    ip(link.robot, "link", "set", INTERFACE, "down")
    reader.until("down")
    ip(link.robot, "link", "set", INTERFACE, "up")
    before = reader.until("up")
    ip(link.robot, "link", "delete", INTERFACE)
    assert reader.until("gone")["name"] is None
    ip(link.robot, "link", "add", INTERFACE, "type", "veth", "peer", "name", "other")
    ip(link.robot, "link", "set", "other", "up")
    ip(link.robot, "link", "set", INTERFACE, "up")
    again = reader.until("up")
    assert before["rx_bytes"] <= again["rx_bytes"] < before["rx_bytes"] + 10_000  # without the new one's past

    said = [line.removeprefix("the link interface ") for line in reader.log.read_text().splitlines()]
    print("\n".join(said))
    for words in ("has no carrier", "is switched off", "is gone"):
        assert sum(words in line for line in said) == 1


def test_the_queue_of_a_real_interface_is_seen_as_it_fills_and_overflows(tmp_path):
    """Datagrams that wait in front of a slow link are its backlog, and those that do not fit count as dropped."""
    slow = 1000.0  # bytes/s: a datagram a second leaves meanwhile
    with SimLink(f"iface-{os.getpid()}", rate_bytes_per_second=slow, queue_bytes=64_000) as link:
        reader = Reader(link, tmp_path / "log")
        before = reader.until("up")
        assert before["backlog_bytes"] == 0
        with sender(link.robot) as source:
            for sent in range(1, 201):
                source.sendto(bytes(958), (link.base.address, 9))
                if sent == 30:
                    half = reader.read()
        full = reader.read()
    assert 20_000 < half["backlog_bytes"] <= 30_000
    assert half["tx_dropped"] == before["tx_dropped"]
    assert 54_000 < full["backlog_bytes"] <= 64_000
    handed = full["tx_bytes"] + full["backlog_bytes"] + 1000 * (full["tx_dropped"] - before["tx_dropped"])
    assert handed - before["tx_bytes"] == pytest.approx(200_000, abs=2_000)


# -- price and ticks


class Counted:
    """A process of the robot that prints its counts repeatedly."""

    def __init__(self, process):
        self.process = process
        self.last = {"count": 0}
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self):
        for line in self.process.stdout:
            self.last = json.loads(line)

    @property
    def count(self):
        return self.last["count"]

    def goes_on(self, what, steps=20):
        """Wait for further counts."""
        before = self.count
        eventually(what, lambda: self.count >= before + steps)


@pytest.fixture
def robot(link):
    """Start a publisher and a daemon's ROS side on the robot, and a peer and a publisher on the base computer."""

    def make(transports):
        start(link, "base", "-c", PUBLISHER, "far")
        start(link, "base", "-m", "arpd.cli", "peer")
        publisher = Counted(start(link, "robot", "-c", PUBLISHER, "near", transports=transports))
        daemon = Counted(start(link, "robot", "-c", DAEMON, INTERFACE, transports=transports))
        eventually(
            "the daemon sees both publishers and the peer",
            lambda: daemon.last.get("publishers") == 2 and daemon.last["reports"] > 10,
        )
        publisher.goes_on("the price comes")
        return publisher, daemon

    return make


def test_the_price_reaches_publishers_whatever_becomes_of_the_interface(link, robot):
    """Without carrier, address or interface the price reaches local publishers, even after DDS's participant lease."""
    publisher, daemon = robot("DEFAULT")
    for now, host, change in (
        ("without carrier", link.base, ("link", "set", INTERFACE, "down")),
        ("without an address", link.robot, ("address", "flush", "dev", INTERFACE)),
        ("switched off", link.robot, ("link", "set", INTERFACE, "down")),
        ("that is gone", link.robot, ("link", "delete", INTERFACE)),
    ):
        ip(host, *change)
        daemon.goes_on(f"ticks with an interface {now}")
        publisher.goes_on(f"prices with an interface {now}")
    eventually("only the remote publisher is forgotten", lambda: daemon.last["publishers"] == 1)
    daemon.goes_on("ticks after the lease")
    publisher.goes_on("prices after the lease")


@pytest.mark.parametrize("transports", ["DEFAULT", "UDPv4"])
def test_the_daemon_lives_through_a_link_that_stands_still(link, robot, transports):
    """While the link is stalled the tick goes on, the price waits only if it shares the socket, and both recover."""
    publisher, daemon = robot(transports)
    stop(link.robot)
    daemon.goes_on("ticks that fill the socket", 50)  # each probes with 10 kB; its socket takes 208 KiB
    daemon.goes_on("ticks with a full socket")
    if transports == "DEFAULT":
        publisher.goes_on("prices with a full socket")
    reports = daemon.last["reports"]
    resume(link.robot)
    eventually("the peer is heard again", lambda: daemon.last["reports"] > reports + 10)
    publisher.goes_on("prices after the stall")
