"""The other end of a relay as this one hears it."""

from dataclasses import replace

import pytest

from arpd.relay.ends.offers import EndState
from arpd.relay.partner import Partner

ONE, TWO = (EndState(session=number, host=host) for number, host in ((1, "one"), (2, "two")))

HOST = "010f0001"
OWN, PREDECESSOR = HOST + 16 * "0", HOST + 16 * "1"


def in_force(partner, *speaking, from_s, to_s):
    """Let these ends say once a second that they live; return the one that is in force then."""
    now_s = from_s
    while now_s < to_s:
        for end in speaking:
            partner.hear(end.session, now_s)
        partner.look(now_s)
        now_s += 1.0
    return partner.look(to_s)


def test_a_restarted_end_takes_over_when_the_old_one_is_silent():
    """The new session of a killed end is in force once the old one has missed a sign of life."""
    partner = Partner(own=OWN)
    partner.tell(ONE, 0.0)
    assert in_force(partner, ONE, from_s=0.0, to_s=5.9) is ONE
    partner.tell(TWO, 6.0)
    assert partner.look(6.0) is ONE
    assert in_force(partner, TWO, from_s=6.0, to_s=7.0) is TWO


def test_of_two_ends_the_first_stays_and_the_other_is_named():
    """While both speak, the first one is in force; when it stops, the other one is."""
    partner = Partner(own=OWN)
    partner.tell(ONE, 0.0)
    partner.look(0.0)
    partner.tell(TWO, 0.5)
    assert in_force(partner, ONE, TWO, from_s=1.0, to_s=20.0) is ONE
    assert partner.others(20.0) == ["two"]
    assert in_force(partner, TWO, from_s=20.0, to_s=22.0) is TWO
    assert partner.others(22.0) == []


def test_an_outage_is_bridged_and_a_long_silence_is_the_end():
    """In an outage the end is unreachable but known; after half a minute it is gone, and may return without a word."""
    partner = Partner(own=OWN)
    partner.tell(ONE, 0.0)
    partner.look(0.0)
    known = [(partner.look(now_s), partner.is_reachable(now_s)) for now_s in (3.0, 20.0, 31.0)]
    assert known == [(ONE, True), (ONE, False), (None, False)]
    partner.hear(ONE.session, 40.0)
    assert partner.look(40.0) is ONE


def test_a_second_end_on_a_host_follows_nobody_while_the_first_one_lives():
    """Else each sample would arrive there twice; one that restarts follows when the other end has missed the first."""
    partner = Partner(own=OWN)
    partner.tell(replace(ONE, follows=PREDECESSOR), 100.0)
    assert partner.look(100.0) is None
    assert in_force(partner, ONE, from_s=100.0, to_s=120.0) is None
    assert partner.elsewhere(120.0) == ["one"]
    partner.tell(free := replace(ONE, follows=""), 121.0)
    assert partner.look(121.0) is free


@pytest.mark.parametrize(
    ("followed", "hears", "is_deaf"), [(True, False, True), (True, True, False), (False, False, False)]
)
def test_an_end_that_speaks_and_hears_nothing_any_more_is_deaf(followed, hears, is_deaf):
    """It was followed before, an outage is over, and 20 s later the other end still follows nobody."""
    partner, follows = Partner(own=OWN), replace(ONE, follows=OWN)
    partner.tell(follows if followed else ONE, 0.0)
    partner.look(0.0)
    partner.look(60.0)
    partner.tell(ONE, 60.0)
    assert in_force(partner, ONE, from_s=60.0, to_s=79.0) is ONE
    assert not partner.is_deaf(79.0)
    if hears:
        partner.tell(follows, 79.0)
    in_force(partner, ONE, from_s=79.0, to_s=99.0)
    assert partner.is_deaf(99.0) is is_deaf
