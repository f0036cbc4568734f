"""Judgements of `arpd doctor` about this computer: kernel limits, ROS, versions, units, configuration, profile."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from arpd.model.quantities import format_share, format_size
from arpd.report.health import Judgement, Unknown, fine, unknown, wrong
from arpd.report.wording import count, listed

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

_ENOUGH_BUFFER_BYTES = 2 * 2**20  # 20 ms of a link that carries 100 MB/s
_MANY_LOST, _MANY_LOST_RATIO = 10, 1e-4
_SHORT_REASSEMBLY_S, _ENOUGH_REASSEMBLY_BYTES = 3, 128 * 2**20  # as "DDS tuning" of the ROS 2 documentation has it
_MANY_INCOMPLETE_RATIO = 0.01
_DISTRO = "jazzy"
_FIRST_UNFIT_NUMPY = 2
_ROS = "/opt/ros/"
_SOURCE = f"source {_ROS}{_DISTRO}/setup.bash"
_INSTALL = f"sudo apt install ros-{_DISTRO}-ros-base   # on Ubuntu 24.04, with the apt source of ROS 2"
_OF_ROOT = ("/usr/", "/opt/")
_FAST_DDS = "RMW_IMPLEMENTATION=rmw_fastrtps_cpp"

BUFFERS, FRAGMENTS, ROS, NUMPY = "receive buffers", "fragments", "ros", "numpy"
RMW, VERSIONS, UNITS, CONFIGURATION, PROFILE = "rmw", "versions", "units", "configuration", "profile"


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


def judge_buffers(limits: NetworkLimits) -> Judgement:
    """Judge the receive buffer of sockets by what the kernel lost for want of it.

    Fast DDS takes the default size. A small one harms nobody whose processes read in time.
    """
    size, received, lost = limits.buffer_bytes, limits.received, limits.overflowed
    if size is None:
        return unknown(BUFFERS, "the kernel does not tell net.core.rmem_default here")
    if size >= _ENOUGH_BUFFER_BYTES:
        return fine(BUFFERS, f"{format_size(size)} per socket")
    if received is None or lost is None:
        return unknown(BUFFERS, "the kernel does not tell how many datagrams it lost (/proc/net/snmp)")
    total = received + lost
    if lost < _MANY_LOST or lost < _MANY_LOST_RATIO * total:
        return fine(BUFFERS, f"{format_size(size)} per socket; {lost} of {total} datagrams were lost for want of more")
    return wrong(
        BUFFERS,
        f"{lost} of {total} datagrams since the start ({format_share(lost / total)}) met a full receive buffer of "
        f"{format_size(size)} (net.core.rmem_default) and were lost",
        "echo net.core.rmem_default=8388608 | sudo tee /etc/sysctl.d/60-arpd-buffers.conf && sudo sysctl --system"
        "   # then restart arpd and your nodes",
    )


def judge_fragments(limits: NetworkLimits) -> Judgement:
    """Judge the reassembly of datagrams that IP cut.

    With arpd's profile DDS cuts samples itself, so this concerns nodes without it.
    """
    whole, incomplete = limits.reassembled, limits.incomplete
    kept_s, kept_bytes = limits.reassembly_s, limits.reassembly_bytes
    if whole is None or incomplete is None or kept_s is None or kept_bytes is None:
        return unknown(FRAGMENTS, "the kernel does not tell its IP reassembly here (/proc/net/snmp, net.ipv4.ipfrag_*)")
    total = whole + incomplete
    found = f"{incomplete} of {total} datagrams that IP had cut never became whole"
    if incomplete < _MANY_LOST or incomplete < _MANY_INCOMPLETE_RATIO * total:
        return fine(FRAGMENTS, found)
    if kept_s <= _SHORT_REASSEMBLY_S and kept_bytes >= _ENOUGH_REASSEMBLY_BYTES:
        return fine(FRAGMENTS, f"{found}; they are kept for {kept_s} s, and do not fill the memory")
    settings = [f"net.ipv4.ipfrag_time={_SHORT_REASSEMBLY_S}"] if kept_s > _SHORT_REASSEMBLY_S else []
    if kept_bytes < _ENOUGH_REASSEMBLY_BYTES:
        settings.append(f"net.ipv4.ipfrag_high_thresh={_ENOUGH_REASSEMBLY_BYTES}")
    return wrong(
        FRAGMENTS,
        f"{found}; each stays in {format_size(kept_bytes)} of memory for {kept_s} s, and while that is full no sample "
        "larger than a packet arrives from nodes without arpd's Fast DDS profile",
        f"printf '%s\\n' {' '.join(settings)} | sudo tee /etc/sysctl.d/60-arpd-fragments.conf && sudo sysctl --system",
    )


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


def judge_ros(found: PythonRos | Unknown, *, distro: str, installed: Sequence[str]) -> Judgement:
    """Judge whether this shell has a ROS that arpd works with.

    Parameters
    ----------
    distro : ROS_DISTRO of the environment, empty = none
    installed : names under /opt/ros
    """
    lines = [_SOURCE] if _DISTRO in installed else [_INSTALL]
    if distro and distro != _DISTRO:
        return wrong(ROS, f"this shell has ROS 2 {distro}; arpd is measured with {_DISTRO}", *lines)
    if isinstance(found, Unknown):
        return unknown(ROS, found)
    if not found.fault:
        return fine(ROS, f"rclpy works ({found.rclpy})")
    if found.rclpy:
        return wrong(ROS, f"ROS in {found.python} does not work: {found.fault}", *_ros_remedies(found))
    if not distro and _DISTRO in installed:
        return unknown(ROS, f"ROS is not sourced in this shell; `{_SOURCE} && arpd doctor` looks")
    if _DISTRO in installed:  # the environment says that it is sourced, and may have lost a part of it
        lines.append(f"{_INSTALL}, if that does not help")
    return wrong(ROS, f"{found.python} cannot import rclpy: {found.fault}", *lines)


def _ros_remedies(one: PythonRos) -> Iterator[str]:
    """Yield the lines for an rclpy that is there and does not work."""
    if _has_unfit_numpy(one, has_ros=False):
        yield _numpy_remedy(one)
        return
    if "rmw" in one.fault.lower():
        yield "unset RMW_IMPLEMENTATION   # then ROS takes Fast DDS"
    if one.rclpy.startswith(_ROS):
        yield f"sudo apt install --reinstall ros-{_DISTRO}-rclpy ros-{_DISTRO}-rmw-fastrtps-cpp"
    else:
        root = "sudo " if one.rclpy.startswith(_OF_ROOT) else ""
        yield f"{root}{one.python} -m pip install --force-reinstall 'ros-{_DISTRO}-rclpy[fastrtps]'"


def judge_numpy(pythons: Sequence[PythonRos], *, installed: Sequence[str]) -> Judgement:
    """Judge numpy beside the Python packages of /opt/ros and of apt, which are built for numpy 1.26.

    Parameters
    ----------
    installed : names under /opt/ros; the system's Python belongs to them, also in a shell where ROS is not sourced
    """
    has_ros = _DISTRO in installed
    unfit = [one for one in pythons if _has_unfit_numpy(one, has_ros=has_ros)]
    if unfit:
        one = unfit[0]
        return wrong(
            NUMPY,
            f"{one.python} has numpy {one.numpy} in front of the one that ROS 2 {_DISTRO} is built for "
            "(1.26); cv_bridge and others fail with it",
            _numpy_remedy(one),
        )
    versions = [f"{one.numpy} in {one.python}" for one in pythons if one.numpy]
    return fine(NUMPY, listed(versions)) if versions else unknown(NUMPY, "no Python here imports numpy")


def _has_unfit_numpy(one: PythonRos, *, has_ros: bool) -> bool:
    is_of_ros = one.rclpy.startswith(_ROS) or (has_ros and one.python.startswith("/usr/bin/"))
    return is_of_ros and _major(one.numpy) >= _FIRST_UNFIT_NUMPY


def _numpy_remedy(one: PythonRos) -> str:
    """Return the line for a numpy in a virtual environment, or for one that pip put before apt's."""
    root = "sudo " if one.numpy_file.startswith(_OF_ROOT) else ""
    if one.venv and one.numpy_file.startswith(f"{one.venv}/"):
        return f"{root}{one.python} -m pip install 'numpy<2'"
    return f"{root}/usr/bin/python3 -m pip uninstall --break-system-packages numpy"


