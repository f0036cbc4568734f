"""Two hosts, ``robot`` and ``base``, joined by one slow link, on one machine with real kernel networking.

Each host is a network namespace; a veth pair joins them; a token bucket (tbf) with a byte-limited queue shapes each
end, so real processes and real DDS traffic meet real queueing. An nftables rule drops packets at random where they
arrive, behind the queue, because on the air a lost packet uses its share of the link, too. With the bottleneck in the
middle, the buckets are in a third namespace between the hosts, where no socket of theirs is pushed back.
"""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import threading
import time
import zlib
from contextlib import ExitStack, suppress
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, Literal, Self

from pyroute2 import IPRoute, NetlinkError

from arpd.model.errors import LinkError
from arpd.model.wire import MTU_BYTES
from scripts.netns import link_end
from scripts.netns.link_end import Bucket, Host
from scripts.netns.namespaces import HOST_NAMES, HostName, claim, executable, inside, namespace_of, release

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path
    from types import FrameType

    from arpd.model.interface import LinkCounters

Bottleneck = Literal["sender", "middle"]

DEFAULT_RATE_BYTES_PER_SECOND = 2_500_000.0  # 20 Mbit/s
DEFAULT_QUEUE_BYTES = 256_000  # about the queue of a Wi-Fi driver; 102 ms at 20 Mbit/s, 410 ms at 5 Mbit/s
INTERFACE = "link0"
STALLED = 1.0  # bytes/s: nothing passes, and nothing is lost
MIN_BURST_BYTES = MTU_BYTES + 40  # a full frame and the rounding of tbf, which drops frames above its bucket size

_TIMER_SLACK_S = 100e-6  # lateness of the kernel's timer up to which the bucket loses no credit
_FIRST_INDEX = 77
_CARRIER_TIMEOUT_S = 5.0
_CABLE = Bucket(rate_bytes_per_second=125e6, burst_bytes=14_000, queue_bytes=1_000_000)  # a host's, to the middle
_DISCARD_PORT = 9
OUTER_PID = "ARPD_OUTER_PID"


