"""Selection of what crosses the link."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from arpd.model.settings import RelaySettings
from arpd.relay.selection import Side

OWN = ("/rosout", "/parameter_events", "/arpd/price", "/arpd/peer/report", "/arpd/set_parameters")
PARTS = {"feedback": "topic", "status": "topic", "send_goal": "call", "cancel_goal": "call", "get_result": "call"}


def side(*, is_far=False, **settings):
    return Side(RelaySettings(**settings), is_far=is_far)


def answers(selection, name):
    return selection.may_leave(name), selection.may_enter(name), selection.may_call(name)


def test_each_direction_has_its_patterns():
    """What may cross in one direction need not cross in the other; by default every topic does, and no service.

    A service may be called if a pattern matches it.
    """
    for topic in ("/scan", "/camera/left/image", "/tf_static", "/rosout_agg", "/arpdx", "/a_b"):
        assert answers(side(), topic) == (True, True, False)
    selection = side(to_base=("/camera/**", "/scan"), to_robot=("/cmd_vel",))
    for topic, leaves in (("/camera/left/image", True), ("/scan", True), ("/cmd_vel", False)):
        assert answers(selection, topic) == (leaves, not leaves, False)
    selection = side(services=("/map_server/*",))
    for service, is_named in (("/map_server/load_map", True), ("/map_server", False), ("/planner/make_plan", False)):
        assert selection.may_call(service) == is_named


@pytest.mark.parametrize(("part", "kind"), PARTS.items())
def test_an_action_crosses_whole(part, kind):
    """Three services and two topics of an allowed action cross in both directions, and nothing else of it."""
    selection = side(to_base=(), to_robot=(), actions=("/nav/*",))
    name = f"/nav/go/_action/{part}"
    assert answers(selection, name) == ((True, True, False) if kind == "topic" else (False, False, True))
    for other in (f"/arm/go/_action/{part}", f"/nav/go/{part}", f"/nav/go/_action/{part}2", f"/nav/_x/_action/{part}"):
        assert not any(answers(selection, other))


def test_deny_stops_an_action_by_its_name():
    """Denying an action denies its parts."""
    selection = side(actions=("/nav/*",), deny=("/nav/go",))
    assert not selection.may_call("/nav/go/_action/send_goal")
    assert not selection.may_enter("/nav/go/_action/status")
    assert selection.may_call("/nav/stop/_action/send_goal")


LEVEL = st.sampled_from(["a", "b", "arpd", "_action", "_a", "feedback", "status", "send_goal", "rosout"])
NAME = st.lists(LEVEL, min_size=1, max_size=4).map(lambda levels: "/" + "/".join(levels)) | st.sampled_from(OWN)
PATTERN = st.lists(LEVEL | st.sampled_from(["*", "**"]), min_size=1, max_size=4).map(
    lambda levels: "/" + "/".join(levels)
)
PATTERNS = st.lists(PATTERN, max_size=3).map(tuple)
SETTINGS = st.builds(
    RelaySettings, to_base=PATTERNS, to_robot=PATTERNS, deny=PATTERNS, services=PATTERNS, actions=PATTERNS
)


@given(SETTINGS, st.sampled_from(OWN))
def test_no_pattern_carries_what_is_of_ros_or_arpd_itself(settings, name):
    """A base computer has readers of /parameter_events whatever its nodes do."""
    unnamed = {key: tuple({*getattr(settings, key)} - {name}) for key in ("to_base", "to_robot")}
    assert not any(answers(Side(replace(settings, **unnamed), is_far=False), name))


def test_topics_of_ros_itself_cross_where_they_are_named():
    """Whoever wants the robot's log on the base computer names /rosout; it crosses in that direction alone."""
    named = side(to_base=("/**", *OWN), deny=("/parameter_events",))
    assert [name for name in OWN if named.may_leave(name)] == ["/rosout"]
    assert not any(named.may_enter(name) or named.may_call(name) for name in OWN)


@given(SETTINGS, NAME)
def test_what_is_denied_never_crosses(settings, name):
    """`deny` wins over every other pattern."""
    denied = replace(settings, deny=(*settings.deny, name))
    assert not any(answers(Side(denied, is_far=False), name))


def test_names_outside_the_namespace_have_no_name_on_the_robot():
    """The other robots' topics on the base computer are not this robot's, whose names come back as they went."""
    robot, base = side(namespace="/r1"), side(is_far=True, namespace="/r1")
    assert (base.local_name("/scan"), base.robot_name("/r1/scan"), base.local_name("")) == ("/r1/scan", "/scan", "")
    assert robot.local_name("/scan") == robot.robot_name("/scan") == "/scan"
    assert [base.robot_name(name) for name in ("/r1", "/r10/scan", "/r2/scan", "/scan")] == [None] * 4
