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


@pytest.mark.parametrize(
    ("check", "lost", "setting", "expected"),
    [
        (receive_buffers, 0, 212_992, "fine"),
        (receive_buffers, 99, 212_992, "fine"),
        (receive_buffers, 5000, 212_992, "wrong"),
        (receive_buffers, 5000, 8 * 2**20, "fine"),  # it was raised, and the counters stay
        (receive_buffers, "", 212_992, "unknown"),
        (receive_buffers, 0, "", "unknown"),
        (fragments, 0, 30, "fine"),
        (fragments, 50_000, 30, "wrong"),
        (fragments, 50_000, 3, "fine"),  # lost fragments harm no others when they are soon forgotten
        (fragments, "", 30, "unknown"),
    ],
)
def test_what_the_kernel_loses_is_wrong_where_it_is_much_and_a_setting_mends_it(
    tmp_path, check, lost, setting, expected
):
    """A small buffer or a long patience that loses little harms nobody."""
    for folder in ("net", "sys/net/core", "sys/net/ipv4"):
        (tmp_path / folder).mkdir(parents=True)
    snmp = f"Ip: ReasmOKs ReasmFails\nIp: 1000000 {lost}\nUdp: InDatagrams RcvbufErrors\nUdp: 1000000 {lost}\n"
    (tmp_path / "net/snmp").write_text(snmp)
    for name in ("core/rmem_default", "ipv4/ipfrag_time"):
        (tmp_path / "sys/net" / name).write_text(str(setting))
    assert health(check, None, proc=tmp_path) == expected


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
