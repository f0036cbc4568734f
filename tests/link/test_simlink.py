"""The simulated link with real packets: rate, queue, loss, environment and cleanup."""

from __future__ import annotations

import os
import signal
import socket
import statistics
import struct
import subprocess
import sys
import time
from itertools import count
from pathlib import Path

import pytest

pytest.importorskip("pyroute2", reason="the simulated link needs pyroute2: pip install pyroute2")

from pyroute2 import netns

from arpd.model.errors import LinkError
from scripts.netns.namespaces import inside
from scripts.netns.simlink import SimLink, available, cleanup_stale, user_namespace_argv
from tests.waiting import eventually

WORKS, WHY_NOT = available()
pytestmark = [pytest.mark.link, pytest.mark.skipif(not WORKS, reason=f"no simulated link here: {WHY_NOT}")]

SCRIPT = str(Path(__file__).parents[2] / "scripts" / "simlink")
MBIT = 125_000.0
PORT = 5000
HEADERS_BYTES = 42  # Ethernet, IPv4, UDP: what the bucket counts besides the payload
SO_TIMESTAMPNS = 35

_serial = count()


@pytest.fixture
def run_id():
    return f"test-{os.getpid()}-{next(_serial)}"


def sender(link):
    return inside(link.robot.namespace, lambda: socket.socket(socket.AF_INET, socket.SOCK_DGRAM))


def receiver(link):
    def bound():
        sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4_000_000)
        sock.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        sock.bind((link.ceddp.address, PORT))
        sock.settimeout(0.3)
        return sock

    return inside(link.ceddp.namespace, bound)


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


def flood_rate(link, source, sink, duration_s):
    until_s = time.monotonic() + duration_s
    while time.monotonic() < until_s:
        source.sendto(bytes(1400), (link.ceddp.address, PORT))
    return delivery_rate(drain(sink))


def train_rate(link, source, sink):
    """Return the median rate of trains of 10 x 1200 B, sent back to back (bytes/s)."""
    rates = []
    for _ in range(9):
        time.sleep(0.02)
        for _ in range(10):
            source.sendto(bytes(1200), (link.ceddp.address, PORT))
        rates.append(delivery_rate(drain(sink, most=10)))
    return statistics.median(rates)


def namespaces_of(run_id):
    return [name for name in netns.listnetns() if name.startswith(f"arpd-{run_id}-")]


def test_two_links_live_side_by_side(run_id):
    """The traffic of one link does not reach another."""
    with SimLink(f"{run_id}-a") as a, SimLink(f"{run_id}-b") as b:
        with sender(a) as source, receiver(a) as sink:
            source.sendto(b"hello", (a.ceddp.address, PORT))
            assert [payload for payload, _ in drain(sink, most=1)] == [b"hello"]
        assert a.counters()["ceddp"].rx_bytes == 5 + HEADERS_BYTES
        assert b.counters()["ceddp"].rx_bytes == 0


def test_an_idle_link_is_silent(run_id):
    """An idle link carries no packet, not even router solicitations or ARP."""
    with SimLink(run_id) as link:
        time.sleep(1.5)
        assert all(end.rx_bytes == end.tx_bytes == 0 and end.is_up for end in link.counters().values())


def test_floods_and_trains_run_at_the_configured_rate(run_id):
    """At 5 and 20 Mbit/s a flood and even a short packet train have the configured rate."""
    with SimLink(run_id) as link, sender(link) as source, receiver(link) as sink:
        measured = {}
        for mbit in (5, 20):
            link.set_rate(mbit * MBIT)
            measured[mbit] = (train_rate(link, source, sink), flood_rate(link, source, sink, 1.5))
            shares = [rate / (mbit * MBIT) for rate in measured[mbit]]
            print(f"{mbit} Mbit/s: train {shares[0]:.3f}, flood {shares[1]:.3f} of the rate")
        # The bounds of the ratios are wide, because another job on the machine slows both.
        assert measured[20][0] / measured[5][0] == pytest.approx(4.0, rel=0.25)
        assert measured[20][1] / measured[5][1] == pytest.approx(4.0, rel=0.25)
        assert measured[5][0] == pytest.approx(5 * MBIT, rel=0.15)
        assert measured[5][1] == pytest.approx(5 * MBIT, rel=0.15)


