"""Checks of `arpd doctor` on the link: when something should be done, and when not enough is known."""

from __future__ import annotations

from dataclasses import replace

import pytest

from arpd.report.health import Announcer, Health, HeardDiscovery, PeerClock, RadioState, Unknown
from arpd.report.health_link import clock, discovery, mtu, power_save, region, signal, transports
from tests.unit.report.health_facts import facts, found

WELL = RadioState(saves_power=False, signal_dbm=-50, region="DE")


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
    one = PeerClock(peer="base", offset_s=offset_s, uncertainty_s=uncertainty_s)
    well = PeerClock(peer="laptop", offset_s=0.0, uncertainty_s=0.001)
    assert clock(facts(clocks=[well, one])).health is health


# -- radio


def radio(**changes):
    radios = {"wlan1": WELL, "wlan0": replace(WELL, **changes)}
    return {check: check(facts(radios=radios)) for check in (power_save, signal, region)}


@pytest.mark.parametrize(
    ("changes", "about", "remedy"),
    [
        ({"saves_power": True}, power_save, "sudo iw dev wlan0 set power_save off"),
        ({"signal_dbm": -80}, signal, "closer"),
        ({"region": "00"}, region, "sudo iw reg set"),
    ],
)
def test_each_fault_of_a_radio_has_its_remedy(changes, about, remedy):
    """The other judgements stay fine."""
    judged = radio(**changes)
    assert judged[about].health is Health.WRONG
    assert remedy in judged[about].remedies[0]
    assert {each.health for name, each in judged.items() if name != about} == {Health.FINE}


def test_no_country_is_guessed_and_no_file_overwritten():
    """A line that is copied as it is must not set a law of another country."""
    lines = radio(region="00")[region].remedies
    assert all("YOUR_COUNTRY" in line for line in lines)
    assert "/etc/modprobe.d/arpd-" in lines[1]


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
        (Unknown("there is no interface x"), None, Health.UNKNOWN),
    ],
)
def test_packets_of_arpds_writers_must_fit(own, route, health):
    """They have up to 1420 bytes, which WireGuard takes, too."""
    assert found(mtu, mtu_bytes=own, route_mtu_bytes=route).health is health


# -- discovery


def announcer(process="talker", *, host="laptop", is_here=False, is_arpds=False, transports=()):
    return Announcer(host=host, process=process, is_here=is_here, is_arpds=is_arpds, transports=frozenset(transports))


def heard(*announcers):
    return HeardDiscovery(domain_id=0, announcers=announcers, bytes_per_second=2000.0)


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
    assert discovery(facts(heard=heard(*announcers), has_two_ends=has_two_ends)).health is health


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
    services = [replace(OWN, transports=frozenset({own}))] if own else []
    judged = transports(facts(heard=heard(*told, *services)))
    assert (judged.health is Health.WRONG, "".join(judged.remedies).startswith(remedy)) == (bool(remedy), True)
    assert bool(judged.remedies) == bool(remedy)
