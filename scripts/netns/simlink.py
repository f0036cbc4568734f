"""Two hosts, ``robot`` and ``base``, joined by one slow link, on one machine with real kernel networking.

Each host is a network namespace; a veth pair joins them; a token bucket (tbf) with a byte-limited queue shapes each
end, so real processes and real DDS traffic meet real queueing. An nftables rule drops packets at random where they
arrive, behind the queue, because on the air a lost packet uses its share of the link, too.
"""

from __future__ import annotations

import os
import signal
import subprocess
import threading
import time
import zlib
from contextlib import contextmanager
from functools import partial
from typing import TYPE_CHECKING, Any

from pyroute2 import IPRoute, NetlinkError

from arpd.model.errors import LinkError
from arpd.model.wire import MTU_BYTES
from scripts.netns import link_end
from scripts.netns.link_end import Bucket, Host
from scripts.netns.namespaces import (
    HOST_NAMES,
    HostName,
    claim,
    cleanup_stale,
    executable,
    inside,
    namespace_of,
    release,
)

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from types import FrameType, TracebackType
    from typing import Self

    from arpd.model.interface import LinkCounters

__all__ = ["Host", "SimLink", "available", "cleanup_stale", "user_namespace_argv"]

DEFAULT_RATE_BYTES_PER_SECOND = 2_500_000.0  # 20 Mbit/s
DEFAULT_QUEUE_BYTES = 256_000  # about the queue of a Wi-Fi driver; 102 ms at 20 Mbit/s, 410 ms at 5 Mbit/s
INTERFACE = "link0"
MIN_BURST_BYTES = MTU_BYTES + 40  # a full frame and the rounding of tbf, which drops frames above its bucket size

_TIMER_SLACK_S = 100e-6  # lateness of the kernel's timer up to which the bucket loses no credit
_ROBOT_INDEX = 77
_CARRIER_TIMEOUT_S = 5.0


