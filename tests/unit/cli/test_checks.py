"""Checks of `arpd doctor`: when something should be done, and when not enough is known."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace as Namespace

import pytest

from arpd import __version__
from arpd.cli import checks
from arpd.host import interface
from arpd.host.discovery import Announcer, HeardDiscovery
from arpd.host.services import ServiceState
from arpd.model.errors import NotKnownError
from arpd.model.probing import ClockOffset
from arpd.model.relay import RelaySummary, RelayTopics
from arpd.relay.status import ONE_DOMAIN, status_line


def health(check, *arguments, **options):
    try:
        return check(*arguments, **options).health
    except NotKnownError:
        return "unknown"


# -- from what the daemon, systemd and the network tell


def peers(*clocks):
    offsets = [clock and ClockOffset(offset_s=clock[0], uncertainty_s=clock[1]) for clock in clocks]
    return Namespace(status=Namespace(peers=[Namespace(peer="base", clock=offset) for offset in offsets]))


def announcer(process="talker", *, host="laptop", is_here=False, is_arpds=False, transports=(), **fields):
    fields["transports"] = frozenset(transports)
    return Announcer(host=host, process=process, is_here=is_here, is_arpds=is_arpds, **fields)


def hears(*announcers, has_two_ends=False):
    return Namespace(
        heard=HeardDiscovery(domain_id=0, announcers=announcers, bytes_per_second=2000.0),
        interface="wlan0",
        settings=Namespace(relay=Namespace(link_domain=77 if has_two_ends else None)),
    )


OWN = announcer("arpd", host="robot", is_here=True, is_arpds=True)
NODE = announcer("camera", host="robot", is_here=True)


def unit(active, **fields):
    state = ServiceState(**{"is_installed": True, "is_enabled": True, "active": active, **fields})
    return Namespace(units={"arpd": state})


@pytest.mark.parametrize(
    ("check", "here", "expected"),
    [
        (checks.clock, peers((-0.015, 0.004)), "fine"),
        (checks.clock, peers((-5.0, 0.5)), "wrong"),
        (checks.clock, peers((0.03, 0.02)), "unknown"),
        (checks.clock, peers(None), "unknown"),
        (checks.clock, peers((0.001, 0.001), None), "unknown"),
        (checks.clock, peers(None, (-5.0, 0.5), (0.0, 0.1)), "wrong"),
        # With two ends nobody else needs to be on the link; with one, nodes meet across it.
        (checks.discovery, hears(OWN, has_two_ends=True), "fine"),
        (checks.discovery, hears(OWN, NODE, has_two_ends=True), "wrong"),
        (checks.discovery, hears(announcer(), has_two_ends=True), "wrong"),
        (checks.discovery, hears(*[NODE] * 20), "fine"),
        (checks.discovery, hears(*[NODE] * 21), "wrong"),
        # A unit that nobody enabled may rest.
        (checks.units, unit("active"), "fine"),
        (checks.units, unit("active", says="no metrics: port taken"), "wrong"),
        (checks.units, unit("failed"), "wrong"),
        (checks.units, unit("inactive"), "wrong"),
        (checks.units, unit("inactive", is_enabled=False), "fine"),
        (checks.units, unit("activating"), "fine"),
        (checks.units, unit("activating", is_restarted=True), "wrong"),
        (checks.units, Namespace(units=None), "unknown"),
    ],
)
def test_only_what_surely_harms_is_wrong(check, here, expected):
    """What may be either, or is not told, is not known."""
    assert health(check, here) == expected


def ends(**lines):
    """Return a base computer whose far ends say these lines."""
    return Namespace(
        units={f"arpd-relay-far@{robot}": unit("active", says=says).units["arpd"] for robot, says in lines.items()}
    )


SERVED = RelaySummary(is_reachable=True, to_base=RelayTopics(offered=3, wanted=2))


def far_line(relay, **about):
    return status_line(relay, is_far=True, **{"is_met": True, "second_ends": (), **about})


@pytest.mark.parametrize(
    ("line", "health"),
    [
        (far_line(SERVED), "fine"),
        ("nothing to do: relay.link_domain is not set in /etc/arpd/arpd.yaml", "fine"),
        ("", "fine"),
        (far_line(SERVED, is_met=False), "wrong"),
        (far_line(replace(SERVED, fault=ONE_DOMAIN)), "wrong"),
        (far_line(SERVED, second_ends=("robot2",)), "wrong"),
        (far_line(replace(SERVED, is_reachable=False)), "wrong"),
        (far_line(replace(SERVED, fault="it is of arpd 0.0.9")), "wrong"),
        (far_line(replace(SERVED, to_base=RelayTopics(offered=3, wanted=2, refused={"/a": "two types"}))), "wrong"),
    ],
)
def test_each_robot_of_a_base_computer_is_judged_by_what_its_far_end_says(line, health):
    """One that hears its robot and carries all is fine; what another one says is the finding."""
    judged = checks.robots(ends(robot1=far_line(SERVED), robot2=line))
    assert judged.health == health
    assert ("arpd-relay-far@robot2: " + line in judged.text) == (health == "wrong")
    assert "robot1: " not in judged.text


def test_a_robot_that_is_not_there_is_named_once():
    """Its relay says more than its peer does; without a relay the peer's line stands."""
    lines = []
    pytest.importorskip("arpd.ros.peer", exc_type=ImportError).ProbeStatus(lambda: "reporting", tell=lines.append)
    peer = unit("active", says=lines[0]).units["arpd"]
    relay = unit("active", says=far_line(SERVED, is_met=False)).units["arpd"]
    told = checks.robots(Namespace(units={"arpd-peer@a": peer, "arpd-relay-far@a": relay, "arpd-peer@b": peer})).text
    assert ("arpd-peer@a: " in told, "arpd-relay-far@a: " in told, "arpd-peer@b: " in told) == (False, True, True)


