"""Checks of `arpd doctor`: when something should be done, and when not enough is known."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from arpd import __version__
from arpd.cli import checks
from arpd.cli.checks import (
    clock,
    discovery,
    fragments,
    mtu,
    power_save,
    profile,
    receive_buffers,
    region,
    rmw,
    signal,
    transports,
    units,
    versions,
)
from arpd.host.discovery import Announcer, HeardDiscovery
from arpd.host.services import ServiceState
from arpd.model.errors import NotKnownError
from arpd.model.probing import ClockOffset


def health(check, *arguments, **options):
    try:
        return check(*arguments, **options).health
    except NotKnownError:
        return "unknown"


# -- clock


@pytest.mark.parametrize(
    ("offset_s", "uncertainty_s", "expected"),
    [
        (0.0, 0.001, "fine"),
        (-0.015, 0.004, "fine"),
        (0.03, 0.001, "wrong"),
        (-5.0, 0.5, "wrong"),
        (0.03, 0.02, "unknown"),
        (0.0, 0.1, "unknown"),
        (None, None, "unknown"),
    ],
)
def test_only_a_clock_that_is_surely_off_is_wrong(offset_s, uncertainty_s, expected):
    """More than 20 ms after all that may be error of the measurement; what may be either is not known."""
    offset = None if offset_s is None else ClockOffset(offset_s=offset_s, uncertainty_s=uncertainty_s)
    peers = [SimpleNamespace(peer="base", clock=offset)]
    assert health(clock, SimpleNamespace(status=SimpleNamespace(peers=peers))) == expected


# -- radio


def radio(monkeypatch, **changes):
    """Return what is judged of two radios, one of them well."""
    told = {"power_save": False, "signal": -50, "region": "DE"} | changes
    monkeypatch.setattr(checks.radio, "radios_of", lambda _interface: ["wlan0", "wlan1"])
    monkeypatch.setattr(checks.radio, "runs_network_manager", lambda: False)
    for name, value in told.items():
        well = {"power_save": False, "signal": -50, "region": "DE"}[name]
        monkeypatch.setattr(
            checks.radio, name, lambda radio, value=value, well=well: value if radio == "wlan0" else well
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
    assert judged[about].health == "wrong"
    assert remedy in judged[about].remedies[0]
    assert {each.health for name, each in judged.items() if name != about} == {"fine"}


# -- packets


@pytest.mark.parametrize(
    ("own", "route", "expected"),
    [
        (1500, None, "fine"),
        (9000, 1500, "fine"),
        (1420, None, "fine"),
        (1419, None, "wrong"),
        (1280, 1280, "wrong"),
        (1500, 1280, "wrong"),
    ],
)
def test_packets_of_arpds_writers_must_fit(monkeypatch, own, route, expected):
    """They have up to 1420 bytes, which WireGuard takes, too."""
    monkeypatch.setattr(checks.kernel, "read_mtu", lambda _interface: own)
    monkeypatch.setattr(checks.kernel, "route_mtu", lambda _address: route)
    assert health(mtu, SimpleNamespace(interface="wlan0", other_end="10.0.0.2")) == expected


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
    ("announcers", "has_two_ends", "expected"),
    [
        ((OWN,), True, "fine"),
        ((OWN, NODE), True, "wrong"),
        ((announcer(),), True, "wrong"),
        ((NODE, announcer()), False, "fine"),
        ((NODE,) * 20, False, "fine"),
        ((NODE,) * 21, False, "wrong"),
    ],
)
def test_with_two_ends_nobody_else_is_on_the_link_and_with_one_only_many_harm(announcers, has_two_ends, expected):
    """Nodes that meet across the link must announce themselves there."""
    assert health(discovery, hears(*announcers, has_two_ends=has_two_ends)) == expected


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
    assert (judged.health == "wrong", "".join(judged.remedies).startswith(remedy)) == (bool(remedy), True)
    assert bool(judged.remedies) == bool(remedy)


def test_no_name_from_the_network_stands_in_a_line_to_copy():
    """Anybody may announce a host and a process by any name."""
    strangers = [
        announcer("$(reboot)", host="x;reboot", transports=["TCPv4"]),
        announcer(host="y\n reboot", transports=["UDPv4"]),
    ]
    judged = [transports(hears(*strangers, *strangers[1:])), discovery(hears(*strangers, has_two_ends=True))]
    assert all(each.health == "wrong" and "reboot" in each.text for each in judged)
    assert "reboot" not in "".join(line for each in judged for line in each.remedies)


# -- kernel


def proc(folder, *, overflowed=0, incomplete=0, buffer_bytes=212_992, reassembly_s=30):
    """Return a tree as the kernel has it, without what is None."""
    snmp = []
    if incomplete is not None:
        snmp += ["Ip: Forwarding ReasmOKs ReasmFails", f"Ip: 1 10000 {incomplete}"]
    if overflowed is not None:
        snmp += ["Udp: InDatagrams RcvbufErrors", f"Udp: 1000000 {overflowed}"]
    numbers = {"core/rmem_default": buffer_bytes, "ipv4/ipfrag_time": reassembly_s}
    files = {f"sys/net/{name}": str(number) for name, number in numbers.items() if number is not None}
    for name, text in {**files, "net/snmp": "\n".join(snmp)}.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    return folder


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({}, "fine"),
        ({"overflowed": 9}, "fine"),
        ({"overflowed": 99}, "fine"),
        ({"overflowed": 5000}, "wrong"),
        ({"overflowed": 5000, "buffer_bytes": 8 * 2**20}, "fine"),
        ({"buffer_bytes": None}, "unknown"),
        ({"overflowed": None}, "unknown"),
    ],
)
def test_a_small_buffer_is_wrong_where_datagrams_were_lost_for_want_of_it(tmp_path, changes, expected):
    """A default size that loses nothing harms nobody, and one that was raised is fine, although the counters stay."""
    assert health(receive_buffers, None, proc=proc(tmp_path, **changes)) == expected


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({}, "fine"),
        ({"incomplete": 500}, "wrong"),
        ({"incomplete": 500, "reassembly_s": 3}, "fine"),
        ({"incomplete": None}, "unknown"),
    ],
)
def test_reassembly_is_wrong_where_many_datagrams_never_became_whole(tmp_path, changes, expected):
    """Short patience makes lost fragments harmless to the others."""
    assert health(fragments, None, proc=proc(tmp_path, **changes)) == expected


# -- software


@pytest.mark.parametrize(("name", "expected"), [("", "fine"), ("rmw_fastrtps_cpp", "fine"), ("rmw_zenoh_cpp", "wrong")])
def test_only_fast_dds_is_fine(monkeypatch, name, expected):
    """Without a daemon that tells it, this shell's environment does."""
    monkeypatch.setenv("RMW_IMPLEMENTATION", name)
    assert health(rmw, SimpleNamespace(told=NotKnownError("no daemon"))) == expected


