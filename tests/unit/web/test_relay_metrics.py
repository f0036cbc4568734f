"""Metrics of the relay with two ends; the golden exposition has all of them once."""

from dataclasses import replace

import pytest

from arpd.model.relay import RelaySummary, RelayTopics
from arpd.web.metrics import SnapshotCollector
from tests.golden.sample import make_snapshot


def samples(**fields):
    """Return the values of the relay's metrics by name and labels."""
    snapshot = make_snapshot()
    snapshot = replace(snapshot, observation=replace(snapshot.observation, **{"relay": None, **fields}))
    return {
        (sample.name, *sample.labels.values()): sample.value
        for family in SnapshotCollector(lambda: snapshot).collect()
        for sample in family.samples
        if sample.name.startswith("arpd_relay_")
    }


def test_a_silent_end_is_down_and_nothing_else_is_known():
    """Its last counts would look as if they were new."""
    assert samples(is_relay_silent=True) == {("arpd_relay_end_up",): 0.0}


@pytest.mark.parametrize(
    ("summary", "is_up"),
    [
        (RelaySummary(is_reachable=True), 1.0),
        (RelaySummary(is_reachable=True, fault="it speaks version 2"), 0.0),
        (RelaySummary(other_host="base"), 0.0),
    ],
)
def test_the_other_end_is_up_while_it_is_heard_and_understood(summary, is_up):
    """An end of another version carries nothing, so it is down too."""
    found = samples(relay=summary)
    assert (found["arpd_relay_end_up",], found["arpd_relay_other_end_up",]) == (1.0, is_up)


def test_no_message_adds_a_label():
    """Refused topics are counted by direction, and an unknown reason of failed calls has no series."""
    refused = RelayTopics(refused={"/a": "b", "/c": "d"})
    found = samples(relay=RelaySummary(to_robot=refused, calls_failed={"timeout": 2, "invented": 9}))
    assert found["arpd_relay_topics", "to_robot", "refused"] == 2
    assert found["arpd_relay_calls_failed_total", "timeout"] == 2
    assert not any("invented" in key for key in found)
