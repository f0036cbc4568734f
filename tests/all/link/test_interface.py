"""A real interface that comes late, loses its carrier, goes down, vanishes or stalls, and ROS nodes on it."""

import socket
import subprocess
import sys

import pytest

from scripts.netns.namespaces import executable, inside
from scripts.netns.simlink import INTERFACE
from tests.all.link.hosts import NEEDS_LINK, ip
from tests.waiting import eventually

pytestmark = NEEDS_LINK
READER = """
import json, logging, sys, time
from arpd.host.interface import InterfaceReader
from arpd.host.radio import radios_of
from arpd.model.interface import state_of
logging.basicConfig(stream=sys.stderr, format="%(message)s", level="INFO")
reader = InterfaceReader(sys.argv[1])
while True:
    time.sleep(0.02)
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
from arpd.ros.runtime import ros_node, send_without_waiting
from arpd.model.settings import GraphSettings

send_without_waiting()
with ros_node("arpd") as node:
    world = RosControl(node, interface=sys.argv[1], on_report=lambda: None)
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


def shape(host, command, *kind):
    argv = ("-n", host.namespace, "qdisc", command, "dev", INTERFACE, "root", *kind)
    subprocess.run([executable("tc"), *argv], check=True, capture_output=True)


# -- states and counters


def reading(hosts):
    """Return what an `InterfaceReader` on the robot reads from now on."""
    known = hosts.text("reader").count("\n")
    eventually("it reads again", lambda: hosts.text("reader").count("\n") > known + 2)
    return hosts.last("reader")


def until(hosts, state):
    """Return the first reading of a state."""
    return eventually(f"the interface is {state}", lambda: seen if (seen := reading(hosts))["state"] == state else None)


def sender(host):
    return inside(host.namespace, lambda: socket.socket(socket.AF_INET, socket.SOCK_DGRAM))


def test_every_state_of_a_real_interface_has_its_name(hosts):
    """The reader names lost carrier, returned carrier, switched off and on, gone and made anew."""
    hosts.start("robot", "reader", sys.executable, "-c", READER, INTERFACE)
    first = until(hosts, "up")
    assert first["radios"] == []
    ip(hosts.base, "link", "set", INTERFACE, "down")
    until(hosts, "no_carrier")
    ip(hosts.base, "link", "set", INTERFACE, "up")
    until(hosts, "up")
    with sender(hosts.base) as source:
        for _ in range(20):
            source.sendto(bytes(958), (hosts.robot.address, 9))
    eventually("what was sent is counted", lambda: reading(hosts)["rx_bytes"] >= first["rx_bytes"] + 20_000)

    ip(hosts.robot, "link", "set", INTERFACE, "down")
    until(hosts, "down")
    ip(hosts.robot, "link", "set", INTERFACE, "up")
    before = until(hosts, "up")
    ip(hosts.robot, "link", "delete", INTERFACE)
    assert until(hosts, "gone")["name"] is None
    ip(hosts.robot, "link", "add", INTERFACE, "type", "veth", "peer", "name", "other")
    ip(hosts.robot, "link", "set", "other", "up")
    ip(hosts.robot, "link", "set", INTERFACE, "up")
    again = until(hosts, "up")
    assert before["rx_bytes"] <= again["rx_bytes"] < before["rx_bytes"] + 10_000  # without the new one's past


# 1000 bytes/s: a datagram a second leaves meanwhile.
@pytest.mark.parametrize("hosts", [{"rate_bytes_per_second": 1000.0, "queue_bytes": 64_000}], indirect=True, ids=[""])
def test_the_queue_of_a_real_interface_is_seen_as_it_fills_and_overflows(hosts):
    """Datagrams that wait in front of a slow link are its backlog, and those that do not fit count as dropped."""
    hosts.start("robot", "reader", sys.executable, "-c", READER, INTERFACE)
    before = until(hosts, "up")
    assert before["backlog_bytes"] == 0
    with sender(hosts.robot) as source:
        for sent in range(1, 201):
            source.sendto(bytes(958), (hosts.base.address, 9))
            if sent == 30:
                half = reading(hosts)
    full = reading(hosts)
    assert 20_000 < half["backlog_bytes"] <= 30_000
    assert half["tx_dropped"] == before["tx_dropped"]
    assert 54_000 < full["backlog_bytes"] <= 64_000
    handed = full["tx_bytes"] + full["backlog_bytes"] + 1000 * (full["tx_dropped"] - before["tx_dropped"])
    assert handed - before["tx_bytes"] == pytest.approx(200_000, abs=2_000)


# -- price and ticks


def goes_on(hosts, name, what, steps=20):
    """Wait for further counts of a program."""
    before = hosts.last(name)["count"]
    eventually(what, lambda: hosts.last(name)["count"] >= before + steps)


def start_all(hosts, transports):
    """Start a publisher and a daemon's ROS side on the robot, and a peer and a publisher on the base computer."""
    here = {"FASTDDS_BUILTIN_TRANSPORTS": transports}
    hosts.start("base", "far", sys.executable, "-c", PUBLISHER, "far")
    hosts.start("base", "peer", "arpd", "peer")
    hosts.start("robot", "near", sys.executable, "-c", PUBLISHER, "near", **here)
    hosts.start("robot", "daemon", sys.executable, "-c", DAEMON, INTERFACE, **here)
    eventually(
        "the daemon sees both publishers and the peer",
        lambda: (last := hosts.last("daemon")).get("publishers") == 2 and last["reports"] > 10,
    )
    eventually("the price comes", lambda: hosts.last("near").get("count", 0) > 20)


