"""Checks of `arpd doctor` on this computer: kernel limits, ROS, versions, units, configuration, profile."""

from __future__ import annotations

from typing import TYPE_CHECKING

from arpd.model.quantities import format_share, format_size
from arpd.report.health import Unknown, fine, known, unknown, wrong
from arpd.report.wording import count, listed

if TYPE_CHECKING:
    from collections.abc import Iterator

    from arpd.report.health import Facts, Finding, PythonRos

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


def receive_buffers(facts: Facts) -> Finding:
    """Judge the receive buffer of sockets by what the kernel lost for want of it.

    Fast DDS takes the default size. A small one harms nobody whose processes read in time.
    """
    size, received, lost = facts.limits.buffer_bytes, facts.limits.received, facts.limits.overflowed
    if size is None:
        return unknown("the kernel does not tell net.core.rmem_default here")
    if size >= _ENOUGH_BUFFER_BYTES:
        return fine(f"{format_size(size)} per socket")
    if received is None or lost is None:
        return unknown("the kernel does not tell how many datagrams it lost (/proc/net/snmp)")
    total = received + lost
    if lost < _MANY_LOST or lost < _MANY_LOST_RATIO * total:
        return fine(f"{format_size(size)} per socket; {lost} of {total} datagrams were lost for want of more")
    return wrong(
        f"{lost} of {total} datagrams since the start ({format_share(lost / total)}) met a full receive buffer of "
        f"{format_size(size)} (net.core.rmem_default) and were lost",
        "echo net.core.rmem_default=8388608 | sudo tee /etc/sysctl.d/60-arpd-buffers.conf && sudo sysctl --system"
        "   # then restart arpd and your nodes",
    )


def fragments(facts: Facts) -> Finding:
    """Judge the reassembly of datagrams that IP cut.

    With arpd's profile DDS cuts samples itself, so this concerns nodes without it.
    """
    whole, incomplete = facts.limits.reassembled, facts.limits.incomplete
    kept_s, kept_bytes = facts.limits.reassembly_s, facts.limits.reassembly_bytes
    if whole is None or incomplete is None or kept_s is None or kept_bytes is None:
        return unknown("the kernel does not tell its IP reassembly here (/proc/net/snmp, net.ipv4.ipfrag_*)")
    total = whole + incomplete
    found = f"{incomplete} of {total} datagrams that IP had cut never became whole"
    if incomplete < _MANY_LOST or incomplete < _MANY_INCOMPLETE_RATIO * total:
        return fine(found)
    if kept_s <= _SHORT_REASSEMBLY_S and kept_bytes >= _ENOUGH_REASSEMBLY_BYTES:
        return fine(f"{found}; they are kept for {kept_s} s, and do not fill the memory")
    settings = [f"net.ipv4.ipfrag_time={_SHORT_REASSEMBLY_S}"] if kept_s > _SHORT_REASSEMBLY_S else []
    if kept_bytes < _ENOUGH_REASSEMBLY_BYTES:
        settings.append(f"net.ipv4.ipfrag_high_thresh={_ENOUGH_REASSEMBLY_BYTES}")
    return wrong(
        f"{found}; each stays in {format_size(kept_bytes)} of memory for {kept_s} s, and while that is full no sample "
        "larger than a packet arrives from nodes without arpd's Fast DDS profile",
        f"printf '%s\\n' {' '.join(settings)} | sudo tee /etc/sysctl.d/60-arpd-fragments.conf && sudo sysctl --system",
    )


def profile(facts: Facts) -> Finding:
    """Judge whether the processes of all AdaptivePublishers have arpd's Fast DDS profile."""
    if not (lacking := sorted(known(facts.lacking))):
        return fine("no AdaptivePublisher says that it lacks arpd's Fast DDS profile")
    run = "runs" if len(lacking) == 1 else "run"
    return wrong(
        f"{count(len(lacking), 'node')} with AdaptivePublishers {run} without arpd's Fast DDS profile: "
        f"{listed(lacking)}; their swaps take longer, and lost packets cost whole samples",
        f"{facts.profile_line}   # before they start",
    )


def ros(facts: Facts) -> Finding:
    """Judge whether this shell has a ROS that arpd works with."""
    is_installed = _DISTRO in facts.distros
    lines = [_SOURCE] if is_installed else [_INSTALL]
    if facts.distro and facts.distro != _DISTRO:
        return wrong(f"this shell has ROS 2 {facts.distro}; arpd is measured with {_DISTRO}", *lines)
    found = known(facts.pythons[0])
    if not found.fault:
        return fine(f"rclpy works ({found.rclpy})")
    if found.rclpy:
        return wrong(f"ROS in {found.python} does not work: {found.fault}", *_ros_remedies(found))
    if not facts.distro and is_installed:
        return unknown(f"ROS is not sourced in this shell; `{_SOURCE} && arpd doctor` looks")
    if is_installed:  # the environment says that it is sourced, and may have lost a part of it
        lines.append(f"{_INSTALL}, if that does not help")
    return wrong(f"{found.python} cannot import rclpy: {found.fault}", *lines)


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


