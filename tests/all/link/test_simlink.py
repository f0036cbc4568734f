"""The simulated link with real packets: rate, queue, loss, environment and cleanup."""

import os
import socket
import statistics
import struct
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest

pytest.importorskip("pyroute2", reason="the simulated link needs pyroute2: pip install pyroute2")

from pyroute2 import netns

from arpd.model.errors import LinkError
from scripts.netns.namespaces import cleanup_stale, inside
from scripts.netns.simlink import SimLink, available
from tests.waiting import eventually

WORKS, WHY_NOT = available()
pytestmark = [pytest.mark.link, pytest.mark.skipif(not WORKS, reason=f"no simulated link here: {WHY_NOT}")]

MBIT = 125_000.0
PORT = 5000
HEADERS_BYTES = 42  # Ethernet, IPv4, UDP: what the bucket counts besides the payload
SO_TIMESTAMPNS = 35
SO_RCVBUFFORCE = 33  # beyond what the machine allows a user


@pytest.fixture
def run_id():
    return f"test-{os.getpid()}"


def sockets(link):
    """Return a socket to send with on the robot, and one on the base computer that says when the kernel received."""

    def bound():
        sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        sock.setsockopt(socket.SOL_SOCKET, SO_RCVBUFFORCE, 8_000_000)
        sock.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        sock.bind((link.base.address, PORT))
        sock.settimeout(1.0)
        return sock

    source = inside(link.robot.namespace, lambda: socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
    return source, inside(link.base.namespace, bound)


def arrivals(link, source, sink, packets, payload_bytes):
    """Send packets back to back, and return when each of those that arrived did (s)."""
    for _ in range(packets):
        source.sendto(bytes(payload_bytes), (link.base.address, PORT))
    times_s = []
    with suppress(TimeoutError):
        while len(times_s) < packets:
            _, ((_, _, stamp),), _, _ = sink.recvmsg(2048, 64)
            seconds, nanoseconds = struct.unpack("ll", stamp[:16])
            times_s.append(seconds + nanoseconds * 1e-9)
    return times_s


def rate(link, source, sink, packets, payload_bytes):
    """Return the rate at which packets arrive that are sent back to back (Mbit/s)."""
    times_s = arrivals(link, source, sink, packets, payload_bytes)
    return (len(times_s) - 1) * (payload_bytes + HEADERS_BYTES) / (times_s[-1] - times_s[0]) / MBIT


def namespaces_of(run_id):
    return [name for name in netns.listnetns() if name.startswith(f"simlink-{run_id}-")]


@pytest.mark.parametrize("bottleneck", ["sender", "middle"])
def test_floods_and_trains_run_at_the_configured_rate(run_id, bottleneck):
    """At 5 and 20 Mbit/s a flood and even a short packet train have the configured rate."""
    trains, floods = {5: [], 20: []}, {5: [], 20: []}
    with SimLink(run_id, bottleneck=bottleneck) as link:
        ends = sockets(link)
        for mbit in (5, 20) * 3:
            link.set_rate(mbit * MBIT)
            trains[mbit] += [rate(link, *ends, 10, 1200) for _ in range(3)]
            floods[mbit].append(rate(link, *ends, 300, 1400))
    print(f"Mbit/s of trains: {trains}, of floods: {floods}")
    for kind in (trains, floods):
        slow, fast = statistics.median(kind[5]), statistics.median(kind[20])
        # A busy machine may deliver late, so the bounds are wide; the two rates differ by four.
        assert 2.5 < slow < 7.5
        assert 2.0 < fast / slow < 6.0


def test_loss_comes_and_goes(run_id):
    """A fifth of the packets is lost at loss 0.2, none at 0 and all at 1, and lost packets have crossed the link."""
    with SimLink(run_id, rate_bytes_per_second=100 * MBIT, queue_bytes=500_000, loss=0.2) as link:
        ends, arrived = sockets(link), {}
        for loss in (0.2, 0.0, 1.0):
            link.set_loss(loss)
            arrived[loss] = len(arrivals(link, *ends, 1500, 100))
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
