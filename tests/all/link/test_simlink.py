"""The simulated link with real packets: rate, queue, loss, environment and cleanup."""

from __future__ import annotations

import os
import socket
import statistics
import struct
import subprocess
import sys
from itertools import count
from pathlib import Path

import pytest

pytest.importorskip("pyroute2", reason="the simulated link needs pyroute2: pip install pyroute2")

from pyroute2 import netns

from arpd.model.errors import LinkError
from scripts.netns.namespaces import inside
from scripts.netns.simlink import SimLink, available, cleanup_stale
from tests.waiting import eventually

WORKS, WHY_NOT = available()
pytestmark = [pytest.mark.link, pytest.mark.skipif(not WORKS, reason=f"no simulated link here: {WHY_NOT}")]

MBIT = 125_000.0
PORT = 5000
HEADERS_BYTES = 42  # Ethernet, IPv4, UDP: what the bucket counts besides the payload
SO_TIMESTAMPNS = 35
SO_RCVBUFFORCE = 33  # beyond what the machine allows a user

_serial = count()


@pytest.fixture
def run_id():
    return f"test-{os.getpid()}-{next(_serial)}"


def sender(link):
    return inside(link.robot.namespace, lambda: socket.socket(socket.AF_INET, socket.SOCK_DGRAM))


def receiver(link):
    def bound():
        sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        sock.setsockopt(socket.SOL_SOCKET, SO_RCVBUFFORCE, 8_000_000)
        sock.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        sock.bind((link.base.address, PORT))
        sock.settimeout(1.0)
        return sock

    return inside(link.base.namespace, bound)


def drain(sock, most=sys.maxsize):
    """Return payload and kernel's arrival time (s) of packets, until silence or ``most`` of them."""
    arrivals = []
    while len(arrivals) < most:
        try:
            payload, ancillary, _, _ = sock.recvmsg(2048, 64)
        except TimeoutError:
            break
        seconds, nanoseconds = struct.unpack("ll", ancillary[0][2][:16])
        arrivals.append((payload, seconds + nanoseconds * 1e-9))
    return arrivals


def delivery_rate(arrivals):
    """Return the bytes after the first packet over the time they took (bytes/s)."""
    wire_bytes = sum(len(payload) + HEADERS_BYTES for payload, _ in arrivals[1:])
    return wire_bytes / (arrivals[-1][1] - arrivals[0][1])


def flood_rate(link, source, sink):
    """Return the rate of what a full queue delivers (bytes/s)."""
    for _ in range(300):
        source.sendto(bytes(1400), (link.base.address, PORT))
    return delivery_rate(drain(sink))


def train_rate(link, source, sink):
    """Return the median rate of trains of 10 x 1200 B, sent back to back (bytes/s)."""
    rates = []
    for _ in range(9):
        for _ in range(10):
            source.sendto(bytes(1200), (link.base.address, PORT))
        rates.append(delivery_rate(drain(sink, most=10)))
    return statistics.median(rates)


def namespaces_of(run_id):
    return [name for name in netns.listnetns() if name.startswith(f"simlink-{run_id}-")]


@pytest.mark.parametrize("bottleneck", ["sender", "middle"])
def test_floods_and_trains_run_at_the_configured_rate(run_id, bottleneck):
    """At 5 and 20 Mbit/s a flood and even a short packet train have the configured rate."""
    trains, floods = {5: [], 20: []}, {5: [], 20: []}
    with SimLink(run_id, bottleneck=bottleneck) as link, sender(link) as source, receiver(link) as sink:
        for mbit in (5, 20) * 3:
            link.set_rate(mbit * MBIT)
            trains[mbit].append(train_rate(link, source, sink) / MBIT)
            floods[mbit].append(flood_rate(link, source, sink) / MBIT)
    print(f"Mbit/s of trains: {trains}, of floods: {floods}")
    for kind in (trains, floods):
        slow, fast = statistics.median(kind[5]), statistics.median(kind[20])
        # A busy machine may deliver late, so the bounds are wide; the two rates differ by four.
        assert 2.5 < slow < 7.5
        assert 2.0 < fast / slow < 6.0


def test_loss_comes_and_goes(run_id):
    """A fifth of the packets is lost at loss 0.2, none at 0 and all at 1, and lost packets have crossed the link."""
    with SimLink(run_id, rate_bytes_per_second=100 * MBIT, queue_bytes=500_000, loss=0.2) as link:
        with sender(link) as source, receiver(link) as sink:
            arrived = {}
            for loss in (0.2, 0.0, 1.0):
                link.set_loss(loss)
                for _ in range(1500):
                    source.sendto(bytes(100), (link.base.address, PORT))
                arrived[loss] = len(drain(sink))
        assert 1125 < arrived[0.2] < 1275  # 1200 expected, five standard deviations (15.5) either side
        assert arrived[0.0] == 1500
        assert arrived[1.0] == 0
        assert link.counters()["base"].rx_packets == 4500


def test_what_a_killed_holder_leaves_is_cleaned_up(run_id):
    """After kill -9 of the holder, cleanup_stale ends the processes inside and removes the namespaces."""
    code = (
        "import time; from scripts.netns.simlink import SimLink\n"
        f"with SimLink({run_id!r}) as link:\n"
        "    print(link.popen('robot', ['sleep', '1000']).pid, flush=True); time.sleep(1000)"
    )
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as holder:
        orphan = int(holder.stdout.readline())
        eventually("the process is there", lambda: Path(f"/proc/{orphan}/comm").read_text() == "sleep\n")
        cleanup_stale()
        assert len(namespaces_of(run_id)) == 2, "a living holder keeps its link"
        with pytest.raises(LinkError, match="is in use by process"), SimLink(run_id):
            pass
        holder.kill()
    cleanup_stale()
    assert namespaces_of(run_id) == []
    stat = Path(f"/proc/{orphan}/stat")
    eventually("the process ends", lambda: not stat.exists() or stat.read_text().split()[2] == "Z")