@pytest.mark.parametrize(
    ("own", "nodes", "remedy"),
    [
        ("UDPv4", ["UDPv4", "UDPv4"], ""),
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
    judged = checks.transports(hears(*told, *services))
    assert (judged.health == "wrong", bool(judged.remedies)) == (bool(remedy), bool(remedy))
    assert "".join(judged.remedies).startswith(remedy)


@pytest.mark.parametrize(
    ("transport", "memory", "of_arpd", "is_cut_off"),
    [
        ("TCPv4", (1000, 27, 1), (1000, 27, 1), False),
        ("TCPv4", (1001,), (1000, 27, 1), True),
        ("TCPv4", (1000, 99, 1), (1000, 27, 1), True),
        ("TCPv4", None, (1000, 27, 1), False),
        ("TCPv4", (1000, 27, 1), (1000,), False),
        ("UDPv4", (1001,), (1000, 27, 1), False),
    ],
)
def test_a_node_over_tcp_without_arpds_shared_memory_is_named(transport, memory, of_arpd, is_cut_off):
    """One of another user, or of a container, exchanges nothing; who is not root sees of a service only its user."""
    service = announcer("arpd", is_here=True, is_arpds=True, transports=[transport], memory=of_arpd)
    judged = checks.transports(hears(service, announcer(is_here=True, transports=[transport], memory=memory)))
    assert (judged.health == "wrong") == is_cut_off
    assert ("talker" in judged.text) == is_cut_off


@pytest.mark.parametrize(("second", "health"), [("wlan0", "wrong"), ("docker0", "fine"), (None, "fine")])
def test_another_computer_of_two_networks_that_the_link_leads_to_is_named(monkeypatch, second, health):
    """Every sample for it crosses twice; an address that leads elsewhere, or nowhere, costs the link nothing."""
    routes = {"10.0.0.2": "wlan0", "172.17.0.1": second}
    monkeypatch.setattr(checks, "interface_to", routes.get)
    own = announcer(is_here=True, addresses=frozenset(routes))
    found = checks.discovery(hears(own, announcer(addresses=frozenset(routes))))
    assert found.health == health
    assert ("10.0.0.2 and 172.17.0.1" in found.text) == (health == "wrong")


def test_no_name_from_the_network_stands_in_a_line_to_copy():
    """Anybody may announce a host and a process by any name."""
    strangers = [
        announcer("$(reboot)", host="x;reboot", transports=["TCPv4"]),
        announcer(host="y\n reboot", transports=["UDPv4"]),
    ]
    assert "\x1b" not in checks.robots(ends(robot1="refused /\x1b[2J: no")).text
    judged = [
        checks.transports(hears(*strangers, *strangers[1:])),
        checks.discovery(hears(*strangers, has_two_ends=True)),
    ]
    assert all(each.health == "wrong" and "reboot" in each.text for each in judged)
    assert "reboot" not in "".join(line for each in judged for line in each.remedies)


def test_without_a_daemon_the_shell_tells_the_middleware(monkeypatch):
    """Only Fast DDS is fine."""
    for name, expected in (("", "fine"), ("rmw_zenoh_cpp", "wrong")):
        monkeypatch.setenv("RMW_IMPLEMENTATION", name)
        assert health(checks.rmw, Namespace(told=NotKnownError("no daemon"))) == expected


def test_versions_must_be_the_same(monkeypatch):
    """On the robot a restart mends it, across the link an installation."""
    robot, base = (Namespace(is_far=far, status=Namespace(version=__version__)) for far in (False, True))
    assert checks.versions(robot).health == "fine"
    monkeypatch.setattr(checks, "__version__", "7.7")
    assert "restart" in checks.versions(robot).remedies[0]
    assert "./arpd-ros_*.deb" in checks.versions(base).remedies[0]


def test_nodes_without_the_profile_are_named():
    """With the line to set."""
    lacking = Namespace(lacks_profile=True)
    topics = [Namespace(node=node, confirmed=lacking) for node in ("/lidar", "/camera", "/camera")]
    judged = checks.profile(Namespace(status=Namespace(topics=topics)))
    assert (judged.health, "/camera and /lidar" in judged.text) == ("wrong", True)
    assert judged.remedies[0].startswith("export ")
    assert checks.profile(Namespace(status=Namespace(topics=[]))).health == "fine"


# -- from the kernel


@pytest.mark.parametrize(
    ("about", "told", "remedy"),
    [
        ("power_save", True, "sudo iw dev wlan0 set power_save off"),
        ("signal", -80, "closer"),
        ("region", "00", "sudo iw reg set"),
    ],
)
def test_each_fault_of_a_radio_has_its_remedy(monkeypatch, about, told, remedy):
    """One of two radios has it, and the other judgements stay fine."""
    monkeypatch.setattr(checks.radio, "radios_of", lambda _interface: ["wlan0", "wlan1"])
    monkeypatch.setattr(checks.radio, "runs_network_manager", lambda: False)
    for name, well in {"power_save": False, "signal": -50, "region": "DE"}.items():
        answers = {"wlan0": told if name == about else well, "wlan1": well}
        monkeypatch.setattr(checks.radio, name, answers.__getitem__)
    here = Namespace(interface="wg0")
    judged = {check.__name__: check(here) for check in (checks.power_save, checks.signal, checks.region)}
    assert {name for name, each in judged.items() if each.health == "wrong"} == {about}
    assert remedy in judged[about].remedies[0]


def test_a_link_needs_an_address_unless_a_bridge_has_it(monkeypatch, tmp_path):
    """A radio that has joined its network and got no address carries nothing of DDS."""
    monkeypatch.setattr(checks, "ipv4_addresses", lambda: {"eth0": frozenset({"10.0.0.1"})})
    monkeypatch.setattr(interface, "SYS_NET", tmp_path)
    (tmp_path / "wlan1/master").mkdir(parents=True)
    names = ("eth0", "wlan0", "wlan1")
    judged = {name: health(checks.address, Namespace(interface=name, own_end=None)) for name in names}
    assert judged == {"eth0": "fine", "wlan0": "wrong", "wlan1": "fine"}


@pytest.mark.parametrize(("own", "expected"), [("10.0.0.1", "fine"), ("10.0.0.9", "wrong")])
def test_the_file_has_this_computers_own_address(monkeypatch, own, expected):
    """Where multicast passes, the ends meet with wrong addresses, too, and elsewhere never."""
    monkeypatch.setattr(checks, "ipv4_addresses", lambda: {"eth0": frozenset({"10.0.0.1"})})
    monkeypatch.setattr(checks.kernel, "is_own_address", {"10.0.0.1": True, "10.0.0.9": False}.__getitem__)
    found = checks.address(Namespace(interface="eth0", own_end=own, is_far=True))
    assert (found.health, "relay.base" in found.text) == (expected, expected == "wrong")


@pytest.mark.parametrize(
    ("own", "route", "expected"), [(1420, None, "fine"), (1419, None, "wrong"), (1500, 1280, "wrong")]
)
def test_packets_of_arpds_writers_must_fit(monkeypatch, own, route, expected):
    """They have up to 1420 bytes, which WireGuard takes, too."""
    monkeypatch.setattr(checks.kernel, "read_mtu", lambda _interface: own)
    monkeypatch.setattr(checks.kernel, "route_mtu", lambda _address: route)
    assert health(checks.mtu, Namespace(interface="wlan0", other_end="10.0.0.2")) == expected


@pytest.mark.parametrize(
    ("check", "lost", "setting", "expected"),
    [
        (checks.receive_buffers, 99, 212_992, "fine"),
        (checks.receive_buffers, 5000, 212_992, "wrong"),
        (checks.receive_buffers, 5000, 8 * 2**20, "fine"),  # it was raised, and the counters stay
        (checks.receive_buffers, 5000, (8 * 2**20, 212_992), "wrong"),  # the kernel cuts what arpd asks for at its most
        (checks.receive_buffers, "", 212_992, "unknown"),
        (checks.fragments, 50_000, 30, "wrong"),
        (checks.fragments, 50_000, 3, "fine"),  # lost fragments harm no others when they are soon forgotten
        (checks.fragments, 50_000, "", "unknown"),
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
    first, second = setting if isinstance(setting, tuple) else (setting, setting)
    for name, value in {"core/rmem_default": first, "core/rmem_max": second, "ipv4/ipfrag_time": first}.items():
        (tmp_path / "sys/net" / name).write_text(str(value))
    assert health(check, None, proc=tmp_path) == expected