class SimLink:
    """The link and its two hosts while the ``with`` block lasts.

    The end of the block, also by an exception, Ctrl-C or SIGTERM, ends every process inside and removes the
    namespaces. After ``kill -9``, the next link or ``cleanup_stale`` removes them.

    Parameters
    ----------
    run_id : name of the link, so that several can exist at once
    rate_bytes_per_second : rate of each direction, Ethernet headers included (bytes/s)
    queue_bytes : queue in front of each bucket, with tail drop (bytes)
    burst_bytes : bucket size, at least MIN_BURST_BYTES, None = one frame and 100 us of the rate (bytes)
    loss : probability that an arriving packet is dropped, 0..1
    domain_id : ROS_DOMAIN_ID of every process inside; None = derived from the run id

    Attributes
    ----------
    robot, base : the two ends
    """

    def __init__(
        self,
        run_id: str,
        *,
        rate_bytes_per_second: float = DEFAULT_RATE_BYTES_PER_SECOND,
        queue_bytes: int = DEFAULT_QUEUE_BYTES,
        burst_bytes: int | None = None,
        loss: float = 0.0,
        domain_id: int | None = None,
    ) -> None:
        self.run_id = run_id
        self.robot, self.base = _hosts(run_id)
        # Above 101, the ports that DDS derives from the domain meet Linux's ephemeral ports.
        self.domain_id = 1 + zlib.crc32(run_id.encode()) % 101 if domain_id is None else domain_id
        self._rate_bytes_per_second = _checked_rate(rate_bytes_per_second)
        if queue_bytes < MIN_BURST_BYTES or (burst_bytes is not None and burst_bytes < MIN_BURST_BYTES):
            raise ValueError(f"queue and burst must hold one full frame: at least {MIN_BURST_BYTES} bytes")
        self._queue_bytes = queue_bytes
        self._fixed_burst_bytes = burst_bytes
        self._loss = _checked_loss(loss)
        self._has_loss_rule = False
        self._processes: list[subprocess.Popen[Any]] = []
        self._sigterm_before: Any = None

    @property
    def hosts(self) -> tuple[Host, Host]:
        """The two ends, robot first."""
        return (self.robot, self.base)

    @property
    def rate_bytes_per_second(self) -> float:
        """Rate in force in each direction (bytes/s)."""
        return self._rate_bytes_per_second

    @property
    def loss(self) -> float:
        """Probability in force that an arriving packet is dropped (0..1)."""
        return self._loss

    def __enter__(self) -> Self:
        claimed = False
        self._catch_sigterm()
        try:
            with _signals_held_back():
                claim(self.run_id)
                claimed = True
                self._build()
        except BaseException as error:
            if claimed:
                self._tear_down()
            self._uncatch_sigterm()
            if isinstance(error, NetlinkError | OSError):
                raise LinkError(f"cannot build the simulated link: {error}") from error
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self._tear_down()
        finally:
            self._uncatch_sigterm()

    def set_rate(self, rate_bytes_per_second: float) -> None:
        """Change the rate of both directions; queued packets stay."""
        self._rate_bytes_per_second = _checked_rate(rate_bytes_per_second)
        for host in self.hosts:
            inside(host.namespace, partial(link_end.reshape, host, self._bucket()))

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
        for host in self.hosts:
            inside(host.namespace, link_end.disable_ipv6)
        with IPRoute() as outside:
            ends = [
                {"ifname": host.interface, "net_ns_fd": host.namespace, "address": host.mac, "mtu": MTU_BYTES}
                for host in self.hosts
            ]
            # The first device of every namespace gets index 2. If both ends of a veth have the same index, the kernel
            # sees a device without a peer, and its carrier may take a second to come up (linkwatch_urgent_event).
            outside.link("add", kind="veth", index=_ROBOT_INDEX, peer=ends[1], **ends[0])
        for host in self.hosts:
            inside(host.namespace, partial(link_end.raise_up, host, self._bucket()))
        self.set_loss(self._loss)
        self._await_carrier()

    def _await_carrier(self) -> None:
        """Wait until the kernel uses both buckets; it silently drops earlier packets."""
        deadline_s = time.monotonic() + _CARRIER_TIMEOUT_S
        while not all(end.is_up for end in self.counters().values()):
            if time.monotonic() > deadline_s:
                raise LinkError(f"the veth pair of run {self.run_id!r} has no carrier after {_CARRIER_TIMEOUT_S:g} s")
            time.sleep(0.005)

    def _bucket(self) -> Bucket:
        rate = self._rate_bytes_per_second
        burst = _burst_bytes(rate) if self._fixed_burst_bytes is None else self._fixed_burst_bytes
        return Bucket(rate_bytes_per_second=rate, burst_bytes=burst, queue_bytes=self._queue_bytes)

    def _catch_sigterm(self) -> None:
        # SIGTERM's default action would skip every `finally`. A handler of the program itself stays.
        if threading.current_thread() is threading.main_thread() and signal.getsignal(signal.SIGTERM) is signal.SIG_DFL:
            self._sigterm_before = signal.signal(signal.SIGTERM, _exit_on_signal)

    def _uncatch_sigterm(self) -> None:
        if self._sigterm_before is not None:
            signal.signal(signal.SIGTERM, self._sigterm_before)
            self._sigterm_before = None

    def _tear_down(self) -> None:
        with _signals_held_back():
            for process in self._processes:
                if process.poll() is None:
                    process.terminate()  # it may not be in the namespace yet, where `release` looks
            release(self.run_id)
            for process in self._processes:
                process.wait()


def available() -> tuple[bool, str]:
    """Return whether a SimLink works in this process, by building one, and if not, the reason and the way out."""
    try:
        if os.geteuid() != 0:
            return False, f"not root; {_user_namespace_verdict()}"
        with SimLink(f"probe-{os.getpid()}-{threading.get_ident()}", loss=0.5) as link:
            link.counters()
    except LinkError as error:
        return False, str(error)
    return True, ""


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


def _user_namespace_verdict() -> str:
    probe = subprocess.run(user_namespace_argv(["true"]), capture_output=True, text=True, check=False)
    if probe.returncode == 0:
        return "scripts/simlink, or the command line of `user_namespace_argv`, works here without root"
    return f"and user namespaces are refused here ({probe.stderr.strip()}): run it as root"


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


@contextmanager
def _signals_held_back() -> Iterator[None]:
    """Deliver SIGINT and SIGTERM after the block, so that no link stays half built or half removed."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    arrived: list[int] = []
    before = {
        number: signal.signal(number, lambda number, _frame: arrived.append(number))
        for number in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        for late in arrived:
            signal.raise_signal(late)