def test_the_price_reaches_publishers_whatever_becomes_of_the_interface(hosts):
    """Without carrier, address or interface the price reaches local publishers, even after DDS's participant lease."""
    start_all(hosts, "DEFAULT")
    for now, host, change in (
        ("without carrier", hosts.base, ("link", "set", INTERFACE, "down")),
        ("without an address", hosts.robot, ("address", "flush", "dev", INTERFACE)),
        ("switched off", hosts.robot, ("link", "set", INTERFACE, "down")),
        ("that is gone", hosts.robot, ("link", "delete", INTERFACE)),
    ):
        ip(host, *change)
        goes_on(hosts, "daemon", f"ticks with an interface {now}")
        goes_on(hosts, "near", f"prices with an interface {now}")
    eventually("only the remote publisher is forgotten", lambda: hosts.last("daemon")["publishers"] == 1)
    goes_on(hosts, "daemon", "ticks after the lease")
    goes_on(hosts, "near", "prices after the lease")


@pytest.mark.parametrize("transports", ["DEFAULT", "UDPv4"])
def test_the_daemon_lives_through_a_link_that_stands_still(hosts, transports):
    """While the link is stalled the tick goes on, the price waits only if it shares the socket, and both recover."""
    start_all(hosts, transports)
    # It keeps its carrier, queues without limit, and carries one datagram in two minutes.
    shape(hosts.robot, "replace", "tbf", "rate", "100bit", "burst", "2000", "limit", "100000000")
    goes_on(hosts, "daemon", "ticks that fill the socket", 50)  # each probes with 10 kB; its socket takes 208 KiB
    goes_on(hosts, "daemon", "ticks with a full socket")
    if transports == "DEFAULT":
        goes_on(hosts, "near", "prices with a full socket")
    reports = hosts.last("daemon")["reports"]
    shape(hosts.robot, "delete")
    eventually("the peer is heard again", lambda: hosts.last("daemon")["reports"] > reports + 10)
    goes_on(hosts, "near", "prices after the stall")


# -- a link that comes after the daemon


AS_ITS_UNIT = ("sh", "-c", 'until "$@"; do sleep 0.2; done', "sh", "arpd")  # starts again after each failure


def rename(host, name, other):
    ip(host, "link", "set", name, "down")
    ip(host, "link", "set", name, "name", other)
    ip(host, "link", "set", other, "up")  # else the peer's end has no carrier


def test_a_link_that_comes_after_the_daemon_is_taken(hosts):
    """The daemon starts without the link, logs that, restarts once the link has an address, and hears the peer."""
    (hosts.folder / "arpd.yaml").write_text(f"link: {{interface: {INTERFACE}}}\n")
    ip(hosts.robot, "address", "flush", "dev", INTERFACE)
    rename(hosts.robot, INTERFACE, "away")
    hosts.start("base", "peer", *AS_ITS_UNIT, "peer", "--interface", INTERFACE)
    hosts.start("robot", "run", *AS_ITS_UNIT, "run", "--config", "arpd.yaml")
    eventually("the daemon is ready", lambda: hosts.metric("arpd_ready") == 1)
    assert f"{INTERFACE} is not there yet" in hosts.text("run")
    rename(hosts.robot, "away", INTERFACE)
    assert hosts.metric("arpd_peer_reports_total") == 0
    ip(hosts.robot, "address", "add", f"{hosts.robot.address}/30", "dev", INTERFACE)
    eventually("the peer is heard", lambda: (hosts.metric("arpd_peer_reports_total") or 0) > 10)
    assert f"arpd: {INTERFACE} has an address that ROS" in hosts.text("run")