def test_versions_must_be_the_same(monkeypatch):
    """On the robot a restart mends it, across the link an installation."""
    robot, base = (SimpleNamespace(is_far=far, status=SimpleNamespace(version=__version__)) for far in (False, True))
    assert versions(robot).health == "fine"
    monkeypatch.setattr(checks, "__version__", "7.7")
    assert "restart" in versions(robot).remedies[0]
    assert "./arpd-ros_*.deb" in versions(base).remedies[0]


def unit(active, **fields):
    return {"arpd": ServiceState(**{"is_installed": True, "is_enabled": True, "active": active, **fields})}


@pytest.mark.parametrize(
    ("installed", "expected"),
    [
        ({}, "fine"),
        (unit("active"), "fine"),
        (unit("failed"), "wrong"),
        (unit("inactive"), "wrong"),
        (unit("inactive", is_enabled=False), "fine"),
        (unit("activating"), "fine"),
        (unit("activating", sub="auto-restart"), "wrong"),
        (None, "unknown"),
    ],
)
def test_units_that_failed_or_do_not_run_are_wrong(installed, expected):
    """A unit that nobody enabled may rest."""
    assert health(units, SimpleNamespace(units=installed)) == expected


def test_nodes_without_the_profile_are_named():
    """With the line to set."""
    topics = [
        SimpleNamespace(node=node, confirmed=SimpleNamespace(lacks_profile=True))
        for node in ("/lidar", "/camera", "/camera")
    ]
    judged = profile(SimpleNamespace(status=SimpleNamespace(topics=topics)))
    assert judged.health == "wrong"
    assert "/camera and /lidar" in judged.text
    assert judged.remedies[0].startswith("export ")
    topics.clear()
    assert profile(SimpleNamespace(status=SimpleNamespace(topics=topics))).health == "fine"
