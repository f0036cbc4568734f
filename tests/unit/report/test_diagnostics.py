"""ROS diagnostics of a snapshot."""

from __future__ import annotations

from dataclasses import replace

import pytest

from arpd.model.allocation import AllocationStatus
from arpd.model.link import LinkState
from arpd.report.decision_log import DecisionLog
from arpd.report.diagnostics import Level, diagnose
from tests.golden.sample import FINISHED_AT_S
from tests.golden.sample import changed as sample


def calm(**parts):
    """Return a snapshot without a fault and with nothing to slow: the camera publishes 12 Hz, and may send 12.5."""
    publishers = tuple(
        replace(each, source_rate_hz=12.0) if each.topic == "/camera/image" else each
        for each in sample().observation.publishers
    )
    parts["observation"] = {"publishers": publishers, **parts.get("observation", {})}
    return sample(**parts)


def statuses(snapshot, *, after_s=0.0):
    return {status.name.removeprefix("arpd: "): status for status in diagnose(snapshot, now_s=FINISHED_AT_S + after_s)}


def test_a_healthy_daemon_is_ok_everywhere():
    """Messages are sentences, values carry units."""
    told = statuses(calm())
    assert {name: (status.level, status.message) for name, status in told.items()} == {
        "link": (Level.OK, "4 Mbit/s, steady"),
        "plan": (Level.OK, "plan 3: 2 of 3 publishers, 1 of 1 readers confirmed"),
        "configuration": (Level.OK, "in force since 1970-01-01T00:00:00Z"),
        "events": (Level.OK, "nothing has happened yet"),
    }
    assert dict(told["link"].values)["cross traffic"] == "500 kbit/s"
    assert dict(told["link"].values)["peers"] == "ceddp-3f2a (62.5 ms ago), edge-c001 (12.5 s ago)"


@pytest.mark.parametrize(
    ("snapshot", "part", "level", "words"),
    [
        (calm(link={"state": LinkState.OUTAGE}), "link", Level.ERROR, "The link carries nothing"),
        (calm(observation={"counters": None}), "link", Level.ERROR, "wlan0 is gone"),
        (calm(link={"state": LinkState.CONGESTED}), "link", Level.WARN, "12.5 ms of queue"),
        (
            calm(allocation={"status": AllocationStatus.DEGRADED, "degradation": "rate reserve 0 % left"}),
            "plan",
            Level.WARN,
            "rate reserve 0 % left",
        ),
        (calm(observation={"active_daemon": "robot-2"}), "plan", Level.WARN, "Standing by"),
        (calm(config_error="a.yaml:1:1: x"), "configuration", Level.ERROR, "Reload refused: a.yaml:1:1: x"),
        (calm(keys_awaiting_restart=("http.port",)), "configuration", Level.WARN, "http.port"),
    ],
)
def test_what_is_wrong_has_a_level_and_a_reason(snapshot, part, level, words):
    """The part that is wrong says so, and no other."""
    told = statuses(snapshot)
    assert told[part].level is level
    assert words in told[part].message
    assert [name for name, status in told.items() if status.level is not Level.OK] == [part]


def test_the_last_events_are_values_and_the_worst_of_a_minute_is_the_level():
    """The newest first, each with its time; a minute later an error is only history."""
    decision_log, at_s = DecisionLog(), 0.0
    for state in [LinkState.STEADY, LinkState.OUTAGE, LinkState.STEADY] * 4:
        at_s += 60.0
        snapshot = calm(link={"state": state}, finished_at_s=FINISHED_AT_S + at_s, unix_time_s=1.7e9 + at_s)
        decision_log.follow(snapshot)
    told = statuses(replace(snapshot, events=decision_log.events), after_s=at_s)["events"]
    assert told.message.startswith("the link carries again after")
    assert told.level is Level.OK
    assert len(told.values) == 10
    assert told.values[0] == ("2023-11-14T22:25:20Z recovered", told.message)
    outage = decision_log.events[-2]
    during = replace(snapshot, events=decision_log.events[:-1], unix_time_s=outage.unix_time_s + 59.0)
    assert statuses(during, after_s=at_s)["events"].level is Level.ERROR


def test_ticks_that_fail_and_a_daemon_that_starts_are_stale():
    """A monitor never shows an old state as the present one."""
    late = statuses(calm(), after_s=12.0)
    assert {status.level for status in late.values()} == {Level.STALE}
    assert "the last one finished 12 s ago" in late["link"].message
    assert {status.level for status in statuses(None).values()} == {Level.STALE}


def test_many_slowed_topics_are_counted():
    """Ten are named, the most slowed first, and the rest are a number."""
    snapshot = sample()
    camera = next(state for state in snapshot.observation.publishers if state.topic == "/camera/image")
    row = snapshot.decision.plan.topics["/camera/image"]
    many = tuple(replace(camera, topic=f"/c{n:02d}", source_rate_hz=30.0 + n) for n in range(15))
    plan = replace(snapshot.decision.plan, topics={state.topic: row for state in many})
    allocated = tuple(replace(snapshot.allocation.topics[0], name=state.topic) for state in many)
    crowded = sample(observation={"publishers": many}, decision={"plan": plan}, allocation={"topics": allocated})
    status = statuses(crowded)["plan"]
    assert (status.level, status.message.partition(":")[0]) == (Level.WARN, "The link is the limit")
    values = dict(status.values)
    assert values["/c14"] == "12.5 of 44 Hz"
    assert values["further topics slowed"] == "5"
    assert "/c00" not in values