def numpy(facts: Facts) -> Finding:
    """Judge numpy beside the Python packages of /opt/ros and of apt, which are built for numpy 1.26."""
    pythons = [one for one in facts.pythons if not isinstance(one, Unknown)]
    for one in pythons:
        # The system's Python belongs to /opt/ros, also in a shell where ROS is not sourced.
        if _has_unfit_numpy(one, has_ros=_DISTRO in facts.distros):
            return wrong(
                f"{one.python} has numpy {one.numpy} in front of the one that ROS 2 {_DISTRO} is built for "
                "(1.26); cv_bridge and others fail with it",
                _numpy_remedy(one),
            )
    versions = [f"{one.numpy} in {one.python}" for one in pythons if one.numpy]
    return fine(listed(versions)) if versions else unknown("no Python here imports numpy")


def _has_unfit_numpy(one: PythonRos, *, has_ros: bool) -> bool:
    is_of_ros = one.rclpy.startswith(_ROS) or (has_ros and one.python.startswith("/usr/bin/"))
    major = one.numpy.partition(".")[0]
    return is_of_ros and major.isdecimal() and int(major) >= _FIRST_UNFIT_NUMPY


def _numpy_remedy(one: PythonRos) -> str:
    """Return the line for a numpy in a virtual environment, or for one that pip put before apt's."""
    root = "sudo " if one.numpy_file.startswith(_OF_ROOT) else ""
    if one.venv and one.numpy_file.startswith(f"{one.venv}/"):
        return f"{root}{one.python} -m pip install 'numpy<2'"
    return f"{root}/usr/bin/python3 -m pip uninstall --break-system-packages numpy"


def rmw(facts: Facts) -> Finding:
    """Judge the middleware."""
    if not facts.rmw:
        return unknown("neither a daemon nor rclpy tells it")
    if not facts.rmw_refusal:
        return fine(facts.rmw)
    lines = [f"export {_FAST_DDS}   # for all nodes of both ends"]
    if facts.rmw_is_the_daemons:
        append = f"echo {_FAST_DDS} | sudo tee -a /etc/default/arpd"
        lines.append(f"{append} && sudo systemctl restart 'arpd*'   # for arpd, on both ends")
    return wrong(facts.rmw_refusal, *lines)


def versions(facts: Facts) -> Finding:
    """Judge whether the running daemon is of this command's version."""
    own, daemon = facts.version, known(facts.daemon_version)
    if own == daemon:
        return fine(f"arpd {own}{' at both ends' if facts.is_far else ''}")
    if facts.is_far:
        return wrong(
            f"arpd {own} here, {daemon} on the robot; they may not understand each other",
            "install the newer one on the other end: sudo apt install ./arpd-ros_*.deb",
        )
    return wrong(f"arpd {own} is installed, and the running daemon is {daemon}", "sudo systemctl restart arpd")


def units(facts: Facts) -> Finding:
    """Judge arpd's units: those that failed, once or in a loop, and those that are enabled but do not run."""
    installed = known(facts.units)
    faults: list[str] = []
    remedies: list[str] = []
    for unit in installed:
        if unit.is_looping or unit.active == "failed":
            how = "fails again and again, and systemd restarts it" if unit.is_looping else "has failed"
            faults.append(f"{unit.name} {how}")
            remedies.append(f"journalctl -u {unit.name} -n 30   # the last line says why")
        elif unit.is_enabled and unit.active == "inactive":
            faults.append(f"{unit.name} is enabled, and does not run")
            remedies.append(f"sudo systemctl start {unit.name}")
    if faults:
        return wrong("; ".join(faults), *remedies)
    well = [f"{unit.name} is {unit.active}" for unit in installed if unit.active != "inactive"]
    idle = "no unit of arpd is enabled" if installed else "no unit of arpd is installed"
    return fine(listed(well, most=4) if well else idle)


def configuration(facts: Facts) -> Finding:
    """Judge the configuration by its faults."""
    if not (faults := known(facts.faults)):
        return fine(f"{facts.config_path} is valid")
    more = f" (and {len(faults) - 1} more)" if len(faults) > 1 else ""
    return wrong(f"{faults[0]}{more}", f"arpd check {'--far ' if facts.is_far else ''}{facts.config_path}")
