"""Checks of `arpd doctor`: when something should be done, and when not enough is known."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from arpd import __version__
from arpd.cli import checks_host, checks_link
from arpd.cli.checks_host import fragments, numpy, profile, receive_buffers, ros, units, versions
from arpd.cli.checks_link import clock, discovery, mtu, power_save, region, signal, transports
from arpd.cli.checkup import Health
from arpd.host.discovery import Announcer, HeardDiscovery
from arpd.host.services import ServiceState
from arpd.model.probing import ClockOffset
from arpd.ros.installation import PythonRos

# -- clock


@pytest.mark.parametrize(
    ("offset_s", "uncertainty_s", "health"),
    [
        (0.0, 0.001, Health.FINE),
        (-0.015, 0.004, Health.FINE),
        (0.03, 0.001, Health.WRONG),
        (-5.0, 0.5, Health.WRONG),
        (0.03, 0.02, Health.UNKNOWN),
        (0.0, 0.1, Health.UNKNOWN),
        (None, None, Health.UNKNOWN),
    ],
)
def test_only_a_clock_that_is_surely_off_is_wrong(offset_s, uncertainty_s, health):
    """More than 20 ms after all that may be error of the measurement; what may be either is not known."""
    peers = [
        SimpleNamespace(
            peer=name, clock=offset if offset is None else ClockOffset(offset_s=offset, uncertainty_s=error)
        )
        for name, offset, error in (("laptop", 0.0, 0.001), ("base", offset_s, uncertainty_s))
    ]
    assert clock(SimpleNamespace(status=SimpleNamespace(peers=peers))).health is health


# -- radio


def radio(monkeypatch, **changes):
    """Return what is judged of two radios, one of them well."""
    told = {"power_save": False, "signal": -50, "region": "DE"} | changes
    monkeypatch.setattr(checks_link.radio, "radios_of", lambda _interface: ["wlan0", "wlan1"])
    monkeypatch.setattr(checks_link.radio, "runs_network_manager", lambda: False)
    for name, value in told.items():
        well = {"power_save": False, "signal": -50, "region": "DE"}[name]
        monkeypatch.setattr(
            checks_link.radio, name, lambda radio, value=value, well=well: value if radio == "wlan0" else well
        )
    return {check.__name__: check(SimpleNamespace(interface="wg0")) for check in (power_save, signal, region)}


@pytest.mark.parametrize(
    ("about", "told", "remedy"),
    [
        ("power_save", True, "sudo iw dev wlan0 set power_save off"),
        ("signal", -80, "closer"),
        ("region", "00", "sudo iw reg set"),
    ],
)
def test_each_fault_of_a_radio_has_its_remedy(monkeypatch, about, told, remedy):
    """The other judgements stay fine."""
    judged = radio(monkeypatch, **{about: told})
    assert judged[about].health is Health.WRONG
    assert remedy in judged[about].remedies[0]
    assert {each.health for name, each in judged.items() if name != about} == {Health.FINE}


# -- packets


@pytest.mark.parametrize(
    ("own", "route", "health"),
    [
        (1500, None, Health.FINE),
        (9000, 1500, Health.FINE),
        (1420, None, Health.FINE),
        (1419, None, Health.WRONG),
        (1280, 1280, Health.WRONG),
        (1500, 1280, Health.WRONG),
    ],
)
def test_packets_of_arpds_writers_must_fit(monkeypatch, own, route, health):
    """They have up to 1420 bytes, which WireGuard takes, too."""
    monkeypatch.setattr(checks_link.kernel, "read_mtu", lambda _interface: own)
    monkeypatch.setattr(checks_link.kernel, "route_mtu", lambda _address: route)
    assert mtu(SimpleNamespace(interface="wlan0", other_end="10.0.0.2")).health is health


# -- discovery


def announcer(process="talker", *, host="laptop", is_here=False, is_arpds=False, transports=()):
    return Announcer(host=host, process=process, is_here=is_here, is_arpds=is_arpds, transports=frozenset(transports))


def hears(*announcers, has_two_ends=False):
    return SimpleNamespace(
        heard=HeardDiscovery(domain_id=0, announcers=announcers, bytes_per_second=2000.0),
        interface="wlan0",
        settings=SimpleNamespace(relay=SimpleNamespace(link_domain=77 if has_two_ends else None)),
    )


OWN = announcer("arpd", host="robot", is_here=True, is_arpds=True)
NODE = announcer("camera", host="robot", is_here=True)


@pytest.mark.parametrize(
    ("announcers", "has_two_ends", "health"),
    [
        ((OWN,), True, Health.FINE),
        ((OWN, NODE), True, Health.WRONG),
        ((announcer(),), True, Health.WRONG),
        ((NODE, announcer()), False, Health.FINE),
        ((announcer(),) * 2, False, Health.FINE),
        ((NODE,) * 20, False, Health.FINE),
        ((NODE,) * 21, False, Health.WRONG),
        ((announcer(),) * 22, False, Health.FINE),  # two of another computer may be arpd's
        ((announcer(),) * 23, False, Health.WRONG),
    ],
)
def test_with_two_ends_nobody_else_is_on_the_link_and_with_one_only_many_harm(announcers, has_two_ends, health):
    """Nodes that meet across the link must announce themselves there."""
    assert discovery(hears(*announcers, has_two_ends=has_two_ends)).health is health


@pytest.mark.parametrize(
    ("own", "nodes", "remedy"),
    [
        ("UDPv4", ["UDPv4", "UDPv4"], ""),
        ("TCPv4", ["TCPv4"], ""),
        ("UDPv4", ["TCPv4", "TCPv4", "TCPv4"], "echo FASTDDS_BUILTIN_TRANSPORTS=LARGE_DATA"),
        ("TCPv4", ["UDPv4"], "export FASTDDS_BUILTIN_TRANSPORTS=LARGE_DATA"),
        ("", ["UDPv4", "UDPv4", "TCPv4"], "unset FASTDDS_BUILTIN_TRANSPORTS"),
        ("", ["", ""], ""),
    ],
)
def test_participants_that_share_no_transport_are_named(own, nodes, remedy):
    """What arpd speaks is right for it; without arpd, what most speak."""
    told = [announcer(transports=[kind] if kind else []) for kind in nodes]
    services = [announcer("arpd", host="robot", is_here=True, is_arpds=True, transports=[own])] if own else []
    judged = transports(hears(*told, *services))
    assert (judged.health is Health.WRONG, "".join(judged.remedies).startswith(remedy)) == (bool(remedy), True)
    assert bool(judged.remedies) == bool(remedy)


def test_no_name_from_the_network_stands_in_a_line_to_copy():
    """Anybody may announce a host and a process by any name."""
    strangers = [
        announcer("$(reboot)", host="x;reboot", transports=["TCPv4"]),
        announcer(host="y\n reboot", transports=["UDPv4"]),
    ]
    judged = [transports(hears(*strangers, *strangers[1:])), discovery(hears(*strangers, has_two_ends=True))]
    assert all(each.health is Health.WRONG and "reboot" in each.text for each in judged)
    assert "reboot" not in "".join(line for each in judged for line in each.remedies)


# -- kernel


def proc(folder, *, overflowed=0, incomplete=0, buffer_bytes=212_992, reassembly_s=30, reassembly_bytes=4 * 2**20):
    """Return a tree as the kernel has it, without what is None."""
    snmp = []
    if incomplete is not None:
        snmp += ["Ip: Forwarding ReasmOKs ReasmFails", f"Ip: 1 10000 {incomplete}"]
    if overflowed is not None:
        snmp += ["Udp: InDatagrams RcvbufErrors", f"Udp: 1000000 {overflowed}"]
    numbers = {
        "core/rmem_default": buffer_bytes,
        "ipv4/ipfrag_time": reassembly_s,
        "ipv4/ipfrag_high_thresh": reassembly_bytes,
    }
    files = {f"sys/net/{name}": str(number) for name, number in numbers.items() if number is not None}
    for name, text in {**files, "net/snmp": "\n".join(snmp)}.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    return folder


@pytest.mark.parametrize(
    ("changes", "health"),
    [
        ({}, Health.FINE),
        ({"overflowed": 9}, Health.FINE),
        ({"overflowed": 99}, Health.FINE),
        ({"overflowed": 5000}, Health.WRONG),
        ({"overflowed": 5000, "buffer_bytes": 8 * 2**20}, Health.FINE),
        ({"buffer_bytes": None}, Health.UNKNOWN),
        ({"overflowed": None}, Health.UNKNOWN),
    ],
)
def test_a_small_buffer_is_wrong_where_datagrams_were_lost_for_want_of_it(tmp_path, changes, health):
    """A default size that loses nothing harms nobody, and one that was raised is fine, although the counters stay."""
    judged = receive_buffers(None, proc=proc(tmp_path, **changes))
    assert judged.health is health
    assert "rmem_max" not in "".join(judged.remedies)  # tuning guides raise it far above what is enough
    assert bool(judged.remedies) is (health is Health.WRONG)


@pytest.mark.parametrize(
    ("changes", "health"),
    [
        ({}, Health.FINE),
        ({"incomplete": 500}, Health.WRONG),
        ({"incomplete": 500, "reassembly_s": 3, "reassembly_bytes": 128 * 2**20}, Health.FINE),
        ({"incomplete": None}, Health.UNKNOWN),
    ],
)
def test_reassembly_is_wrong_where_many_datagrams_never_became_whole(tmp_path, changes, health):
    """Short patience and much memory make lost fragments harmless to the others."""
    judged = fragments(None, proc=proc(tmp_path, **changes))
    assert judged.health is health
    assert bool(judged.remedies) is (health is Health.WRONG)


# -- software

WORKS = {"python": "/venv/bin/python", "rclpy": "/opt/ros/jazzy/lib/rclpy/__init__.py", "numpy": "1.26.4"}
SYSTEM = {"python": "/usr/bin/python3"}
OWN_NUMPY = {"venv": "/venv", "numpy_file": "/venv/lib/python3.12/site-packages/numpy/__init__.py"}
AT_HOME = "/home/ubuntu/.local/lib/python3.12/site-packages/numpy/__init__.py"
FOR_ALL = "/usr/local/lib/python3.12/dist-packages/numpy/__init__.py"
UNINSTALL = "-m pip uninstall --break-system-packages numpy"


@pytest.mark.parametrize(
    ("python", "distro", "installed", "health", "remedy"),
    [
        (WORKS, "jazzy", ["jazzy"], Health.FINE, ""),
        (WORKS, "humble", ["humble", "jazzy"], Health.WRONG, "source /opt/ros/jazzy/setup.bash"),
        (WORKS, "humble", ["humble"], Health.WRONG, "sudo apt install ros-jazzy-ros-base"),
        ({"python": "p", "fault": "ImportError"}, "", ["jazzy"], Health.UNKNOWN, ""),
        ({"python": "p", "fault": "ImportError"}, "", [], Health.WRONG, "sudo apt install ros-jazzy-ros-base"),
        ({"python": "p", "silence": "no answer"}, "jazzy", ["jazzy"], Health.UNKNOWN, ""),
    ],
)
def test_ros_must_work_and_be_jazzy(monkeypatch, python, distro, *, installed, health, remedy):
    """A shell in which ROS is not sourced tells nothing of the daemon's."""
    monkeypatch.setenv("ROS_DISTRO", distro)
    judged = ros(SimpleNamespace(pythons=[PythonRos(**python)], distros=installed))
    assert judged.health is health
    assert "".join(judged.remedies).startswith(remedy)
    assert bool(judged.remedies) is (health is Health.WRONG)
    assert "jazzy" in installed or "source /opt" not in "".join(judged.remedies)


