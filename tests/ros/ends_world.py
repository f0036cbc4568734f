"""Both ends of a relay as real processes on this host, each in a domain of its own, and nodes on both sides."""

import os
import signal
import socket
import subprocess
import sys
import threading
import time
from contextlib import suppress
from itertools import count

from rclpy.qos import QoSDurabilityPolicy, QoSProfile, QoSReliabilityPolicy
from std_msgs.msg import String, UInt8MultiArray

from arpd.relay.ends.offers import EndState, decode_state, encode_state
from arpd.relay.envelope import WRAP, Chunk, encode_chunk
from arpd.relay.flight import Sign, encode_sign
from arpd.ros.cdr import wrap
from arpd.ros.graph import GraphView
from tests.ros.world import DOMAIN, REPO, Ros

ROBOT, BASE, LINK = DOMAIN, DOMAIN + 1, DOMAIN + 2


class TwoEnds:
    """Starts, kills and restarts the ends; keeps their status lines, and counts their pings."""

    def __init__(self, folder, stack, relay=(), domains=(ROBOT, BASE)):
        self._folder = folder
        self._stack = self.nodes = stack
        self._domains = dict(zip(("robot", "base", "link"), (*domains, LINK), strict=True))
        self.config = folder / "arpd.yaml"
        lines = [f"  link_domain: {LINK}", "  robot: 127.0.0.1", "  base: 127.0.0.1", *(f"  {line}" for line in relay)]
        self.config.write_text("relay:\n" + "\n".join(lines) + "\n")
        self.processes = {}
        self.status = {"robot": "", "base": ""}
        self.pings = {"robot": 0, "base": 0}  # of the watchdog

    def start(self, *ends, **environment):
        for end in ends or ("robot", "base"):
            address, far = self._listen(end), ["--far"] if end == "base" else []
            self.processes[end] = subprocess.Popen(
                [sys.executable, "-m", "arpd.cli", "relay", *far, "--config", self.config],
                cwd=REPO,
                env={
                    **{key: value for key, value in os.environ.items() if "DEFAULT_PROFILES" not in key},
                    "ROS_DOMAIN_ID": str(self._domains[end]),
                    "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
                    "FASTDDS_BUILTIN_TRANSPORTS": "UDPv4",
                    "NOTIFY_SOCKET": address,
                    **environment,
                },
                stderr=(self._folder / f"{end}.log").open("a"),
            )
            self._stack.callback(self.end, end, signal.SIGTERM)
        return self

    def end(self, end, number=signal.SIGKILL):
        process = self.processes[end]
        with suppress(ProcessLookupError):
            process.send_signal(number)
        return process.wait(timeout=60)

    def side(self, name):
        """Return a maker of nodes on one side, or on the link, all in one participant; ``nodes`` destroys them."""
        return Ros(self.nodes, self._domains[name])

    def _listen(self, end):
        address = f"\0arpd-test-{os.getpid()}-{end}-{len(self.processes)}-{os.urandom(4).hex()}"
        notices = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        notices.bind(address)
        self._stack.callback(notices.close)

        def listen():
            with suppress(OSError):
                while True:
                    for line in notices.recv(65536).decode().splitlines():
                        if line.startswith("STATUS="):
                            self.status[end] = line.removeprefix("STATUS=")
                        self.pings[end] += line == "WATCHDOG=1"

        threading.Thread(target=listen, daemon=True).start()
        return "@" + address[1:]


class Stranger:
    """Stands for the base computer's end in the domain of the link, with a state that the test says."""

    session = 1

    def __init__(self, node, **state):
        self.node, self._chunks = node, count(1)
        self._told = listen(node, "/arpd/relay/robot", latched(1), UInt8MultiArray)
        self._signs = node.create_publisher(UInt8MultiArray, "/arpd/relay/base/alive", 1)
        self._states = node.create_publisher(UInt8MultiArray, "/arpd/relay/base", latched(1))
        link_gids = GraphView.of(node).own.participant.hex()
        told = EndState(session=self.session, link_gids=link_gids, **state)
        self._states.publish(wrap(encode_state(told)))

    @property
    def offered(self):
        """What the robot's end has told last, None before that."""
        return decode_state(bytes(self._told[-1])) if self._told else None

    def live(self):
        """Send a sign of life."""
        self._signs.publish(wrap(encode_sign(Sign(self.session))))

    def send(self, publisher, message, *, late_s=0.0):
        """Write a message to a topic of the link, as if it had left so long ago."""
        number, departed_us = next(self._chunks), int((time.monotonic() - late_s) * 1e6) % WRAP
        chunk = Chunk(self.session, number, departed_us, number, 0, len(message), is_kept=False, part=message)
        publisher.publish(encode_chunk(chunk))


RELIABLE = QoSProfile(depth=1000)
BEST_EFFORT = QoSProfile(depth=1000, reliability=QoSReliabilityPolicy.BEST_EFFORT)


def latched(depth):
    return QoSProfile(depth=depth, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)


def listen(node, topic, qos=RELIABLE, msg_type=String):
    received = []
    node.create_subscription(msg_type, topic, lambda message: received.append(message.data), qos)
    return received


class Counter:
    """A writer that numbers what it publishes: ``name number``."""

    def __init__(self, node, msg_type, topic, qos, name=""):
        self.publisher = node.create_publisher(msg_type, topic, qos)
        self.msg_type, self.name, self.sent = msg_type, name or node.get_name(), 0

    def publish(self, times=1):
        for _ in range(times):
            self.publisher.publish(self.msg_type(data=f"{self.name} {self.sent}"))
            self.sent += 1


def numbers(texts, name):
    """Return the numbers that one writer gave, in the order of their arrival."""
    return [int(number) for writer, number in (text.split() for text in texts) if writer == name]


def is_whole(texts, name):
    """Return whether the numbers of a writer begin somewhere, and then none is missing, doubled or out of order."""
    found = numbers(texts, name)
    return found == list(range(found[0], found[0] + len(found)))