def _major(version: str) -> int:
    digits = version.partition(".")[0]
    return int(digits) if digits.isdecimal() else 0


def judge_rmw(name: str, refusal: str | None, *, is_of_daemon: bool) -> Judgement:
    """Judge the middleware.

    Parameters
    ----------
    name : its identifier, empty = not known
    refusal : why its publishers are only paced, empty if they are swapped, too; None = not known
    is_of_daemon : whether the daemon tells it of itself; no shell's environment reaches its unit
    """
    if not name or refusal is None:
        return unknown(RMW, "neither a daemon nor rclpy tells it")
    if refusal:
        lines = [f"export {_FAST_DDS}   # for all nodes of both ends"]
        if is_of_daemon:
            append = f"echo {_FAST_DDS} | sudo tee -a /etc/default/arpd"
            lines.append(f"{append} && sudo systemctl restart 'arpd*'   # for arpd, on both ends")
        return wrong(RMW, refusal, *lines)
    return fine(RMW, name)


def judge_versions(own: str, daemon: str | Unknown, *, is_far: bool) -> Judgement:
    """Judge whether the running daemon is of this command's version."""
    if isinstance(daemon, Unknown):
        return unknown(VERSIONS, daemon)
    if own == daemon:
        return fine(VERSIONS, f"arpd {own}{' at both ends' if is_far else ''}")
    if is_far:
        return wrong(
            VERSIONS,
            f"arpd {own} here, {daemon} on the robot; they may not understand each other",
            "install the newer one on the other end: sudo apt install ./arpd-ros_*.deb",
        )
    return wrong(
        VERSIONS, f"arpd {own} is installed, and the running daemon is {daemon}", "sudo systemctl restart arpd"
    )


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