@pytest.mark.parametrize(
    ("changes", "health", "remedy"),
    [
        ({}, Health.FINE, ""),
        ({"numpy": "2.4.6"} | OWN_NUMPY, Health.WRONG, "/venv/bin/python -m pip install 'numpy<2'"),
        ({"numpy": "2.1", "numpy_file": AT_HOME} | SYSTEM, Health.WRONG, f"/usr/bin/python3 {UNINSTALL}"),
        ({"numpy": "2.1", "numpy_file": FOR_ALL} | SYSTEM, Health.WRONG, f"sudo /usr/bin/python3 {UNINSTALL}"),
        ({"numpy": "2.4.6", "rclpy": "/venv/lib/rclpy/__init__.py"}, Health.FINE, ""),
        ({"numpy": ""}, Health.UNKNOWN, ""),
    ],
)
def test_numpy_2_does_not_fit_the_packages_of_apt(changes, health, remedy):
    """Wheels of ROS from PyPI take either."""
    judged = numpy(SimpleNamespace(pythons=[PythonRos(**WORKS | changes)], distros=["jazzy"]))
    assert judged.health is health
    assert "".join(judged.remedies) == remedy


def test_versions_must_be_the_same(monkeypatch):
    """On the robot a restart mends it, across the link an installation."""
    robot, base = (SimpleNamespace(is_far=far, status=SimpleNamespace(version=__version__)) for far in (False, True))
    assert versions(robot).health is Health.FINE
    monkeypatch.setattr(checks_host, "__version__", "7.7")
    assert "restart" in versions(robot).remedies[0]
    assert "./arpd-ros_*.deb" in versions(base).remedies[0]


