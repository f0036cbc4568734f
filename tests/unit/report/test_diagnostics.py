"""ROS diagnostics of a snapshot."""

from dataclasses import replace

import pytest

from arpd.model.link import LinkState
from arpd.report.diagnostics import Level, diagnose
from tests.golden.sample import FINISHED_AT_S, held
from tests.golden.sample import changed as sample


def calm(**parts):
    """Return a snapshot without a fault and with nothing to slow: the camera publishes 12 Hz, and may send 12.5."""
    publishers = tuple(
        replace(each, source_rate_hz=12.0) if each.topic == "/camera/image" else each
        for each in sample().observation.publishers
    )
    parts["observation"] = {"publishers": publishers, **parts.get("observation", {})}
    return held(sample(confirmed=3, **parts))


def statuses(snapshot, *, after_s=0.0):
    return {status.name.removeprefix("arpd: "): status for status in diagnose(snapshot, now_s=FINISHED_AT_S + after_s)}


@pytest.mark.parametrize(
    ("snapshot", "part", "level", "words"),
    [
        (calm(link={"state": LinkState.OUTAGE}), "link", Level.ERROR, "The link carries nothing"),
        (calm(observation={"active_daemon": "robot-2"}), "plan", Level.WARN, "Standing by"),
        (calm(config_error="a.yaml:1:1: x"), "configuration", Level.WARN, "Reload refused: a.yaml:1:1: x"),
    ],
)
def test_what_is_wrong_has_a_level_and_a_reason(snapshot, part, level, words):
    """The part that is wrong says so, and no other."""
    told = statuses(snapshot)
    assert told[part].level is level
    assert words in told[part].message
    assert [name for name, status in told.items() if status.level is not Level.OK] == [part]


def test_each_publisher_that_the_link_slows_has_a_value():
    """Several nodes may publish one topic."""
    publishers = sample().observation.publishers
    other = replace(publishers[-1], node="/camera2")
    told = statuses(sample(observation={"publishers": (*publishers, other)}))["plan"].values
    assert [told[f"/camera/image of {node}"] for node in ("/camera", "/camera2")] == ["12.5 of 30 Hz"] * 2


def test_ticks_that_fail_and_a_daemon_that_starts_are_stale():
    """A monitor never shows an old state as the present one."""
    late = statuses(calm(), after_s=12.0)
    assert {status.level for status in late.values()} == {Level.STALE}
    assert "the last one finished 12 s ago" in late["link"].message
    assert {status.level for status in statuses(None).values()} == {Level.STALE}