class SimLink:
    """The link and its two hosts while the ``with`` block lasts.

    The end of the block, also by an exception, Ctrl-C or SIGTERM, ends every process inside and removes the
    namespaces. After ``kill -9``, the next link or ``cleanup_stale`` removes them.

    Parameters
    ----------
    run_id : name of the link, so that several can exist at once
    rate_bytes_per_second : rate of each direction, Ethernet headers included (bytes/s)
    queue_bytes : queue in front of each bucket, with tail drop (bytes)
    loss : probability that an arriving packet is dropped, 0..1
    bottleneck : whether the buckets are on the senders' interfaces or between the hosts
    domain_id : ROS_DOMAIN_ID of every process inside; None = derived from the run id
    memory : folder in memory, where each host has its own shared memory; None = that of this machine
    is_memory_private : each process has its own; two of them with TCP could else use one port of the other host
    congestion : TCP's congestion control; Debian and Ubuntu have cubic, this machine may have another

    Attributes
    ----------
    robot, base, hosts : the two ends, and both
    """

    def __init__(
        self,
        run_id: str,
        *,
        rate_bytes_per_second: float = DEFAULT_RATE_BYTES_PER_SECOND,
        queue_bytes: int = DEFAULT_QUEUE_BYTES,
        loss: float = 0.0,
        bottleneck: Bottleneck = "sender",
        domain_id: int | None = None,
        memory: Path | None = None,
        is_memory_private: bool = False,
        congestion: str = "cubic",
    ) -> None:
        self.run_id = run_id
        self.robot, self.base = self.hosts = _hosts(run_id)
        # Above 101, the ports that DDS derives from the domain meet Linux's ephemeral ports.
        self.domain_id = 1 + zlib.crc32(run_id.encode()) % 101 if domain_id is None else domain_id
        self._middle = namespace_of(run_id, "middle") if bottleneck == "middle" else None
        self.rate_bytes_per_second = _checked_rate(rate_bytes_per_second)
        if queue_bytes < MIN_BURST_BYTES:
            raise ValueError(f"the queue must hold one full frame: at least {MIN_BURST_BYTES} bytes")
        self._queue_bytes = queue_bytes
        self._loss = _checked_loss(loss)
        self._has_loss_rule = False
        self._memory, self._is_memory_private = memory, is_memory_private
        self._congestion = congestion
        self._processes: list[subprocess.Popen[Any]] = []
        self._undo = ExitStack()

    def __enter__(self) -> Self:
        with ExitStack() as undo:
            # SIGTERM's default action would skip every `finally`. A handler of the program itself stays.
            is_main = threading.current_thread() is threading.main_thread()
            if is_main and signal.getsignal(signal.SIGTERM) is signal.SIG_DFL:
                undo.callback(signal.signal, signal.SIGTERM, signal.signal(signal.SIGTERM, _exit_on_signal))
            claim(self.run_id, [*(host.namespace for host in self.hosts), *filter(None, [self._middle])])
            undo.callback(self._tear_down)
            try:
                self._build()
            except (NetlinkError, OSError) as error:
                raise LinkError(f"cannot build the simulated link: {error}") from error
            self._undo = undo.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._undo.close()

    def set_rate(self, rate_bytes_per_second: float) -> None:
        """Change the rate of both directions; queued packets stay, at STALLED all of them."""
        self.rate_bytes_per_second = _checked_rate(rate_bytes_per_second)
        for end in self._shaped():
            if rate_bytes_per_second == STALLED:
                _stall(end, self._queue_bytes)
            else:
                inside(end.namespace, partial(link_end.reshape, end, self._bucket()))
        for host in self.hosts:
            inside(host.namespace, partial(_knock, host))

    def set_loss(self, loss: float) -> None:
        """Change the probability that an arriving packet is dropped, in both directions (0..1)."""
        self._loss = _checked_loss(loss)
        if self._loss > 0.0 or self._has_loss_rule:
            for host in self.hosts:
                inside(host.namespace, partial(link_end.set_loss, host, self._loss))
            self._has_loss_rule = True

    def counters(self) -> dict[HostName, LinkCounters]:
        """Return the interface counters of each end; ``tx_dropped`` includes the drops of its full queue.

        A packet that random loss drops counts as received, because it has crossed the link.
        """
        return {host.name: inside(host.namespace, partial(link_end.read_counters, host)) for host in self.hosts}

    def popen(
        self, host: Host | HostName, argv: Sequence[str], *, env: Mapping[str, str] | None = None, **popen_kwargs: Any
    ) -> subprocess.Popen[Any]:
        """Start a command on a host as the leader of a session, so that ``os.killpg(process.pid, ...)`` ends all of it.

        Parameters
        ----------
        host : one of the ends, or its name
        argv : command and arguments
        env : environment, None = this process's; `ros_environment` overrides it
        popen_kwargs : passed to `subprocess.Popen`
        """
        name = host if isinstance(host, str) else host.name
        if self._memory is not None:  # `ip netns exec` gives the command mounts of its own
            shared = self._memory / name
            shared.mkdir(exist_ok=True)
            mount = "mount -t tmpfs tmpfs" if self._is_memory_private else 'mount --bind "$0"'
            argv = ["sh", "-c", f'{mount} /dev/shm && exec "$@"', str(shared), *argv]
        command = [executable("ip"), "netns", "exec", namespace_of(self.run_id, name), *argv]
        environment = {**(os.environ if env is None else env), **self.ros_environment()}
        environment.pop("ROS_LOCALHOST_ONLY", None)  # it would keep every message off the link
        popen_kwargs.setdefault("start_new_session", True)
        process: subprocess.Popen[Any] = subprocess.Popen(command, env=environment, **popen_kwargs)
        self._processes.append(process)
        return process

    def ros_environment(self) -> dict[str, str]:
        """Return variables that make ROS 2 use the link: no shared memory, which ignores namespaces, and a domain."""
        return {
            "FASTDDS_BUILTIN_TRANSPORTS": "UDPv4",
            "ROS_DOMAIN_ID": str(self.domain_id),
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET",
        }

    def _build(self) -> None:
        for namespace in (*filter(None, [self._middle]), *(host.namespace for host in self.hosts)):
            inside(namespace, link_end.disable_ipv6)
        ends: list[dict[str, Any]] = [
            {"ifname": host.interface, "net_ns_fd": host.namespace, "address": host.mac, "mtu": MTU_BYTES}
            for host in self.hosts
        ]
        cables = [(ends[0], ends[1])]
        if self._middle is not None:
            ports = ({"ifname": end.interface, "net_ns_fd": end.namespace, "mtu": MTU_BYTES} for end in self._shaped())
            cables = list(zip(ends, ports, strict=True))
        with IPRoute() as outside:
            # The first device of every namespace gets index 2. If both ends of a veth have the same index, the kernel
            # sees a device without a peer, and its carrier may take a second to come up (linkwatch_urgent_event).
            for k, (end, peer) in enumerate(cables):
                outside.link("add", kind="veth", index=_FIRST_INDEX + k, peer=peer, **end)
        for host in self.hosts:
            bucket = self._bucket() if self._middle is None else _CABLE
            inside(host.namespace, partial(link_end.raise_up, host, bucket, self._congestion))
        if self._middle is not None:
            inside(self._middle, partial(link_end.bridge, self._shaped(), self._bucket()))
        self.set_loss(self._loss)
        self._await_carrier()

    def _shaped(self) -> list[Host]:
        """Return the interfaces that have the buckets: the hosts', or in the middle those named after the hosts."""
        if self._middle is None:
            return list(self.hosts)
        return [replace(host, namespace=self._middle, interface=host.name) for host in self.hosts]

    def _await_carrier(self) -> None:
        """Wait until the kernel uses both buckets; it silently drops earlier packets."""
        deadline_s = time.monotonic() + _CARRIER_TIMEOUT_S
        while not all(end.is_up for end in self.counters().values()):
            if time.monotonic() > deadline_s:
                raise LinkError(f"the veth pair of run {self.run_id!r} has no carrier after {_CARRIER_TIMEOUT_S:g} s")
            time.sleep(0.005)

    def _bucket(self) -> Bucket:
        rate = self.rate_bytes_per_second
        return Bucket(rate_bytes_per_second=rate, burst_bytes=_burst_bytes(rate), queue_bytes=self._queue_bytes)

    def _tear_down(self) -> None:
        for process in self._processes:
            if process.poll() is None:
                process.terminate()  # it may not be in the namespace yet, where `release` looks
        release(self.run_id)
        for process in self._processes:
            process.wait()


