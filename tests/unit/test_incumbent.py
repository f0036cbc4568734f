"""Which of several daemons drives: all of them come to the same result, and somebody always does."""

from hypothesis import given
from hypothesis import strategies as st

from arpd.incumbent import Claim, Incumbency


def claim(started_ns, token):
    return Claim(started_ns=started_ns, token=token, host=f"host-{token}")


@given(st.lists(st.integers(0, 3), min_size=1, max_size=6))
def test_all_daemons_agree_on_one(starts):
    """However many there are, and however alike their starts, exactly one drives and the others name it."""
    claims = [claim(started_ns, f"{k}") for k, started_ns in enumerate(starts)]
    seen = []
    for own in claims:
        incumbency = Incumbency(own)
        for other in claims:
            incumbency.note(other, 0.0)
        seen.append(incumbency.superior(1.0))
        assert len(incumbency.others(1.0)) == len(claims) - 1
    assert seen.count(None) == 1
    assert {superior for superior in seen if superior} <= {claims[seen.index(None)]}


def test_the_one_that_started_first_drives():
    """A second daemon, started by mistake, changes nothing for the first."""
    elder, younger = Incumbency(claim(1, "b")), Incumbency(claim(2, "a"))
    elder.note(claim(2, "a"), 0.0)
    younger.note(claim(1, "b"), 0.0)
    assert elder.superior(0.1) is None
    assert younger.superior(0.1) == claim(1, "b")


def test_whoever_falls_silent_is_succeeded():
    """Two seconds after the last claim of the one in charge, the next one drives."""
    younger = Incumbency(claim(2, "a"))
    younger.note(claim(1, "b"), 0.0)
    younger.note(claim(1, "b"), 5.0)
    assert younger.superior(6.9)
    assert younger.superior(7.1) is None
    assert not younger.others(7.1)


def test_its_own_claim_is_no_rival():
    """What a daemon says comes back to it, and means nothing."""
    own = Incumbency(claim(2, "a"))
    own.note(claim(2, "a"), 0.0)
    own.note(claim(1, "a"), 0.0)
    assert not own.others(0.0)


def test_a_liar_takes_no_memory():
    """Only so many claims are remembered, and those that are there already stay."""
    own = Incumbency(claim(2, "a"))
    own.note(claim(1, "b"), 0.0)
    for k in range(1000):
        own.note(claim(3 + k, f"liar-{k}"), 1.0)
    own.note(claim(1, "b"), 1.0)
    assert len(own.others(1.0)) <= 32
    assert own.superior(1.0) == claim(1, "b")
