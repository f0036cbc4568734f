"""A real interface that loses its carrier, goes down, is renamed, vanishes or stalls, and ROS nodes on it."""

from __future__ import annotations

import json
import math
import os
import socket
import subprocess
import sys
import threading
import time
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path

import pytest

pytest.importorskip("pyroute2", reason="pyroute2 is not installed")

from scripts.netns.namespaces import executable, inside
from scripts.netns.simlink import INTERFACE, SimLink, available

WORKS, WHY_NOT = available()
pytestmark = [pytest.mark.link, pytest.mark.skipif(not WORKS, reason=f"no simulated link here: {WHY_NOT}")]

REPO = Path(__file__).parents[2]

_serial = count()

READER = """
import json, logging, sys
from arpd.adapters.host.interface import InterfaceReader
from arpd.adapters.host.radio import Radio
from arpd.model.interface import state_of
logging.basicConfig(stream=sys.stderr, format="%(message)s", level="INFO")
reader = InterfaceReader(sys.argv[1])
for _ in sys.stdin:
    seen = reader.read()
    print(json.dumps({
        "state": state_of(seen), "index": reader.index, "name": seen and seen.interface,
        "rx_bytes": seen and seen.rx_bytes, "tx_bytes": seen and seen.tx_bytes,
        "backlog_bytes": seen and seen.backlog_bytes, "tx_dropped": seen and seen.tx_dropped,
        "radio": Radio().read(reader.name, reader.index),
    }), flush=True)
"""
PUBLISHER = """
import json, sys, threading, time
from arpd import AdaptivePublisher
from arpd.adapters.ros.runtime import ros_node, spinning
from rclpy.executors import SingleThreadedExecutor
from std_msgs.msg import String

class Listener(AdaptivePublisher):
    heard = 0
    def set_price(self, price):
        Listener.heard += price is not None  # from the daemon; without it, a node sets None by itself
        super().set_price(price)

with ros_node(sys.argv[1]) as node:
    publisher = Listener(node, String, "/chat", 10)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    with spinning(executor):
        while True:
            time.sleep(0.2)
            print(json.dumps({"count": Listener.heard}), flush=True)
"""
DAEMON = """
import json, sys, time
from arpd.model.price import Price
from arpd.model.probing import ProbeRequest
from arpd.adapters.ros.world import RosControl
from arpd.adapters.ros.runtime import control_node, ros_node, spinning
from arpd.model.settings import GraphSettings

with (control_node if sys.argv[2] == "never waits" else ros_node)("arpd") as node:
    from rclpy.executors import MultiThreadedExecutor
    world = RosControl(node, interface=sys.argv[1], graph=GraphSettings(), on_report=lambda: None)
    executor = MultiThreadedExecutor(num_threads=2)
    executor.add_node(node)
    heard = number = 0
    with spinning(executor):
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
def make_link():
    links = []

    def make(**options):
        links.append(SimLink(f"iface-{os.getpid()}-{next(_serial)}", **options).__enter__())
        return links[-1]

    yield make
    for link in links:
        link.__exit__(None, None, None)


def ip(host, *argv):
    subprocess.run([executable("ip"), "-n", host.namespace, *argv], check=True, capture_output=True)


def stop(host):
    """Stall the link: it keeps its carrier, queues without limit, and carries one datagram in two minutes."""
    shape(host, "replace", "tbf", "rate", "100bit", "burst", "2000", "limit", "100000000")
    time.sleep(5.0)  # 100 kB/s of probes: the socket's 208 KiB are full


def resume(host):
    shape(host, "delete")


def shape(host, command, *kind):
    argv = ("-n", host.namespace, "qdisc", command, "dev", INTERFACE, "root", *kind)
    subprocess.run([executable("tc"), *argv], check=True, capture_output=True)


def python(link, host, script, *argv, transports="UDPv4", **options):
    command = ["env", f"FASTDDS_BUILTIN_TRANSPORTS={transports}", sys.executable, "-u", "-c", script, *argv]
    env = {**os.environ, "PYTHONPATH": str(REPO)}
    return link.popen(host, command, env=env, text=True, stdout=subprocess.PIPE, cwd=REPO, **options)


# -- states and counters


@dataclass
class Reader:
    link: SimLink
    log: Path
    process: subprocess.Popen = field(init=False)

    def __post_init__(self):
        with self.log.open("w") as log:
            self.process = python(self.link, "robot", READER, INTERFACE, stdin=subprocess.PIPE, stderr=log, bufsize=1)

    def read(self):
        self.process.stdin.write("\n")
        return json.loads(self.process.stdout.readline())

    def until(self, state, timeout_s=10.0):
        """Read ten times a second, as the daemon does, until the interface is in the state."""
        until_s = time.monotonic() + timeout_s
        while (seen := self.read())["state"] != state:
            assert time.monotonic() < until_s, f"{seen} is not {state}"
            time.sleep(0.1)
        return seen


@pytest.fixture
def link(make_link):
    return make_link()


@pytest.fixture
def reader(link, tmp_path):
    return Reader(link, tmp_path / "log")


def send(link, datagrams=20):
    with inside(link.ceddp.namespace, lambda: socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as source:
        for _ in range(datagrams):
            source.sendto(bytes(958), (link.robot.address, 9))
    time.sleep(0.1)
    return datagrams * 1000


def test_every_state_of_a_real_interface_has_its_name(link, reader):
    """The reader names lost carrier, returned carrier, switched off and on at the next reading, and logs each once."""
    assert reader.until("up")["radio"] is None
    ip(link.ceddp, "link", "set", INTERFACE, "down")
    reader.until("no_carrier")
    reader.read()
    ip(link.ceddp, "link", "set", INTERFACE, "up")
    reader.until("up")
    ip(link.robot, "link", "set", INTERFACE, "down")
    reader.until("down")
    reader.read()
    ip(link.robot, "link", "set", INTERFACE, "up")
    reader.until("up")
    said = [line.removeprefix(f"the link interface {INTERFACE} ") for line in reader.log.read_text().splitlines()]
    assert said == ["has no carrier", "is up again", "is switched off", "is up again"]


def test_a_real_rename_is_followed(link, reader):
    """A renamed interface continues its counters."""
    before = reader.until("up")
    sent = send(link)
    ip(link.robot, "link", "set", INTERFACE, "down")
    ip(link.robot, "link", "set", INTERFACE, "name", "uplink")
    reader.until("down")
    ip(link.robot, "link", "set", "uplink", "up")
    after = reader.until("up")
    assert (after["name"], after["index"]) == ("uplink", before["index"])
    assert after["rx_bytes"] >= before["rx_bytes"] + sent
    assert f"the link interface {INTERFACE} is now called uplink; arpd follows it" in reader.log.read_text()


def test_a_real_interface_made_anew_is_taken_on(link, reader):
    """A deleted interface is gone; a new one of its name is read, and the total does not fall."""
    before = reader.until("up")
    sent = send(link)
    last = reader.read()
    assert last["rx_bytes"] >= before["rx_bytes"] + sent
    ip(link.robot, "link", "delete", INTERFACE)
    assert reader.until("gone")["name"] is None
    ip(link.robot, "link", "add", INTERFACE, "type", "veth", "peer", "name", "other")
    ip(link.robot, "link", "set", "other", "up")
    ip(link.robot, "link", "set", INTERFACE, "up")
    again = reader.until("up")
    assert (again["name"], again["index"] != last["index"]) == (INTERFACE, True)
    assert last["rx_bytes"] <= again["rx_bytes"] < last["rx_bytes"] + 10_000  # without the new interface's past


def test_the_queue_of_a_real_interface_is_seen_as_it_fills_and_overflows(make_link):
    """Datagrams that wait in front of a slow link are its backlog, and those that do not fit count as dropped."""
    link = make_link(rate_bytes_per_second=50_000.0, queue_bytes=64_000)
    reader = Reader(link, Path(os.devnull))
    before = reader.until("up")
    assert before["backlog_bytes"] == 0
    with inside(link.robot.namespace, lambda: socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as source:
        for sent in range(1, 201):
            source.sendto(bytes(958), (link.ceddp.address, 9))
            if sent == 30:
                half = reader.read()
    full = reader.read()
    assert half["backlog_bytes"] == pytest.approx(28_500, abs=6_000)  # the bucket let a part pass meanwhile
    assert half["tx_dropped"] == before["tx_dropped"]
    assert full["backlog_bytes"] == pytest.approx(64_000, abs=2_000)
    assert full["tx_dropped"] > before["tx_dropped"] + 100
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

    def until(self, condition, timeout_s=30.0):
        until_s = time.monotonic() + timeout_s
        while not condition(self.last):
            assert time.monotonic() < until_s, f"{self.last}"
            assert self.process.poll() is None
            time.sleep(0.05)


@dataclass
class Robot:
    publisher: Counted
    daemon: Counted

    def silences(self, duration_s):
        """Return the longest time without a price at the publisher, and without a tick of the daemon (s)."""
        start_s = time.monotonic()
        longest, seen, at_s = [0.0, 0.0], [self.publisher.count, self.daemon.count], [start_s, start_s]
        while (now_s := time.monotonic()) < start_s + duration_s:
            for i, count_now in enumerate((self.publisher.count, self.daemon.count)):
                if count_now != seen[i]:
                    seen[i], at_s[i] = count_now, now_s
                longest[i] = max(longest[i], now_s - at_s[i])
            time.sleep(0.02)
        return tuple(longest)


@pytest.fixture
def robot(make_link):
    """Start a publisher and a daemon's ROS side on the robot, and a peer and a publisher on the CEDDP."""
    pytest.importorskip("rclpy", reason="ROS 2 is not installed")

    def make(*, transports, how="never waits"):
        link = make_link()
        python(link, "ceddp", PUBLISHER, "far")
        python(link, "ceddp", "import sys; from arpd.cli.main import main; sys.exit(main(['peer']))")
        publisher = Counted(python(link, "robot", PUBLISHER, "near", transports=transports))
        daemon = Counted(python(link, "robot", DAEMON, INTERFACE, how, transports=transports))
        daemon.until(lambda said: said.get("publishers") == 2 and said.get("reports", 0) > 10)
        publisher.until(lambda said: said["count"] > 10)
        return link, Robot(publisher, daemon)

    return make


