"""Facts of `arpd doctor`, and what a check finds: what is well or harmful, and the fix."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, NamedTuple, TypeVar

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

_Fact = TypeVar("_Fact")


class Health(StrEnum):
    """Result of one check."""

    FINE = "fine"
    WRONG = "wrong"  # somebody should do something
    UNKNOWN = "unknown"


@dataclass(frozen=True, slots=True)
class Finding:
    """Result of one check.

    Parameters
    ----------
    text : the finding, or the reason why nothing is known
    remedies : lines to type, or to do; the first one mends it now, others for good
    """

    health: Health
    text: str
    remedies: tuple[str, ...] = ()


def fine(text: str) -> Finding:
    """Find that nothing needs to be done."""
    return Finding(Health.FINE, text)


def wrong(text: str, *remedies: str) -> Finding:
    """Find that something should be done."""
    return Finding(Health.WRONG, text, remedies)


def unknown(why: str) -> Finding:
    """Find nothing, for a reason."""
    return Finding(Health.UNKNOWN, why)


class Unknown(NamedTuple):
    """A fact that could not be read, and why, in words that follow "because"."""

    why: str


class NotKnownError(Exception):
    """A check that needs a fact that is not known."""


def known(fact: _Fact | Unknown) -> _Fact:
    """Return a fact.

    Raises
    ------
    NotKnownError
        If it could not be read; the check's finding is then the reason.
    """
    if isinstance(fact, Unknown):
        raise NotKnownError(fact.why)
    return fact


@dataclass(frozen=True, kw_only=True, slots=True)
class NetworkLimits:
    """Limits of the kernel for datagrams, and what it lost since it started; None = not known.

    Parameters
    ----------
    buffer_bytes : receive buffer of a socket that asks for none (net.core.rmem_default)
    received, overflowed : datagrams that sockets took, and that found the buffer full
    reassembly_s, reassembly_bytes : how long, and how many bytes of, incomplete datagrams are kept
    reassembled, incomplete : fragmented datagrams that became whole, and that did not
    """

    buffer_bytes: int | None = None
    received: int | None = None
    overflowed: int | None = None
    reassembly_s: int | None = None
    reassembly_bytes: int | None = None
    reassembled: int | None = None
    incomplete: int | None = None


@dataclass(frozen=True, kw_only=True, slots=True)
class PythonRos:
    """ROS as one Python sees it.

    Parameters
    ----------
    python : path of the interpreter
    rclpy : file of rclpy, which may not work, empty = there is none
    numpy, numpy_file : version and file of numpy, empty = there is none
    venv : folder of the virtual environment, empty = the interpreter has none
    rmw : identifier of the middleware, empty = not known
    fault : why ROS does not work there, empty if it does
    """

    python: str
    rclpy: str = ""
    numpy: str = ""
    numpy_file: str = ""
    venv: str = ""
    rmw: str = ""
    fault: str = ""


@dataclass(frozen=True, kw_only=True, slots=True)
class Unit:
    """A unit of systemd: its name and states (`systemctl show`).

    Parameters
    ----------
    active : its ActiveState
    is_looping : whether it failed, and systemd waits before the next attempt
    """

    name: str
    active: str
    is_enabled: bool
    is_looping: bool = False


@dataclass(frozen=True, kw_only=True, slots=True)
class PeerClock:
    """Clock of one peer against the robot's (s), as the daemon tells it; None = not known."""

    peer: str
    offset_s: float | None
    uncertainty_s: float | None


@dataclass(frozen=True, kw_only=True, slots=True)
class RadioState:
    """A Wi-Fi interface, as nl80211 tells it.

    Parameters
    ----------
    saves_power : whether it sleeps between beacons
    signal_dbm : strength of its access point, or of the strongest station (dBm)
    region : two letters of the regulatory domain in force, ``00`` = none is set
    has_network_manager : whether NetworkManager runs here, and would set power save again
    """

    saves_power: bool | Unknown
    signal_dbm: int | Unknown
    region: str | Unknown
    has_network_manager: bool = False


@dataclass(frozen=True, kw_only=True, slots=True)
class Announcer:
    """A participant that announces itself by multicast.

    Parameters
    ----------
    host : name or address of its computer
    process : its command, or its number in words; empty = not known
    is_here : whether it runs on this computer
    is_arpds : whether it is a process of arpd's; never known of another computer's
    transports : over what it tells of its topics, as "UDPv4"; empty = not known
    """

    host: str
    process: str
    is_here: bool
    is_arpds: bool
    transports: frozenset[str] = frozenset()


@dataclass(frozen=True, kw_only=True, slots=True)
class HeardDiscovery:
    """Multicast discovery on the link interface for some seconds.

    Parameters
    ----------
    bytes_per_second : with UDP, IP and Ethernet headers
    """

    domain_id: int
    announcers: tuple[Announcer, ...]
    bytes_per_second: float


@dataclass(frozen=True, kw_only=True, slots=True)
class Facts:
    """What the checks judge.

    Parameters
    ----------
    is_far : whether this computer is the base computer and not the robot
    interface : the link here, empty = none was found
    has_two_ends : whether the configuration has a relay with two ends
    config_path, faults : configuration file, and its faults
    version, daemon_version : of this command, and of the running daemon
    clocks : of the peers, as the daemon tells them
    is_clock_synchronised : whether the kernel says that something keeps this computer's clock right, None = not known
    lacking : nodes that announce that they run without arpd's Fast DDS profile
    profile_line : what gives a process the profile
    rmw, rmw_refusal : the middleware, empty = not known, and why its publishers are only paced, empty if they are not
    rmw_is_the_daemons : whether the daemon tells it of itself; no shell's environment reaches its unit
    radios : by interface, of the link or beneath it; empty = it has none
    mtu_bytes, route_mtu_bytes : of the interface, and of the route to the other end as far as the kernel knows
    limits : of the kernel
    heard : discovery on the link
    pythons : this interpreter's ROS first, then that of the system's Python where that is another one
    distro, distros : ROS_DISTRO of the environment, empty = none, and names under /opt/ros
    units : arpd's units that are installed
    """

    is_far: bool
    interface: str
    has_two_ends: bool
    config_path: str
    faults: Sequence[str] | Unknown
    version: str
    daemon_version: str | Unknown
    clocks: Sequence[PeerClock] | Unknown
    is_clock_synchronised: bool | None
    lacking: Sequence[str] | Unknown
    profile_line: str
    rmw: str
    rmw_refusal: str
    rmw_is_the_daemons: bool
    radios: Mapping[str, RadioState] | Unknown
    mtu_bytes: int | Unknown
    route_mtu_bytes: int | None
    limits: NetworkLimits
    heard: HeardDiscovery | Unknown
    pythons: Sequence[PythonRos | Unknown]
    distro: str
    distros: Sequence[str]
    units: Sequence[Unit] | Unknown