def available() -> tuple[bool, str]:
    """Return whether a SimLink works in this process, by building one, and if not, the reason and the way out."""
    if os.geteuid() != 0:
        return False, "not root, and not in a user namespace; run it as root"
    try:
        with SimLink(f"probe-{os.getpid()}-{threading.get_ident()}", loss=0.5) as link:
            link.counters()
    except LinkError as error:
        return False, str(error)
    return True, ""


def usable_link(module: str, arguments: Sequence[str]) -> tuple[bool, str]:
    """Return what `available` does; without root, run the module again as root of a user namespace if that works."""
    if os.geteuid() != 0:
        try:
            probe = subprocess.run(user_namespace_argv(["true"]), capture_output=True, text=True, check=False)
        except LinkError as error:
            return False, f"not root, and {error}"
        if probe.returncode != 0:
            return False, f"not root, and user namespaces are refused here ({probe.stderr.strip()})"
        command = user_namespace_argv([sys.executable, "-m", module, *arguments])
        os.execve(command[0], command, {**os.environ, OUTER_PID: str(os.getpid())})
    return available()


def user_namespace_argv(argv: Sequence[str]) -> list[str]:
    """Return the command line that runs ``argv`` as root of a user namespace of its own, without real root.

    The private /run holds its /run/netns. The pid namespace makes the kernel end all processes inside with it. The new
    loopback is down, so the command switches it on, because the demo reads arpd's status over it.
    """
    return [
        *(executable("unshare"), "--user", "--map-root-user", "--net", "--mount"),
        *("--pid", "--fork", "--kill-child", "--mount-proc"),
        *("--", "sh", "-c", 'mount -t tmpfs tmpfs /run && "$0" link set lo up && exec "$@"', executable("ip")),
        *argv,
    ]


def _hosts(run_id: str) -> tuple[Host, Host]:
    addresses = ("10.77.0.1", "10.77.0.2")  # constant, because namespaces separate two links
    macs = ("02:00:0a:4d:00:01", "02:00:0a:4d:00:02")
    robot, base = (
        Host(
            name=name,
            namespace=namespace_of(run_id, name),
            interface=INTERFACE,
            address=addresses[own],
            peer_address=addresses[1 - own],
            mac=macs[own],
            peer_mac=macs[1 - own],
        )
        for own, name in enumerate(HOST_NAMES)
    )
    return robot, base


def _burst_bytes(rate_bytes_per_second: float) -> int:
    """Return the smallest bucket that keeps up with the rate (bytes).

    A bucket lets the head of a packet train pass at once, so a larger bucket makes the train look faster. A bucket of
    one frame loses credit when the kernel's timer is late. Measured at 20 Mbit/s with a train of 10 x 1200 B: +2 %
    without slack (and a flood of full frames gets 97 % of the rate), +5 % with 100 us (and 100 %), +12 % with 400 us.
    """
    return int(MIN_BURST_BYTES + _TIMER_SLACK_S * rate_bytes_per_second)


def _stall(end: Host, queue_bytes: int) -> None:
    """Let a bucket pass a frame every half hour; pyroute2 cannot say so, and the kernel would drop what comes."""
    bucket = ("rate", "8bit", "burst", str(MIN_BURST_BYTES), "limit", str(queue_bytes))
    change = ("qdisc", "change", "dev", end.interface, "root", "handle", "1:", "tbf", *bucket)
    subprocess.run([executable("tc"), "-n", end.namespace, *change], check=True)


def _checked_rate(rate_bytes_per_second: float) -> float:
    if not 1.0 <= rate_bytes_per_second < 2**32:
        raise ValueError(f"rate {rate_bytes_per_second} bytes/s: must be from 1 to 4.29e9")
    return float(rate_bytes_per_second)


def _checked_loss(loss: float) -> float:
    if not 0.0 <= loss <= 1.0:
        raise ValueError(f"loss {loss}: must be a probability, from 0 to 1")
    return loss


def _exit_on_signal(number: int, _frame: FrameType | None) -> None:
    raise SystemExit(128 + number)


def _knock(host: Host) -> None:
    """Send a packet: the kernel looks at a queue that stands when one comes."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as knocking, suppress(OSError):
        knocking.setblocking(False)  # noqa: FBT003 - its own signature
        knocking.sendto(b"", (host.peer_address, _DISCARD_PORT))