def unit(active, **fields):
    return {"arpd": ServiceState(**{"is_installed": True, "is_enabled": True, "active": active, **fields})}


@pytest.mark.parametrize(
    ("installed", "health"),
    [
        ({}, Health.FINE),
        (unit("active"), Health.FINE),
        (unit("failed"), Health.WRONG),
        (unit("inactive"), Health.WRONG),
        (unit("inactive", is_enabled=False), Health.FINE),
        (unit("activating"), Health.FINE),
        (unit("activating", sub="auto-restart"), Health.WRONG),
        (None, Health.UNKNOWN),
    ],
)
def test_units_that_failed_or_do_not_run_are_wrong(installed, health):
    """A unit that nobody enabled may rest."""
    assert units(SimpleNamespace(has_systemd=installed is not None, units=installed)).health is health


def test_nodes_without_the_profile_are_named():
    """With the line to set."""
    topics = [
        SimpleNamespace(node=node, confirmed=SimpleNamespace(lacks_profile=True))
        for node in ("/lidar", "/camera", "/camera")
    ]
    judged = profile(SimpleNamespace(status=SimpleNamespace(topics=topics)))
    assert judged.health is Health.WRONG
    assert "/camera and /lidar" in judged.text
    assert judged.remedies[0].startswith("export ")
    topics.clear()
    assert profile(SimpleNamespace(status=SimpleNamespace(topics=topics))).health is Health.FINE