def test_a_rate_change_takes_effect_at_once_and_keeps_the_queue(run_id):
    """Packets queued at the old rate leave at the new one, in order and without loss."""
    with SimLink(run_id, rate_bytes_per_second=1 * MBIT) as link, sender(link) as source, receiver(link) as sink:
        sent = [index.to_bytes(4, "big") + bytes(1196) for index in range(60)]
        for payload in sent:
            source.sendto(payload, (link.ceddp.address, PORT))
        link.set_rate(10 * MBIT)
        start_s = time.monotonic()
        arrivals = drain(sink, most=len(sent))
        assert time.monotonic() - start_s < 0.3  # 60 ms at the new rate, 600 ms at the old one
        assert [payload for payload, _ in arrivals] == sent


def test_a_full_queue_drops_and_counts(run_id):
    """Packets that do not fit into the queue count as dropped at the sender."""
    with SimLink(run_id, rate_bytes_per_second=1 * MBIT, queue_bytes=20_000) as link, sender(link) as source:
        for _ in range(60):
            source.sendto(bytes(1200), (link.ceddp.address, PORT))
        dropped = link.counters()["robot"].tx_dropped
        assert 60 - dropped == pytest.approx(20_000 / 1242, abs=8)


def test_loss_comes_and_goes(run_id):
    """A fifth of the packets is lost at loss 0.2, none at 0 and all at 1, and lost packets have crossed the link."""
    with SimLink(run_id, rate_bytes_per_second=100 * MBIT, loss=0.2) as link:
        with sender(link) as source, receiver(link) as sink:
            arrived = {}
            for loss in (0.2, 0.0, 1.0):
                link.set_loss(loss)
                for _ in range(1500):
                    source.sendto(bytes(100), (link.ceddp.address, PORT))
                arrived[loss] = len(drain(sink))
        assert 1125 < arrived[0.2] < 1275  # 1200 expected, five standard deviations (15.5) either side
        assert arrived[0.0] == 1500
        assert arrived[1.0] == 0
        assert link.counters()["ceddp"].rx_packets == 4500


def test_processes_inside_get_the_ros_environment(run_id):
    """ROS inside uses UDP and the link's own domain, regardless of the caller's environment."""
    with SimLink(run_id, domain_id=42) as link:
        show = ["sh", "-c", "echo $FASTDDS_BUILTIN_TRANSPORTS $ROS_DOMAIN_ID $MINE ${ROS_LOCALHOST_ONLY-unset}"]
        environment = {**os.environ, "ROS_DOMAIN_ID": "7", "ROS_LOCALHOST_ONLY": "1", "MINE": "kept"}
        process = link.popen("robot", show, env=environment, stdout=subprocess.PIPE, text=True)
        assert process.communicate(timeout=10)[0].split() == ["UDPv4", "42", "kept", "unset"]


def test_an_exception_leaves_nothing_behind(run_id):
    """An exception in the block ends all processes inside, also those that ignore SIGTERM, and the namespaces."""
    with pytest.raises(RuntimeError, match="on purpose"), SimLink(run_id) as link:  # noqa: PT012
        stubborn = link.popen(link.ceddp, ["bash", "-c", "trap '' TERM; echo on; while :; do sleep 1; done"], stdout=-1)
        assert stubborn.stdout.readline() == b"on\n"
        raise RuntimeError("on purpose")
    assert stubborn.returncode == -signal.SIGKILL
    assert namespaces_of(run_id) == []


def test_a_run_id_in_use_is_refused(run_id):
    """A second run of the same name is refused, and the first one continues."""
    with SimLink(run_id) as link:
        with pytest.raises(LinkError, match="is in use by process"), SimLink(run_id):
            pass
        assert link.counters()["robot"].is_up
    assert namespaces_of(run_id) == []


def test_what_a_killed_holder_leaves_is_cleaned_up(run_id):
    """After kill -9 of the holder, cleanup_stale ends the processes inside and removes the namespaces."""
    code = (
        "import time; from scripts.netns.simlink import SimLink\n"
        f"with SimLink({run_id!r}) as link:\n"
        "    print(link.popen('robot', ['sleep', '1000']).pid, flush=True); time.sleep(1000)"
    )
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as holder:
        orphan = int(holder.stdout.readline())
        eventually(lambda: Path(f"/proc/{orphan}/comm").read_text(encoding="utf-8") == "sleep\n")
        cleanup_stale()
        assert len(namespaces_of(run_id)) == 2, "a living holder keeps its link"
        holder.kill()
    cleanup_stale()
    assert namespaces_of(run_id) == []
    stat = Path(f"/proc/{orphan}/stat")
    eventually(lambda: not stat.exists() or stat.read_text(encoding="utf-8").split()[2] == "Z")


