"""The one judgement of a snapshot, and the line for systemd."""

from __future__ import annotations

import math
import re
from pathlib import Path
from types import MappingProxyType

import pytest

import arpd.web
from arpd.model.allocation import AllocationStatus
from arpd.model.link import LinkState
from arpd.model.plan import QosPlan
from arpd.model.relay import RelaySummary, RelayTopics
from arpd.report.events import Event, EventKind, Severity
from arpd.report.situation import STALE_AFTER_S, Condition, judge, status_line
from tests.golden.sample import FINISHED_AT_S, changed

NO_PLAN = QosPlan(generation=0, topics=MappingProxyType({}), level_bytes_per_second=0.0)
CALM = {"link": {"loss_ratio": 0.0}}


def events(*told):
    """Return events: kind, and how long before the snapshot (s)."""
    return tuple(
        Event(number=n, unix_time_s=1.7e9 - ago_s, kind=kind, severity=Severity.INFO, text="")
        for n, (kind, ago_s) in enumerate(told, start=1)
    )


def test_the_verdict_answers_the_four_questions():
    """A limited link: that it is the limit, what arpd slowed, how much, and whether it helps."""
    verdict = judge(changed(**CALM)).verdict
    assert (verdict.condition, verdict.condition.severity) == (Condition.LIMITED, Severity.WARNING)
    for number in ("3.4 Mbit/s of 4 Mbit/s", "1 of 3 topics", "/camera/image", "30 → 12.5 Hz", "it helps: 12.5 ms"):
        assert number in verdict.text
    queueing = judge(changed(link={"queue_delay_s": 0.3, "loss_ratio": 0.05})).verdict
    assert all(words in queueing.text for words in ("does not help yet", "300 ms", "5 %"))


@pytest.mark.parametrize(
    ("change", "condition", "words"),
    [
        ({"link": {"state": LinkState.OUTAGE}}, Condition.OUTAGE, "than its floor"),
        ({"observation": {"counters": None}}, Condition.INTERFACE_DOWN, "wlan0 is gone"),
        ({"observation": {"counters": None}, "has_interface": False}, Condition.INTERFACE_ABSENT, "link.interface"),
        ({"observation": {"active_daemon": "robot-2"}}, Condition.STANDING_BY, "on robot-2"),
        ({"link": {"state": LinkState.DRAINING}}, Condition.OVERFULL, "12.5 ms of queue"),
        ({"link": {"queue_delay_s": math.nan, "state": LinkState.CONGESTED}}, Condition.OVERFULL, "unknown length"),
        ({"allocation": {"capacity_bytes_per_second": 1e5}}, Condition.OVERFULL, "may use 800 kbit/s of 4 Mbit/s"),
        ({"allocation": {"capacity_bytes_per_second": 1.0}}, Condition.OVERFULL, "next to nothing of 4 Mbit/s"),
        ({"allocation": {"status": AllocationStatus.DEGRADED, "degradation": "20 % left"}}, Condition.DEGRADED, "20 %"),
        # A budget that follows a link that rises has no queue to drain.
        ({"link": {"capacity_bytes_per_second": 5e6}}, Condition.LIMITED, "of 40 Mbit/s"),
        ({"observation": {"publishers": ()}}, Condition.NOTHING_TO_GOVERN, "AdaptivePublisher"),
        ({"decision": {"plan": NO_PLAN}}, Condition.MEASURING, "3 topics"),
    ],
)
def test_the_condition_that_matters_most_is_the_verdict(change, condition, words):
    """Each has a headline that does not change with numbers, and a sentence with the reason."""
    verdict = judge(changed(**change)).verdict
    assert verdict.condition is condition
    assert verdict.text.startswith(f"{condition.headline}: ")
    assert words in verdict.text


def test_faults_stand_beside_the_verdict_the_worst_first():
    """Ticks, configuration, confirmation and keys that need a restart; the first three are wrong."""
    faulty = changed(
        config_error="a.yaml:1:1: x", keys_awaiting_restart=("http.port",), events=events((EventKind.PLAN, 20.0))
    )
    faults = judge(faulty, now_s=FINISHED_AT_S + STALE_AFTER_S + 1.0).faults
    assert [fault.condition for fault in faults] == [
        Condition.STALE,
        Condition.RELOAD_REFUSED,
        Condition.UNCONFIRMED,
        Condition.RESTART_NEEDED,
    ]
    assert [fault.condition.is_wrong for fault in faults] == [True, True, True, False]
    assert "the last one finished 4 s ago" in faults[0].text
    assert all(number in faults[2].text for number in ("2 of 3 publishers", "20 s"))
    assert judge(changed(), now_s=FINISHED_AT_S + STALE_AFTER_S).faults == ()


@pytest.mark.parametrize(
    ("told", "is_fault"),
    [
        ((), False),
        (((EventKind.PLAN, 10),), False),
        (((EventKind.MEMORY, 20),), True),
        (((EventKind.PLAN, 20), (EventKind.TOPIC_FOUND, 2)), False),
        (((EventKind.OUTAGE, 20),), True),
        (((EventKind.PLAN, 30), (EventKind.CONFIRMED, 20)), False),
    ],
)
def test_a_plan_that_is_long_unconfirmed_is_a_fault(told, is_fault):
    """The decision log tells for how long; without events there is no fault."""
    conditions = {fault.condition for fault in judge(changed(events=events(*told))).faults}
    assert conditions == ({Condition.UNCONFIRMED} if is_fault else set())


def test_topics_that_the_relay_refuses_are_a_fault():
    """The sentence has each topic, and one reason."""
    refused = {"to_base": {"/scan": "two types"}, "to_robot": {"/cmd": "not let in"}}
    ways = {way: RelayTopics(refused=topics) for way, topics in refused.items()}
    (fault,) = judge(changed(observation={"relay": RelaySummary(is_reachable=True, **ways)})).faults
    assert (fault.condition, fault.condition.is_wrong) == (Condition.RELAY_REFUSES, True)
    assert "/cmd: not let in; also /scan" in fault.text


def test_the_line_for_systemd_has_the_link_the_plan_and_every_fault():
    """A daemon that stands by says only that."""
    assert "robot-2" in status_line(changed(observation={"active_daemon": "robot-2"}))
    told = status_line(changed())
    for number in ("4.0 Mbit/s", "peer", "steady", "0.5 cross", "75 %", "plan 3", "2 of 3"):
        assert number in told
    faulty = status_line(changed(observation={"counters": None}, config_error="x", keys_awaiting_restart=("a", "b")))
    assert faulty.startswith("wlan0 is gone; 4.0 Mbit/s")
    assert all(words in faulty for words in ("reload refused: x", "a and b are not in force"))


def test_the_page_calls_a_snapshot_stale_at_the_same_age():
    """The browser cannot import the threshold, so it repeats it."""
    script = (Path(arpd.web.__file__).parent / "assets" / "page.js").read_text()
    assert re.findall(r"STALE_S = ([\d.]+)", script) == [f"{STALE_AFTER_S:g}"]