def judge_units(units: Sequence[Unit] | Unknown) -> Iterator[Judgement]:
    """Judge arpd's units: those that failed, once or in a loop, and those that are enabled but do not run."""
    if isinstance(units, Unknown):
        yield unknown(UNITS, units)
        return
    well, is_wrong = [], False
    for unit in units:
        is_stopped = unit.is_enabled and unit.active == "inactive"
        has_failed = unit.is_looping or unit.active == "failed"
        is_wrong = is_wrong or is_stopped or has_failed
        if has_failed:
            how = "fails again and again, and systemd restarts it" if unit.is_looping else "has failed"
            yield wrong(UNITS, f"{unit.name} {how}", f"journalctl -u {unit.name} -n 30   # the last line says why")
        elif is_stopped:
            yield wrong(UNITS, f"{unit.name} is enabled, and does not run", f"sudo systemctl start {unit.name}")
        elif unit.active != "inactive":
            well.append(f"{unit.name} is {unit.active}")
    if well or not is_wrong:
        idle = "no unit of arpd is enabled" if units else "no unit of arpd is installed"
        yield fine(UNITS, listed(well, most=4) if well else idle)


def judge_configuration(path: str, faults: Sequence[str] | Unknown, *, is_far: bool) -> Judgement:
    """Judge the configuration by its faults."""
    if isinstance(faults, Unknown):
        return unknown(CONFIGURATION, faults)
    if not faults:
        return fine(CONFIGURATION, f"{path} is valid")
    more = f" (and {len(faults) - 1} more)" if len(faults) > 1 else ""
    return wrong(CONFIGURATION, f"{faults[0]}{more}", f"arpd check {'--far ' if is_far else ''}{path}")


def judge_profile(lacking: Sequence[str] | Unknown, *, line: str) -> Judgement:
    """Judge whether the processes of all AdaptivePublishers have arpd's Fast DDS profile.

    Parameters
    ----------
    lacking : nodes that announce that they run without it
    line : what gives it to a process
    """
    if isinstance(lacking, Unknown):
        return unknown(PROFILE, lacking)
    if not lacking:
        return fine(PROFILE, "no AdaptivePublisher says that it lacks arpd's Fast DDS profile")
    run = "runs" if len(lacking) == 1 else "run"
    return wrong(
        PROFILE,
        f"{count(len(lacking), 'node')} with AdaptivePublishers {run} without arpd's Fast DDS profile: "
        f"{listed(sorted(lacking))}; their swaps take longer, and lost packets cost whole samples",
        f"{line}   # before they start",
    )
