"""Checks of `arpd doctor` on this computer: kernel limits, ROS, versions, units, configuration, profile."""

from __future__ import annotations

import os
from shlex import quote
from typing import TYPE_CHECKING

from arpd import __version__
from arpd.cli.checkup import fine, unknown, wrong
from arpd.host.kernel import PROC, counters, read_number
from arpd.model.errors import NotKnownError
from arpd.model.quantities import format_share, format_size
from arpd.report.wording import count, listed
from arpd.ros.profile import profile_line
from arpd.ros.rmw import Rmw

if TYPE_CHECKING:
    from pathlib import Path

    from arpd.cli.checkup import Finding, Here
    from arpd.ros.installation import PythonRos

_ENOUGH_BUFFER_BYTES = 2 * 2**20  # 20 ms of a link that carries 100 MB/s
_MANY_LOST, _MANY_LOST_RATIO, _MANY_INCOMPLETE_RATIO = 10, 1e-4, 0.01
_SHORT_REASSEMBLY_S, _ENOUGH_REASSEMBLY_BYTES = 3, 128 * 2**20  # as "DDS tuning" of the ROS 2 documentation has it
_DISTRO = "jazzy"
_ROS = "/opt/ros/"
_OF_ROOT = ("/usr/", "/opt/")
_SOURCE = f"source {_ROS}{_DISTRO}/setup.bash"
_INSTALL = f"sudo apt install ros-{_DISTRO}-ros-base   # on Ubuntu 24.04, with the apt source of ROS 2"
_FAST_DDS = "RMW_IMPLEMENTATION=rmw_fastrtps_cpp"


def receive_buffers(_here: Here, *, proc: Path = PROC) -> Finding:
    """Judge the receive buffer of sockets by what the kernel lost for want of it.

    Fast DDS takes the default size. A small one harms nobody whose processes read in time.
    """
    size, udp = read_number(proc / "sys/net/core/rmem_default"), counters("Udp", proc=proc)
    received, lost = udp.get("InDatagrams"), udp.get("RcvbufErrors")
    if size is None or received is None or lost is None:
        return unknown("the kernel does not tell how many datagrams it lost (/proc/net/snmp, net.core.rmem_default)")
    if size >= _ENOUGH_BUFFER_BYTES:
        return fine(f"{format_size(size)} per socket")
    total = received + lost
    if lost < _MANY_LOST or lost < _MANY_LOST_RATIO * total:
        return fine(f"{format_size(size)} per socket; {lost} of {total} datagrams were lost for want of more")
    return wrong(
        f"{lost} of {total} datagrams since the start ({format_share(lost / total)}) met a full receive buffer of "
        f"{format_size(size)} (net.core.rmem_default) and were lost",
        "echo net.core.rmem_default=8388608 | sudo tee /etc/sysctl.d/60-arpd-buffers.conf && sudo sysctl --system"
        "   # then restart arpd and your nodes",
    )


def fragments(_here: Here, *, proc: Path = PROC) -> Finding:
    """Judge the reassembly of datagrams that IP cut.

    With arpd's profile DDS cuts samples itself, so this concerns nodes without it.
    """
    ip, settings = counters("Ip", proc=proc), proc / "sys/net/ipv4"
    whole, incomplete = ip.get("ReasmOKs"), ip.get("ReasmFails")
    kept_s, kept_bytes = (read_number(settings / name) for name in ("ipfrag_time", "ipfrag_high_thresh"))
    if whole is None or incomplete is None or kept_s is None or kept_bytes is None:
        return unknown("the kernel does not tell its IP reassembly here (/proc/net/snmp, net.ipv4.ipfrag_*)")
    found = f"{incomplete} of {whole + incomplete} datagrams that IP had cut never became whole"
    if incomplete < _MANY_LOST or incomplete < _MANY_INCOMPLETE_RATIO * (whole + incomplete):
        return fine(found)
    better = [f"net.ipv4.ipfrag_time={_SHORT_REASSEMBLY_S}"] if kept_s > _SHORT_REASSEMBLY_S else []
    if kept_bytes < _ENOUGH_REASSEMBLY_BYTES:
        better.append(f"net.ipv4.ipfrag_high_thresh={_ENOUGH_REASSEMBLY_BYTES}")
    if not better:
        return fine(f"{found}; they are kept for {kept_s} s, and do not fill the memory")
    return wrong(
        f"{found}; each stays in {format_size(kept_bytes)} of memory for {kept_s} s, and while that is full no sample "
        "larger than a packet arrives from nodes without arpd's Fast DDS profile",
        f"printf '%s\\n' {' '.join(better)} | sudo tee /etc/sysctl.d/60-arpd-fragments.conf && sudo sysctl --system",
    )


def profile(here: Here) -> Finding:
    """Judge whether the processes of all AdaptivePublishers have arpd's Fast DDS profile."""
    if not (lacking := sorted({topic.node for topic in here.status.topics if topic.confirmed.lacks_profile})):
        return fine("no AdaptivePublisher says that it lacks arpd's Fast DDS profile")
    return wrong(
        f"{count(len(lacking), 'node')} with AdaptivePublishers without arpd's Fast DDS profile: {listed(lacking)}; "
        "their swaps take longer, and lost packets cost whole samples",
        f"{profile_line()}   # before they start",
    )


