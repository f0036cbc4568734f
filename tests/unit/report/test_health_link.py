"""Judgements of `arpd doctor` about the link: when something should be done, and when not enough is known."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from arpd.report.health import Health, Unknown
from arpd.report.health_link import (
    Announcer,
    HeardDiscovery,
    PeerClock,
    RadioState,
    judge_clock,
    judge_discovery,
    judge_mtu,
    judge_radio,
)

WELL = RadioState(saves_power=False, signal_dbm=-50, region="DE")


def clock(offset_s, uncertainty_s=0.001, *, is_synchronised=None, is_far=False):
    clocks = [PeerClock(peer="ceddp", offset_s=offset_s, uncertainty_s=uncertainty_s)]
    return list(judge_clock(clocks, is_synchronised=is_synchronised, is_far=is_far))


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
    assert clock(offset_s, uncertainty_s)[0].health is health


@given(true_s=st.floats(-0.02, 0.02), error_s=st.floats(0.0, 1.0), part=st.floats(-1.0, 1.0))
def test_a_clock_within_20_ms_is_never_called_wrong(true_s, error_s, part):
    """Whatever the measurement says within its bound."""
    assert clock(true_s + part * error_s * 0.999, error_s)[0].health is not Health.WRONG


def test_the_worst_of_several_clocks_counts():
    """One peer that is off is enough."""
    clocks = [PeerClock(peer=name, offset_s=off, uncertainty_s=0.001) for name, off in (("a", 0.0), ("b", -2.0))]
    (judged,) = judge_clock(clocks, is_synchronised=None, is_far=False)
    assert judged.health is Health.WRONG
    assert "clock of b is 2 s behind the robot's" in judged.text


@pytest.mark.parametrize(
    ("is_synchronised", "is_far", "where"),
    [
        (True, False, "# on the CEDDP"),
        (True, True, "# on the robot"),
        (False, False, "# here"),
        (None, False, "# here and on the CEDDP"),
    ],
)
def test_the_remedy_names_the_side_that_is_likely_wrong(is_synchronised, is_far, where):
    """A clock that something keeps right is not the one to mend."""
    (judged,) = clock(1.0, is_synchronised=is_synchronised, is_far=is_far)
    assert where in judged.remedies[0]


def test_the_lines_without_internet_are_complete():
    """Each end has one, and chrony reads what it wrote."""
    (judged,) = clock(1.0)
    lines = [line for line in judged.remedies if "without internet" in line]
    assert [line.rpartition("# ")[2] for line in lines] == [
        f"without internet, on the {end}" for end in ("CEDDP", "robot")
    ]
    for line in lines:
        written, _, restarted = line.partition("   #")[0].partition(" && ")
        assert "/etc/chrony/" in written
        assert restarted == "sudo systemctl restart chrony"


@pytest.mark.parametrize("clocks", [Unknown("no daemon answers"), []])
def test_a_clock_that_nobody_keeps_is_said_where_the_offset_is_not_known(clocks):
    """It may be right all the same, so nothing is called wrong."""
    judged = list(judge_clock(clocks, is_synchronised=False, is_far=False))
    assert [each.health for each in judged] == [Health.UNKNOWN, Health.UNKNOWN]
    assert len(list(judge_clock(clocks, is_synchronised=True, is_far=False))) == 1
    assert len(clock(0.0, is_synchronised=False)) == 1


# -- radio


def radio(**changes):
    return {each.about: each for each in judge_radio("wlan0", replace(WELL, **changes))}


def test_a_good_radio_is_fine():
    """All three, and one line for an interface without a radio."""
    assert {each.health for each in radio().values()} == {Health.FINE}
    assert [each.health for each in judge_radio("eth0", None)] == [Health.FINE]


@pytest.mark.parametrize(
    ("changes", "about", "remedy"),
    [
        ({"saves_power": True}, "power save", "sudo iw dev wlan0 set power_save off"),
        ({"signal_dbm": -80}, "signal", "closer"),
        ({"region": "00"}, "region", "sudo iw reg set"),
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
    lines = radio(region="00")["region"].remedies
    assert all("YOUR_COUNTRY" in line for line in lines)
    assert "/etc/modprobe.d/arpd-" in lines[1]


def test_power_save_stays_off_by_whatever_sets_it():
    """NetworkManager has a setting; without it udev does it."""
    assert "NetworkManager" in radio(saves_power=True, has_network_manager=True)["power save"].remedies[1]
    assert "udev" in radio(saves_power=True)["power save"].remedies[1]


def test_the_rule_of_udev_holds_for_renamed_interfaces_too():
    """The kernel calls wlp2s0 wlan0 when it adds it; the new name is known from rule 80 on."""
    (judged,) = (each for each in judge_radio("wlp2s0", replace(WELL, saves_power=True)) if each.health is Health.WRONG)
    line = judged.remedies[1]
    assert "wlp2s0" not in line
    assert "$name" in line
    assert "/81-" in line


def test_what_the_radio_does_not_tell_is_not_known():
    """No alarm without a fact."""
    silent = Unknown("the driver does not tell")
    judged = radio(saves_power=silent, signal_dbm=silent, region=silent)
    assert {each.health for each in judged.values()} == {Health.UNKNOWN}


# -- packets


@pytest.mark.parametrize(
    ("mtu", "route", "health"),
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
def test_packets_of_arpds_writers_must_fit(mtu, route, health):
    """They have up to 1420 bytes, which WireGuard takes, too."""
    assert judge_mtu("wlan0", mtu, route_bytes=route).health is health


# -- discovery


def announcer(process="talker", *, host="laptop", is_here=False, is_arpds=False):
    return Announcer(host=host, process=process, is_here=is_here, is_arpds=is_arpds)


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
    assert judge_discovery(heard(*announcers), interface="wlan0", has_two_ends=has_two_ends).health is health


def test_nodes_on_the_link_are_named():
    """Own ones by their commands, others by their hosts, and the rate of it all."""
    judged = judge_discovery(heard(NODE, announcer()), interface="wlan0", has_two_ends=True)
    for part in ("2 participants", "camera", "1 of laptop", "2 kB/s", "wlan0"):
        assert part in judged.text
    assert judged.remedies[0].startswith("export ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST")


def test_what_was_not_heard_is_not_known():
    """Silence for want of a socket is no silence."""
    judged = judge_discovery(Unknown("cannot listen"), interface="wlan0", has_two_ends=True)
    assert judged.health is Health.UNKNOWN
