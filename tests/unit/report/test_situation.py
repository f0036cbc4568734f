"""The one judgement of a snapshot, and the line for systemd."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import pytest

import arpd.adapters.http
from arpd.model.allocation import AllocationStatus
from arpd.model.interface import InterfaceState
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
    assert verdict.text == (
        "The link is the limit: topics may use 3.4 Mbit/s of 4 Mbit/s, and the robot offers more; arpd slows 1 of 3 "
        "topics, /camera/image most (30 → 12.5 Hz); it helps: 12.5 ms of queue."
    )
    queueing = judge(changed(link={"queue_delay_s": 0.3, "loss_ratio": 0.05}))
    assert "it does not help yet: 300 ms of queue and 5 % loss." in queueing.verdict.text


def test_a_link_that_carries_all_is_fine():
    """A rate near the source's slows nobody; the rate of this tick counts, and not the ceiling of the plan."""
    camera, *others = changed().allocation.topics
    situation = judge(changed(**CALM, allocation={"topics": (replace(camera, rate_hz=29.0), *others)}))
    assert situation.verdict.text.startswith("The link is fine: 4 Mbit/s is more than the robot offers;")
    assert not situation.slowed


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


@pytest.mark.parametrize(
    "change",
    [
        {"decision": {"plan": replace(changed().decision.plan, level_bytes_per_second=2e6)}},
        {"allocation": {"capacity_bytes_per_second": 1.5e5}, "link": {"capacity_bytes_per_second": 2.5e5}},
        {"link": {"capacity_bytes_per_second": 5e6}},
    ],
)
def test_a_budget_that_follows_the_link_is_not_overfull(change):
    """A link that fell below what the plan was made for, or that rises, has no queue to drain."""
    assert judge(changed(**change)).verdict.condition is Condition.LIMITED


def test_an_interface_without_carrier_is_named():
    """The verdict names the interface and what it lacks."""
    counters = replace(changed().observation.counters, state=InterfaceState.NO_CARRIER)
    assert "wlan0 has no carrier" in judge(changed(observation={"counters": counters})).verdict.text


def test_a_daemon_that_stands_by_also_sees_its_link():
    """Standing by matters more, and the interface that is gone is a condition, too."""
    situation = judge(changed(observation={"active_daemon": "robot-2", "counters": None}))
    found = [finding.condition for finding in situation.conditions]
    assert found == [Condition.STANDING_BY, Condition.INTERFACE_DOWN]
    assert situation.first_of({Condition.INTERFACE_DOWN}) is situation.conditions[1]
    assert situation.first_of({Condition.OUTAGE}) is None


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
    assert faults[2].text == "Plan not confirmed: 2 of 3 publishers, 1 of 1 readers confirmed after 20 s."
    assert judge(changed(), now_s=FINISHED_AT_S + STALE_AFTER_S).faults == ()


@pytest.mark.parametrize(
    ("told", "is_fault"),
    [
        ((), False),
        (((EventKind.PLAN, 10),), False),
        (((EventKind.PLAN, 20),), True),
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


@pytest.mark.parametrize(
    ("relay", "condition", "words"),
    [
        (RelaySummary(), Condition.RELAY_CUT, "no end on the CEDDP is heard"),
        (RelaySummary(other_host="ceddp"), Condition.RELAY_CUT, "the CEDDP's end on ceddp is silent"),
        (RelaySummary(is_reachable=True, fault="it speaks version 2"), Condition.RELAY_CUT, "it speaks version 2"),
        (
            RelaySummary(
                is_reachable=True,
                to_ceddp=RelayTopics(refused={"/scan": "two types"}),
                to_robot=RelayTopics(refused={"/cmd": "not let in"}),
            ),
            Condition.RELAY_REFUSES,
            "/cmd: not let in; also /scan",
        ),
        (None, Condition.RELAY_SILENT, "arpd-relay"),
    ],
)
def test_a_relay_that_does_not_carry_is_a_fault(relay, condition, words):
    """A silent end, ends that do not meet, and refused topics are wrong, and the sentence has the reason."""
    situation = judge(changed(observation={"relay": relay, "is_relay_silent": relay is None}))
    assert [fault.condition for fault in situation.faults] == [condition]
    assert condition.is_wrong
    assert words in situation.faults[0].text


def test_an_outage_explains_a_silent_other_end():
    """While the link carries nothing, the other end's silence is no further fault."""
    assert not judge(changed(link={"state": LinkState.OUTAGE}, observation={"relay": RelaySummary()})).faults


def test_a_confirmed_plan_is_no_fault():
    """Once everybody confirms, the age of the plan does not matter."""
    assert judge(changed(confirmed=3, events=events((EventKind.PLAN, 100)))).faults == ()


def test_the_line_for_systemd_has_the_link_the_plan_and_every_fault():
    """A daemon that stands by says only that."""
    assert status_line(None) == "starting"
    assert status_line(changed(observation={"active_daemon": "robot-2"})).startswith("standing by: another arpd daemon")
    assert status_line(changed()) == (
        "4.0 Mbit/s (peer, steady, 0.5 cross traffic), admitted 75 %, plan 3: 2 of 3 publishers confirmed"
    )
    faulty = status_line(changed(observation={"counters": None}, config_error="x", keys_awaiting_restart=("a", "b")))
    assert faulty.startswith("wlan0 is gone; 4.0 Mbit/s")
    assert faulty.endswith(
        "; reload refused: x (the configuration in force stays); restart needed: the file's a and b are not in force"
    )


def test_the_page_calls_a_snapshot_stale_at_the_same_age():
    """The browser cannot import the threshold, so it repeats it."""
    script = (Path(arpd.adapters.http.__file__).parent / "assets" / "page.js").read_text()
    assert re.findall(r"STALE_S = ([\d.]+)", script) == [f"{STALE_AFTER_S:g}"]