@pytest.mark.ros
def test_the_price_reaches_publishers_whatever_becomes_of_the_interface(robot):
    """Without carrier, address or interface the price reaches local publishers, even after DDS's participant lease."""
    link, both = robot(transports="DEFAULT")
    silences = {}
    ip(link.ceddp, "link", "set", INTERFACE, "down")
    silences["no carrier"] = both.silences(3.0)
    ip(link.robot, "address", "flush", "dev", INTERFACE)
    silences["no address"] = both.silences(3.0)
    ip(link.robot, "link", "set", INTERFACE, "down")
    silences["down"] = both.silences(24.0)  # DDS forgets a participant after 20 s
    ip(link.robot, "link", "delete", INTERFACE)
    silences["gone"] = both.silences(3.0)
    print(f"longest without price and without tick (s): {silences}")
    assert all(price_s < 1.5 and tick_s < 1.0 for price_s, tick_s in silences.values()), silences
    assert both.daemon.last["publishers"] == 1  # only the remote one is forgotten


@pytest.mark.ros
@pytest.mark.parametrize(("transports", "most_price_s"), [("DEFAULT", 1.5), ("UDPv4", math.inf)])
def test_the_daemon_lives_through_a_link_that_stands_still(robot, transports, most_price_s):
    """While the link is stalled the tick goes on, the price waits only if it shares the socket, and both recover."""
    link, both = robot(transports=transports)
    stop(link.robot)
    price_s, tick_s = both.silences(6.0)
    print(f"stalled, {transports}: longest without price {price_s:.2f} s, without tick {tick_s:.2f} s")
    assert price_s < most_price_s
    assert tick_s < 1.0
    reports, heard = both.daemon.last["reports"], both.publisher.count
    resume(link.robot)
    both.daemon.until(lambda said: said["reports"] > reports + 10)
    both.publisher.until(lambda said: said["count"] > heard + 10)


@pytest.mark.ros
def test_without_that_setting_the_ticks_end(robot):
    """With Fast DDS's default the daemon's first write to a full socket ends its ticks."""
    link, both = robot(transports="DEFAULT", how="waits")
    stop(link.robot)
    price_s, tick_s = both.silences(4.0)
    assert min(price_s, tick_s) > 3.0