def ros(here: Here) -> Finding:
    """Judge whether this shell has a ROS that arpd works with."""
    own, distro, is_installed = here.pythons[0], os.environ.get("ROS_DISTRO", ""), _DISTRO in here.distros
    get = _SOURCE if is_installed else _INSTALL
    if distro and distro != _DISTRO:
        return wrong(f"this shell has ROS 2 {distro}; arpd is measured with {_DISTRO}", get)
    if own.silence:
        return unknown(own.silence)
    if not own.fault:
        return fine(f"rclpy works ({own.rclpy})")
    if own.rclpy:
        return wrong(f"ROS in {own.python} does not work: {own.fault}", _repair(own))
    if not distro and is_installed:
        return unknown(f"ROS is not sourced in this shell; `{_SOURCE} && arpd doctor` looks")
    # The environment may say that it is sourced, and have lost a part of it.
    return wrong(f"{own.python} cannot import rclpy: {own.fault}", *dict.fromkeys((get, _INSTALL)))


def _repair(own: PythonRos) -> str:
    """Return the line for an rclpy that is there and does not work."""
    if _has_unfit_numpy(own):
        return _other_numpy(own)
    if "rmw" in own.fault.lower():
        return "unset RMW_IMPLEMENTATION   # then ROS takes Fast DDS"
    if own.rclpy.startswith(_ROS):
        return f"sudo apt install --reinstall ros-{_DISTRO}-rclpy ros-{_DISTRO}-rmw-fastrtps-cpp"
    root = "sudo " if own.rclpy.startswith(_OF_ROOT) else ""
    return f"{root}{quote(own.python)} -m pip install --force-reinstall 'ros-{_DISTRO}-rclpy[fastrtps]'"


def numpy(here: Here) -> Finding:
    """Judge numpy beside the Python packages of /opt/ros and of apt, which are built for numpy 1.26."""
    for one in here.pythons:
        # The system's Python belongs to /opt/ros, also in a shell where ROS is not sourced.
        if _has_unfit_numpy(one, has_ros=_DISTRO in here.distros):
            return wrong(
                f"{one.python} has numpy {one.numpy} in front of the one that ROS 2 {_DISTRO} is built for "
                "(1.26); cv_bridge and others fail with it",
                _other_numpy(one),
            )
    versions = [f"{one.numpy} in {one.python}" for one in here.pythons if one.numpy]
    return fine(listed(versions)) if versions else unknown("no Python here imports numpy")


def _has_unfit_numpy(one: PythonRos, *, has_ros: bool = False) -> bool:
    is_of_ros = one.rclpy.startswith(_ROS) or (has_ros and one.python.startswith("/usr/bin/"))
    major = one.numpy.partition(".")[0]
    return is_of_ros and major.isdecimal() and int(major) >= 2


def _other_numpy(one: PythonRos) -> str:
    """Return the line for a numpy in a virtual environment, or for one that pip put before apt's."""
    root = "sudo " if one.numpy_file.startswith(_OF_ROOT) else ""
    if one.venv and one.numpy_file.startswith(f"{one.venv}/"):
        return f"{root}{quote(one.python)} -m pip install 'numpy<2'"
    return f"{root}/usr/bin/python3 -m pip uninstall --break-system-packages numpy"


def rmw(here: Here) -> Finding:
    """Judge the middleware: the daemon's, as no shell's environment reaches its unit, else this shell's."""
    told = None if isinstance(here.told, NotKnownError) else here.told
    name = told.rmw if told else here.pythons[0].rmw
    if not name:
        return unknown("neither a daemon nor rclpy tells it")
    if not (refusal := told.rmw_refusal if told else Rmw(name=name).refusal):
        return fine(name)
    lines = [f"export {_FAST_DDS}   # for all nodes of both ends"]
    if told:
        append = f"echo {_FAST_DDS} | sudo tee -a /etc/default/arpd"
        lines.append(f"{append} && sudo systemctl restart 'arpd*'   # for arpd, on both ends")
    return wrong(refusal, *lines)


def versions(here: Here) -> Finding:
    """Judge whether the running daemon is of this command's version."""
    if __version__ == (daemon := here.status.version):
        return fine(f"arpd {__version__}{' at both ends' if here.is_far else ''}")
    if here.is_far:
        return wrong(
            f"arpd {__version__} here, {daemon} on the robot; they may not understand each other",
            "install the newer one on the other end: sudo apt install ./arpd-ros_*.deb",
        )
    return wrong(f"arpd {__version__} is installed, and the running daemon is {daemon}", "sudo systemctl restart arpd")


def units(here: Here) -> Finding:
    """Judge arpd's units: those that failed, once or in a loop, and those that are enabled but do not run."""
    if not here.has_systemd:
        return unknown("systemd does not run here, or does not answer")
    faults: dict[str, str] = {}
    for name, unit in here.units.items():
        look = f"journalctl -u {name} -n 30   # the last line says why"
        if unit.sub.startswith("auto-restart"):  # systemd 254 and newer have auto-restart-queued, too
            faults[f"{name} fails again and again, and systemd restarts it"] = look
        elif unit.active == "failed":
            faults[f"{name} has failed"] = look
        elif unit.is_enabled and unit.active == "inactive":
            faults[f"{name} is enabled, and does not run"] = f"sudo systemctl start {name}"
    if faults:
        return wrong("; ".join(faults), *faults.values())
    well = [f"{name} is {unit.active}" for name, unit in here.units.items() if unit.active != "inactive"]
    idle = "no unit of arpd is enabled" if here.units else "no unit of arpd is installed"
    return fine(listed(well, most=4) if well else idle)


def configuration(here: Here) -> Finding:
    """Judge the configuration by its faults."""
    if (faults := here.faults) is None:
        return unknown(f"there is no {here.config_path}, or this user may not read it")
    if not faults:
        return fine(f"{here.config_path} is valid")
    more = f" (and {len(faults) - 1} more)" if len(faults) > 1 else ""
    return wrong(f"{faults[0]}{more}", f"arpd check {'--far ' if here.is_far else ''}{quote(str(here.config_path))}")


CHECKS = (receive_buffers, fragments, profile, ros, numpy, rmw, versions, units, configuration)
