"""Facts of a computer that is well."""

from __future__ import annotations

from arpd.report.health import Facts, HeardDiscovery, NetworkLimits, NotKnownError, PythonRos, unknown

LIMITS = NetworkLimits(
    buffer_bytes=212_992,
    received=1_000_000,
    overflowed=0,
    reassembly_s=30,
    reassembly_bytes=4 * 2**20,
    reassembled=10_000,
    incomplete=0,
)


def facts(**changes):
    """Return the facts, with some changed."""
    well = {
        "is_far": False,
        "interface": "wlan0",
        "has_two_ends": False,
        "config_path": "/etc/arpd/arpd.yaml",
        "faults": (),
        "version": "1.0",
        "daemon_version": "1.0",
        "clocks": (),
        "is_clock_synchronised": True,
        "lacking": (),
        "profile_line": "export X=y",
        "rmw": "rmw_fastrtps_cpp",
        "rmw_refusal": "",
        "rmw_is_the_daemons": True,
        "radios": {},
        "mtu_bytes": 1500,
        "route_mtu_bytes": None,
        "limits": LIMITS,
        "heard": HeardDiscovery(domain_id=0, announcers=(), bytes_per_second=0.0),
        "pythons": (PythonRos(python="/usr/bin/python3", rclpy="/opt/ros/jazzy/rclpy.py", numpy="1.26.4"),),
        "distro": "jazzy",
        "distros": ("jazzy",),
        "units": (),
    }
    return Facts(**well | changes)


def found(check, **changes):
    """Return a finding on the facts, as the checkup has it where one is not known."""
    try:
        return check(facts(**changes))
    except NotKnownError as error:
        return unknown(str(error))
