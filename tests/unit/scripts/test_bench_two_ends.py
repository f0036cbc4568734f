"""The accounting of the bench with two ends: each missing sample has one reason."""

from __future__ import annotations

import random

import pytest

from scripts.bench.reliability_course import HOUR, KILLS_UNTIL, schedule
from scripts.bench.two_ends import TEN_MINUTES
from scripts.bench.two_ends_account import Death, Reading, gaps, reachable, row, sets_of, unfolded, withheld_outside
from scripts.bench.two_ends_calls import summary
from scripts.bench.two_ends_nodes import set_number_of, spans, stamped

SENT_S = [float(second) for second in range(20)]  # a sample a second
KILL = Death(host="robot", killed_s=5.5, started_s=6.5)


def noted(numbers, **changes):
    return {"spans": spans(set(numbers)), "doubled": 0, "late": 0} | changes


def reading(at_s, offered, withheld):
    return Reading(at_s=at_s, offered=offered, published=offered - withheld, withheld=withheld)


def whole(writer, readings=(), deaths=(KILL,), host="robot"):
    (of_writer,) = (found := row([("w", SENT_S, writer)], list(readings), list(deaths), host=host)).pop("writers")
    return found | of_writer


@pytest.mark.parametrize(("host", "near", "far"), [("robot", 4, 0), ("ceddp", 0, 4)])
def test_samples_missing_around_a_death_are_that_end_s(host, near, far):
    """What is missing from the last sample before a kill to the first one after the new start is not lost."""
    found = whole(noted(set(range(20)) - {5, 6, 7, 8}), host=host)
    assert (found["while_near_dead"], found["while_far_dead"], found["lost"]) == (near, far, 0)
    assert found["again_s"] == [pytest.approx(2.5)]


def test_a_sample_missing_elsewhere_is_lost():
    """A sample that is missing while both ends live is lost, even soon after a death."""
    found = whole(noted(set(range(20)) - {6, 9, 15}))
    assert (found["while_near_dead"], found["lost"], found["first_missing_s"]) == (1, 2, [9.0, 15.0])


def test_an_end_that_never_returns_is_said():
    """A topic that does not flow again has no time, and all its samples count for the dead end."""
    found = whole(noted(range(5)))
    assert (found["never_again"], found["again_s"], found["while_near_dead"], found["lost"]) == (1, [], 15, 0)


def test_an_end_that_starts_in_an_outage_is_reachable_after_it():
    """A process that starts while the link is out cannot be blamed for the outage."""
    assert reachable(KILL, [(1.0, 3.0), (6.0, 9.0), (12.0, 14.0)]).started_s == 9.0
    assert reachable(KILL, [(1.0, 3.0), (12.0, 14.0)]) == KILL


def test_a_kill_that_is_cut_short_has_no_time():
    """The time until a topic flows again counts from the last of several kills."""
    found = whole(noted(set(range(20)) - {6, 7, 8, 9}), deaths=(KILL, Death(host="ceddp", killed_s=8.5, started_s=9.5)))
    assert found["again_s"] == [pytest.approx(0.5)]
    assert found["never_again"] == 0


def test_with_both_ends_dead_a_sample_counts_once():
    """A sample that neither end could carry never reached arpd."""
    both = (KILL, Death(host="ceddp", killed_s=5.5, started_s=6.5))
    found = whole(noted(set(range(20)) - {5, 6}), deaths=both)
    assert (found["while_near_dead"], found["while_far_dead"]) == (2, 0)


def test_what_pacing_withholds_is_not_lost():
    """Counters explain what is missing outside of the gaps, over the restart of the counters."""
    arrived = set(range(20)) - {1, 3} - {5, 6, 7} - {12, 14, 16}
    readings = [reading(4.5, 5, 2), reading(9.5, 2, 0), reading(19.5, 12, 2)]
    found = whole(noted(arrived), readings)
    assert (found["withheld"], found["lost"]) == (4, 1)


def test_counters_inside_a_gap_do_not_explain_what_is_missing_outside():
    """What a publisher withholds as the other end is dead counts for the death."""
    readings = [reading(2.0, 2, 1), reading(6.0, 6, 3), reading(12.0, 12, 4)]
    (gap,) = gaps(SENT_S, set(range(20)) - {4, 5, 6}, [KILL], "ceddp")
    assert (gap.begin_s, gap.over_s) == (3.0, 7.0)
    assert withheld_outside(readings, [gap]) == 2


def test_spans_hold_all_numbers():
    """A document has spans instead of numbers."""
    assert spans({3, 1, 2, 7}) == [[1, 3], [7, 7]]
    assert unfolded([[1, 3], [7, 7]]) == {1, 2, 3, 7}


def test_a_set_is_complete_with_all_three():
    """A set of which one topic lacks its sample is incomplete."""
    assert sets_of([{1, 2, 3}, {1, 3, 4}, {1, 3}]) == ({1, 3}, {2, 4})


@pytest.mark.parametrize("number", [0, 9, 10, 12_345])
def test_a_stamp_says_its_set(number):
    """The header stamp of a set's samples holds its number."""
    assert set_number_of(stamped(bytes(64), number)) == number


def test_a_call_that_fails_and_answers_is_a_fault():
    """Each call is answered or has failed, and its server ran it at most once."""
    one = {"begun_s": 4.0, "answers": 1, "is_wrong": False, "has_failed": False, "took_s": 0.5}
    made = {"0": one, "1": one | {"has_failed": True}, "2": one | {"begun_s": 9.0, "answers": 0, "has_failed": True}}
    found = summary(made, {"0": 1, "1": 2, "2": 1}, deaf=[(8.5, 9.5)])
    assert found["failed_meanwhile"] == 1
    assert (found["answered"], found["failed"], found["both"], found["neither"]) == (2, 2, 1, 0)
    assert (found["ran_twice"], found["failed_but_ran"], found["answered_but_never_ran"]) == (1, 2, 0)


@pytest.mark.parametrize("minutes", [2.0, 10.0])
def test_a_course_has_every_kind_and_kills_early(minutes):
    """A short run has each kind of event, and all kills come before its calm end."""
    events = schedule(minutes, random.Random(1), TEN_MINUTES, of_minutes=10.0)
    assert {event.kind for event in events} == TEN_MINUTES.keys()
    assert max(event.at_s for event in events if event.kind.startswith("kill")) < KILLS_UNTIL * minutes * 60.0
    assert {event.kind for event in schedule(minutes, random.Random(1))} == HOUR.keys()
