"""Leader of several daemons: all come to the same result, and one always drives."""

from hypothesis import given
from hypothesis import strategies as st

from arpd.observe.leader import DaemonHeartbeat, Leader


def heartbeat(started_ns, token):
    return DaemonHeartbeat(started_ns=started_ns, token=token, host=f"host-{token}")


@given(st.lists(st.integers(0, 3), min_size=1, max_size=6))
def test_all_daemons_agree_on_one(starts):
    """With any number of daemons and any starts, exactly one drives and the others name it."""
    heartbeats = [heartbeat(started_ns, f"{k}") for k, started_ns in enumerate(starts)]
    seen = []
    for own in heartbeats:
        leader = Leader(own)
        for other in heartbeats:
            leader.note(other, 0.0)
            leader.note(other, 0.5)
        seen.append(leader.active_daemon(1.0))
        assert len(leader.others(1.0)) == len(heartbeats) - 1
    assert seen.count(None) == 1
    assert {active_daemon for active_daemon in seen if active_daemon} <= {heartbeats[seen.index(None)]}


def test_the_one_that_started_first_drives():
    """A second daemon, started by mistake, changes nothing for the first."""
    elder, younger = Leader(heartbeat(1, "b")), Leader(heartbeat(2, "a"))
    for now_s in (0.0, 0.5):
        elder.note(heartbeat(2, "a"), now_s)
        younger.note(heartbeat(1, "b"), now_s)
    assert elder.active_daemon(0.6) is None
    assert younger.active_daemon(0.6) == heartbeat(1, "b")


def test_a_silent_active_daemon_is_succeeded():
    """Two seconds after the last heartbeat of the active daemon the next one drives."""
    younger = Leader(heartbeat(2, "a"))
    younger.note(heartbeat(1, "b"), 4.5)
    younger.note(heartbeat(1, "b"), 5.0)
    assert younger.active_daemon(6.9)
    assert younger.active_daemon(7.1) is None
    assert not younger.others(7.1)


def test_invented_daemons_take_no_memory():
    """The number of remembered daemons is bounded, and known ones stay."""
    own = Leader(heartbeat(2, "a"))
    own.note(heartbeat(1, "b"), 0.0)
    for now_s in (1.0, 1.5):
        assert sum(own.note(heartbeat(3 + k, f"liar-{k}"), now_s) for k in range(1000)) < 32
    own.note(heartbeat(1, "b"), 1.5)
    assert len(own.others(1.5)) <= 32
    assert own.active_daemon(1.5) == heartbeat(1, "b")


def test_a_name_that_is_heard_once_does_not_count():
    """A sender that uses a new name each time never becomes leader, and keeps others out only briefly."""
    own = Leader(heartbeat(9, "a"))
    for k in range(100):
        own.note(heartbeat(1, f"liar-{k}"), k / 10)
        assert own.active_daemon(k / 10) is None
    for now_s in (12.0, 12.5):
        assert own.note(heartbeat(2, "b"), now_s)
    assert own.active_daemon(12.5) == heartbeat(2, "b")


def test_no_more_daemons_are_believed_than_there_can_be():
    """Among more names than there can be daemons, those heard for longest count."""
    own = Leader(heartbeat(9, "a"))
    for now_s, others in ((0.0, "b"), (0.5, "b"), (1.0, "bc"), (1.5, "bc")):
        for token in others:
            own.note(heartbeat(5 if token == "b" else 1, token), now_s)
    assert own.active_daemon(1.5, most=1) == heartbeat(5, "b")
    assert own.active_daemon(1.5, most=2) == heartbeat(1, "c")
    assert own.active_daemon(1.5, most=0) is None
