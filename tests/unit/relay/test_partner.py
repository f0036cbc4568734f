"""The other end of a relay as this one hears it."""

from arpd.relay.ends.offers import EndState
from arpd.relay.partner import Partner


def in_force(partner):
    assert partner.state is not None
    return partner.state


OLD, NEW = ONE, TWO = 1, 2  # sessions


def state(session, number=1, host=""):
    return EndState(session=session, serial=number, host=host)


def heard(partner, *sessions, from_s, to_s):
    """Let these sessions say once a second that they live."""
    now_s = from_s
    while now_s <= to_s:
        for session in sessions:
            partner.hear(session, now_s)
        partner.look(now_s)
        now_s += 1.0


def test_a_restarted_end_takes_over_when_the_old_one_is_silent():
    """The new session of a killed end is in force once the old one has missed a sign of life."""
    partner = Partner()
    partner.hear(OLD, 0.0, state(OLD, 2))
    partner.hear(OLD, 0.1, state(OLD, 1))  # late
    heard(partner, OLD, from_s=0.0, to_s=5.0)
    assert in_force(partner).serial == 2
    partner.hear(NEW, 6.0, state(NEW))
    partner.look(6.0)
    assert in_force(partner).session == OLD
    heard(partner, NEW, from_s=6.0, to_s=7.0)
    assert in_force(partner).session == NEW


def test_of_two_ends_the_first_stays_and_the_other_is_named():
    """While both speak, the first one is in force; when it stops, the other one is."""
    partner = Partner()
    partner.hear(ONE, 0.0, state(ONE, host="one"))
    partner.look(0.0)
    partner.hear(TWO, 0.5, state(TWO, host="two"))
    heard(partner, ONE, TWO, from_s=1.0, to_s=20.0)
    assert in_force(partner).host == "one"
    assert partner.others(20.0) == ["two"]
    heard(partner, TWO, from_s=21.0, to_s=23.0)
    assert in_force(partner).host == "two"
    assert partner.others(23.0) == []


def test_an_outage_is_bridged_and_a_long_silence_is_the_end():
    """In an outage the end is unreachable but known; after half a minute it is gone."""
    partner = Partner()
    partner.hear(ONE, 0.0, state(ONE))
    partner.look(0.0)
    assert partner.is_reachable(3.0)
    partner.look(20.0)
    assert in_force(partner)
    assert not partner.is_reachable(20.0)
    partner.look(31.0)
    assert partner.state is None
    assert not partner.is_reachable(31.0)
    partner.hear(ONE, 40.0)
    partner.look(40.0)
    assert in_force(partner)