def test_a_holder_lives_for_a_process_with_other_clocks_too(run_id):
    """In a time namespace the same holder shows another start; its link stays nevertheless."""
    clocks = ["unshare", "--time", f"--boottime=-{int(time.clock_gettime(time.CLOCK_BOOTTIME)) - 1}", "--fork", "--"]
    if subprocess.run([*clocks, "true"], capture_output=True, check=False).returncode != 0:
        pytest.skip("unshare --time is refused here")
    with SimLink(run_id):
        cleaned = run_script("--cleanup", prefix=clocks)
        assert (cleaned.returncode, len(namespaces_of(run_id))) == (0, 2), cleaned.stderr


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_the_script_cleans_up_when_told_to_stop(run_id, number, code):
    """Ctrl-C and SIGTERM end the commands and remove the link."""
    command = [SCRIPT, "--run-id", run_id, "--robot", "echo up; exec sleep 1000"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as script:
        assert script.stdout.readline() == "up\n"
        script.send_signal(number)
        try:
            assert script.wait(timeout=10) == code
        finally:
            script.kill()  # so that a failure does not hang
    assert namespaces_of(run_id) == []


def run_script(*arguments, prefix=()):
    return subprocess.run([*prefix, SCRIPT, *arguments], capture_output=True, text=True, timeout=30, check=False)


TALK = "for i in $(seq 20); do echo hello > /dev/udp/10.77.0.2/9; done"


def test_the_script_checks_that_bytes_cross(run_id):
    """The run fails if its commands send nothing over the link, and shows the bytes that crossed."""
    arguments = ("--run-id", run_id, "--require-bytes", "900", "--robot")
    silent = run_script(*arguments, "true")
    assert (silent.returncode, "0 bytes crossed the link" in silent.stderr) == (1, True), silent.stderr
    talking = run_script(*arguments, TALK)
    assert talking.returncode == 0, talking.stderr
    assert f"robot -> ceddp: {20 * (6 + HEADERS_BYTES)} bytes in 20 packets" in talking.stderr


def test_the_script_ends_with_the_first_failure(run_id):
    """The first command that fails ends the other one and gives the exit code."""
    failed = run_script("--run-id", run_id, "--robot", "exit 7", "--ceddp", "sleep 1000")
    assert failed.returncode == 7, failed.stderr


def test_the_script_runs_one_command_and_plays_the_schedule(run_id):
    """The option --exec runs one command on a host while the rate follows the schedule."""
    done = run_script(
        *("--run-id", run_id, "--schedule", "0:20mbit,0.2:5mbit", "--exec", "ceddp"),
        *("--", "sh", "-c", "sleep 0.5; tc qdisc show dev link0"),
    )
    assert done.returncode == 0, done.stderr
    assert "rate 5Mbit" in done.stdout
    assert "5 Mbit/s" in done.stderr


ROS_NODE = """
import sys, time, rclpy
from std_msgs.msg import String
rclpy.init()
node = rclpy.create_node(sys.argv[1])
until_s = time.monotonic() + 15
if sys.argv[1] == "talker":
    publisher = node.create_publisher(String, "talk", 50)
    while publisher.get_subscription_count() == 0 and time.monotonic() < until_s:
        time.sleep(0.02)
    for _ in range(50):
        publisher.publish(String(data="x" * 1000))
    publisher.wait_for_all_acked()
else:
    heard = []
    node.create_subscription(String, "talk", heard.append, 50)
    while len(heard) < 50 and time.monotonic() < until_s:
        rclpy.spin_once(node, timeout_sec=0.1)
    sys.exit(len(heard) != 50)
"""


@pytest.mark.ros
def test_ros_messages_cross_the_link(run_id):
    """Fifty messages of 1 kB between two nodes take at least 50 kB of the link, so not shared memory."""
    pytest.importorskip("rclpy")
    with SimLink(run_id) as link:
        nodes = [
            link.popen("robot", [sys.executable, "-c", ROS_NODE, "talker"]),
            link.popen("ceddp", [sys.executable, "-c", ROS_NODE, "listener"]),
        ]
        assert [node.wait(timeout=30) for node in nodes] == [0, 0]
        assert link.counters()["ceddp"].rx_bytes > 50_000


def test_a_user_namespace_is_enough(run_id):
    """The link works as root of a user namespace, so without real root if the system allows user namespaces."""
    probe = subprocess.run(user_namespace_argv(["true"]), capture_output=True, text=True, check=False)
    if probe.returncode != 0:
        pytest.skip(f"user namespaces are refused here: {probe.stderr.strip()}")
    done = run_script(
        *("--run-id", run_id, "--loss", "0.01", "--require-bytes", "500", "--robot", TALK),
        prefix=user_namespace_argv([]),
    )
    assert done.returncode == 0, done.stderr
    assert namespaces_of(run_id) == []
