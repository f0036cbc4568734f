"""Which of several daemons drives: all of them come to the same result, and somebody always does."""

from hypothesis import given
from hypothesis import strategies as st

from arpd.observe.leader import DaemonHeartbeat, Leader


def claim(started_ns, token):
    return DaemonHeartbeat(started_ns=started_ns, token=token, host=f"host-{token}")


@given(st.lists(st.integers(0, 3), min_size=1, max_size=6))
def test_all_daemons_agree_on_one(starts):
    """However many there are, and however alike their starts, exactly one drives and the others name it."""
    claims = [claim(started_ns, f"{k}") for k, started_ns in enumerate(starts)]
    seen = []
    for own in claims:
        incumbency = Leader(own)
        for other in claims:
            incumbency.note(other, 0.0)
            incumbency.note(other, 0.5)
        seen.append(incumbency.active_daemon(1.0))
        assert len(incumbency.others(1.0)) == len(claims) - 1
    assert seen.count(None) == 1
    assert {active_daemon for active_daemon in seen if active_daemon} <= {claims[seen.index(None)]}


def test_the_one_that_started_first_drives():
    """A second daemon, started by mistake, changes nothing for the first."""
    elder, younger = Leader(claim(1, "b")), Leader(claim(2, "a"))
    for now_s in (0.0, 0.5):
        elder.note(claim(2, "a"), now_s)
        younger.note(claim(1, "b"), now_s)
    assert elder.active_daemon(0.6) is None
    assert younger.active_daemon(0.6) == claim(1, "b")


def test_whoever_falls_silent_is_succeeded():
    """Two seconds after the last claim of the one in charge, the next one drives."""
    younger = Leader(claim(2, "a"))
    younger.note(claim(1, "b"), 4.5)
    younger.note(claim(1, "b"), 5.0)
    assert younger.active_daemon(6.9)
    assert younger.active_daemon(7.1) is None
    assert not younger.others(7.1)


def test_its_own_claim_is_no_rival():
    """What a daemon says comes back to it, and means nothing."""
    own = Leader(claim(2, "a"))
    for now_s in (0.0, 0.5):
        own.note(claim(2, "a"), now_s)
        own.note(claim(1, "a"), now_s)
    assert not own.others(0.5)


def test_a_liar_takes_no_memory():
    """Only so many claims are remembered, and those that are there already stay."""
    own = Leader(claim(2, "a"))
    own.note(claim(1, "b"), 0.0)
    for now_s in (1.0, 1.5):
        assert sum(own.note(claim(3 + k, f"liar-{k}"), now_s) for k in range(1000)) < 32
    own.note(claim(1, "b"), 1.5)
    assert len(own.others(1.5)) <= 32
    assert own.active_daemon(1.5) == claim(1, "b")


def test_a_name_that_is_heard_once_is_nobody():
    """Whoever claims under a new name each time is believed under none of them, and keeps nobody out for long."""
    own = Leader(claim(9, "a"))
    for k in range(100):
        own.note(claim(1, f"liar-{k}"), k / 10)
        assert own.active_daemon(k / 10) is None
    for now_s in (12.0, 12.5):
        assert own.note(claim(2, "b"), now_s)
    assert own.active_daemon(12.5) == claim(2, "b")


def test_no_more_daemons_are_believed_than_there_can_be():
    """Of more claims than nodes that could make them, those heard for longest count."""
    own = Leader(claim(9, "a"))
    for now_s, others in ((0.0, "b"), (0.5, "b"), (1.0, "bc"), (1.5, "bc")):
        for token in others:
            own.note(claim(5 if token == "b" else 1, token), now_s)
    assert own.active_daemon(1.5, most=1) == claim(5, "b")
    assert own.active_daemon(1.5, most=2) == claim(1, "c")
    assert own.active_daemon(1.5, most=0) is None
