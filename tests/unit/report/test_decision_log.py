"""The decision log: what an operator reads between two snapshots of the daemon."""

from __future__ import annotations

from dataclasses import replace
from types import MappingProxyType
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from arpd.model.allocation import Allocation, AllocationStatus, Binding, TopicAllocation
from arpd.model.endpoints import RefusalReason, SwapRecord
from arpd.model.interface import InterfaceState, LinkCounters
from arpd.model.link import CapacityKind, LinkEstimate, LinkState
from arpd.model.observation import MemoryState, Observation
from arpd.model.plan import Decision, QosPlan, TopicPlan
from arpd.report.decision_log import MOST_EVENTS, DecisionLog
from arpd.report.events import EventKind, Severity
from arpd.report.snapshot import Snapshot, Totals
from tests.sample_publishers import publisher, reader

MBIT = 125_000.0
MS = 1_000_000
NO_PLAN = QosPlan(generation=0, topics={}, level_bytes_per_second=0.0)


def counters(state=InterfaceState.UP, name="wlan0"):
    return LinkCounters(interface=name, rx_bytes=0, tx_bytes=0, rx_packets=0, tx_packets=0, tx_dropped=0, state=state)


def plan_of(generation, **rows):
    """Return a plan: topic without its slash → depth, or depth and deadline (ms)."""
    topics = {}
    for topic, row in rows.items():
        depth, deadline_ms = row if isinstance(row, tuple) else (row, 0)
        topics[f"/{topic}"] = TopicPlan(rate_hz=125.0, min_rate_hz=1.0, deadline_ns=deadline_ms * MS, depth=depth)
    return QosPlan(generation=generation, topics=topics, level_bytes_per_second=17 * MBIT)


def allocated(name, rate_hz):
    """Return the program's answer for a topic that the link slows to a rate."""
    return TopicAllocation(
        name=name,
        share=0.1,
        max_rate_hz=100.0,
        rate_hz=rate_hz,
        depth=10.0,
        deadline_ns=0,
        depth_applied=10,
        binding=Binding.LINK,
        depth_binding=Binding.MAX_DEPTH,
    )


class Log:
    """Successive snapshots of a daemon; each differs from the last by the given values."""

    def __init__(self):
        self.decision_log = DecisionLog()
        self.at_s = 1000.0
        self.state = {
            "publishers": (),
            "readers": (),
            "counters": counters(),
            "peer_ages_s": {},
            "peers": None,
            "other_daemons": (),
            "active_daemon": "",
            "capacity": 20 * MBIT,
            "cross_traffic": 0.0,
            "link_state": LinkState.STEADY,
            "plan": NO_PLAN,
            "reason": "",
            "refusals": (),
            "status": AllocationStatus.OPTIMAL,
            "degradation": "",
            "confirmed": 0,
            "totals": Totals(),
            "config_error": "",
            "awaiting": (),
            "rates": {},
            "interface": "wlan0",
            "has_interface": True,
        }
        self.snapshot: Any = None

    def tick(self, after_s=0.1, **changed):
        """Show the next snapshot and return the events."""
        self.at_s += after_s
        self.state |= {"reason": "", **changed}
        s = self.state
        self.snapshot = Snapshot(
            version="1.2.3",
            interface=s["interface"],
            has_interface=s["has_interface"],
            finished_at_s=self.at_s,
            unix_time_s=1.7e9 + self.at_s,
            tick_s=0.002,
            observation=Observation(
                now_s=self.at_s,
                counters=s["counters"],
                reports=(),
                publishers=s["publishers"],
                readers=s["readers"],
                memory=MemoryState(total_bytes=2**30, available_bytes=2**29),
                sensing_topics=0,
                actuation_topics=0,
                peers=s["peers"],
                peer_ages_s=MappingProxyType(s["peer_ages_s"]),
                other_daemons=s["other_daemons"],
                active_daemon=s["active_daemon"],
            ),
            link=LinkEstimate(
                capacity_bytes_per_second=s["capacity"],
                kind=CapacityKind.PEER,
                state=s["link_state"],
                queue_delay_s=0.0,
                delivery_rate_bytes_per_second=0.0,
                age_s=0.0,
                evidence="",
                cross_traffic_bytes_per_second=s["cross_traffic"],
            ),
            allocation=Allocation(
                topics=tuple(allocated(f"/{topic}", rate_hz) for topic, rate_hz in s["rates"].items()),
                status=s["status"],
                binding=Binding.LINK,
                capacity_bytes_per_second=s["capacity"],
                degradation=s["degradation"],
            ),
            decision=Decision(
                gate=1.0,
                plan=s["plan"],
                level_changed=bool(s["reason"]),
                reason=s["reason"],
                refusals=s["refusals"],
            ),
            totals=s["totals"],
            config_path="/etc/arpd/arpd.yaml",
            config_error=s["config_error"],
            keys_awaiting_restart=s["awaiting"],
            confirmed=s["confirmed"],
        )
        return self.decision_log.follow(self.snapshot)

    def wait(self, seconds, **changed):
        """Let time pass tick by tick and return all events."""
        told = [*self.tick(**changed)]
        for _ in range(round(seconds * 10)):
            told += self.tick()
        return told


@pytest.fixture
def log():
    """Return the log of a robot whose four topics were found, without a plan."""
    log = Log()
    robot = (
        publisher("/camera", "/camera", source_rate_hz=30.0, payload_bytes=50_000.0),
        publisher("/lidar", "/front", payload_bytes=9_000.0),
        publisher("/lidar", "/rear", payload_bytes=9_000.0),
        publisher("/imu", "/imu", source_rate_hz=100.0, payload_bytes=300.0),
    )
    log.wait(3.0, publishers=robot)
    return log


FIRST = plan_of(1, camera=(29, 43), front=(19, 63), rear=(19, 63), imu=(10, 16))
SLOW = plan_of(2, camera=(4, 600), front=(12, 100), rear=(12, 100), imu=(10, 16))


def first(log):
    return log.tick(plan=FIRST, reason="start", capacity=20 * MBIT)


def texts(events):
    return [event.text for event in events]


# -- plans


def test_the_first_picture_is_the_start_and_topics_that_come_together_are_one_event():
    """Two events: arpd runs, and twelve topics were found, three of them by name."""
    log = Log()
    publishers = tuple(publisher("/n", f"/topic_{n:02d}") for n in range(12))
    told = log.tick()
    for n in range(12):
        told += log.tick(after_s=0.5, publishers=publishers[: n + 1])
    told += tuple(log.wait(5.0))
    assert texts(told) == [
        "arpd 1.2.3 governs wlan0",
        "12 topics found: /topic_00, /topic_01, /topic_02 and 9 more",
    ]
    assert [event.number for event in told] == [1, 2]


def test_a_fall_says_what_the_link_carries_and_what_the_plan_changes(log):
    """Depths and deadlines, equal changes together; no rate, because rates follow without a plan."""
    first(log)
    (fell,) = log.tick(plan=SLOW, reason="down", capacity=0.6e6)
    assert fell.text == (
        "link fell to 4.8 Mbit/s: depth /camera 29 → 4 samples, /front and /rear 19 → 12 samples; "
        "deadline /camera 43 ms → 600 ms, /front and /rear 63 ms → 100 ms; 1 topic unchanged"
    )
    assert (fell.kind, fell.severity) == (EventKind.PLAN, Severity.WARNING)
    assert fell.details["cause"] == "down"
    assert fell.details["generation"] == "2"
    assert fell.details["capacity_bytes_per_second"] == "600000"
    assert fell.details["topics_changed"] == "3"


def test_a_rise_is_good_news(log):
    """The same the other way round."""
    first(log)
    log.tick(plan=SLOW, reason="down", capacity=0.6e6)
    (rose,) = log.tick(plan=replace(FIRST, generation=3), reason="up", capacity=2.5e6)
    assert rose.text.startswith("link rose to 20 Mbit/s: depth /camera 4 → 29 samples")
    assert rose.severity is Severity.INFO


def test_a_link_that_swings_gets_a_plan_for_what_lasts(log):
    """A plan down at a moment when the link is fast says what the topics can count on."""
    first(log)
    plan = replace(SLOW, level_bytes_per_second=4 * MBIT)
    (fell,) = log.tick(plan=plan, reason="down", capacity=22 * MBIT)
    assert fell.text.startswith(
        "topics can count on only 4 Mbit/s, though the link carries 22 Mbit/s now: depth /camera"
    )
    (rose,) = log.tick(plan=replace(FIRST, generation=3), reason="up", capacity=19 * MBIT)
    assert rose.text.startswith("topics can count on 17 Mbit/s, though the link carries 19 Mbit/s now: depth /camera")


def test_other_traffic_is_named_where_it_and_not_the_link_took_the_rate(log):
    """The link carries what it did; a download takes a third of it."""
    first(log)
    (taken,) = log.tick(plan=SLOW, reason="down", cross_traffic=7 * MBIT)
    assert taken.text.startswith("cross traffic takes 7 Mbit/s, leaving 13 Mbit/s of 20 Mbit/s: depth /camera 29 → 4")
    (left,) = log.tick(plan=replace(FIRST, generation=3), reason="up", cross_traffic=MBIT)
    assert left.text.startswith(
        "cross traffic takes only 1 Mbit/s, leaving 19 Mbit/s of 20 Mbit/s: depth /camera 4 → 29"
    )
    log.tick(plan=replace(SLOW, generation=4), reason="down", cross_traffic=7 * MBIT)
    (gone,) = log.tick(plan=replace(FIRST, generation=5), reason="up", cross_traffic=0.0)
    assert gone.text.startswith("cross traffic is gone, the link's 20 Mbit/s are free: depth /camera 4 → 29 samples")


@pytest.mark.parametrize(
    ("reason", "words"),
    [
        ("start", "first plan for 4 topics on a link of 20 Mbit/s: "),
        ("budget", "swaps are allowed again: "),
        ("demand", "what the sources publish has changed: "),
        ("reload", "new configuration: "),
        ("readers", "a reader asks for a shorter deadline: "),
        ("takeover", "another daemon's plan was found, this one replaces it: "),
        ("something new", "plan 1: "),
    ],
)
def test_every_cause_has_its_own_words(log, reason, words):
    """Each new plan is one event that says why."""
    (new,) = log.tick(plan=plan_of(1, camera=20, front=10, rear=10, imu=10), reason=reason)
    assert new.text == f"{words}depth /camera 10 → 20 samples; 3 topics unchanged"


def test_topics_that_join_and_leave_a_plan_are_counted(log):
    """A plan for other topics says how many came and went."""
    first(log)
    (new,) = log.tick(plan=plan_of(2, camera=(29, 43), front=(19, 63), tail=5, nose=4), reason="topics")
    assert new.text == "2 topics joined and 2 topics left, 4 planned: no depth or deadline changes"


def test_memory_moves_depths(log):
    """Depths that shrink are told with the topics they shrink for."""
    first(log)
    (less,) = log.tick(plan=plan_of(2, camera=4, front=19, rear=19, imu=10), reason="memory")
    assert (less.kind, less.severity) == (EventKind.MEMORY, Severity.WARNING)
    assert less.text == "memory allows less: /camera 29 → 4 samples"
    (more,) = log.tick(plan=plan_of(3, camera=40, front=19, rear=19, imu=10), reason="memory")
    assert more.text == "memory allows more: /camera 4 → 40 samples"


def test_a_plan_is_confirmed_once_and_only_when_everybody_runs_it(log):
    """Four seconds after it was made; a plan that another one overtook is never confirmed."""
    first(log)
    assert not log.wait(1.0, confirmed=3)
    assert log.tick(plan=SLOW, reason="down")
    assert not log.wait(3.8, confirmed=3)
    told = log.wait(5.0, confirmed=4)
    assert texts(told) == ["every publisher runs plan 2, 4 s after it was made"]
    assert told[0].kind is EventKind.CONFIRMED


def test_a_plan_waits_for_its_readers_too(log):
    """Publishers alone do not make a plan confirmed."""
    first(log)
    waiting = replace(log.snapshot, confirmed=4, reader_plans={("/r", "/camera"): None}, readers_confirmed=0)
    assert log.decision_log.follow(waiting) == ()
    (done,) = log.decision_log.follow(replace(waiting, readers_confirmed=1))
    assert done.kind is EventKind.CONFIRMED


def test_a_plan_that_has_to_wait_is_told_once(log):
    """After two seconds, with the reason; not again while the same plan is in force."""
    first(log)
    assert not log.wait(1.0, refusals=("dwell",))
    told = log.wait(10.0) + log.wait(3.0, refusals=()) + log.wait(5.0, refusals=("dwell",))
    assert [event.kind for event in told] == [EventKind.PLAN_REFUSED]
    assert told[0].text.startswith("a new plan has to wait: the last one is only 2.")
    assert told[0].details["reason"] == "dwell"


def test_swaps_over_the_budget_are_told_at_once(log):
    """The plan is made without them, so nothing waits but they."""
    told = log.tick(plan=FIRST, reason="start", refusals=("budget",))
    assert texts(told[1:]) == [
        "topics keep depth and deadline for now: swaps have used up their part of the link (budget)"
    ]
    assert told[1].kind is EventKind.PLAN_REFUSED
    assert not log.wait(3.0, refusals=())


def test_what_does_not_fit_is_told_when_it_lasts(log):
    """With what arpd gives up; while a queue drains it is no event, nor is anything during an outage."""
    lacking = {"status": AllocationStatus.DEGRADED, "degradation": "rate reserve 40 % left"}
    assert not log.wait(5.0, **lacking)
    assert not log.wait(1.0, status=AllocationStatus.OPTIMAL)
    told = log.wait(11.0, **lacking)
    assert texts(told) == ["not everything asked for fits: rate reserve 40 % left"]
    log.tick(link_state=LinkState.OUTAGE)
    assert not log.wait(5.0, status=AllocationStatus.OPTIMAL)
    log.tick(link_state=LinkState.STEADY)
    assert [event.kind for event in log.wait(11.0)] == [EventKind.FEASIBLE]


# -- rates

FULL = {"camera": 30.0, "front": 20.0, "rear": 20.0, "imu": 100.0}
FELL = {**FULL, "camera": 2.1, "front": 12.0, "rear": 12.0}


def test_rates_that_the_link_takes_for_long_are_told_both_ways(log):
    """From the source's rate to what is left, after ten seconds, and back."""
    first(log)
    log.wait(12.0, rates=FULL)
    assert not log.wait(8.0, rates=FELL)
    (slowed,) = log.wait(4.0)
    assert slowed.text == "the link slows 3 topics: /camera 30 → 2.1 Hz, /front and /rear 20 → 12 Hz"
    assert (slowed.kind, slowed.severity) == (EventKind.RATES, Severity.WARNING)
    assert not log.wait(30.0)
    (free,) = log.wait(12.0, rates=FULL)
    assert free.text == "the link slows no topic any longer: /camera 2.1 → 30 Hz, /front and /rear 12 → 20 Hz"
    assert free.severity is Severity.INFO


def test_rates_that_move_a_little_or_to_and_fro_are_no_news(log):
    """A third less is none; half of it is, once it has lasted; and a link that swings stays what it was."""
    first(log)
    assert len(log.wait(12.0, rates=FELL)) == 1
    assert not log.wait(20.0, rates={**FELL, "camera": 1.5})
    for _ in range(5):
        assert not log.wait(4.0, rates=FULL)
        assert not log.wait(4.0, rates={**FELL, "camera": 1.0})
    (slower,) = log.wait(20.0, rates={**FELL, "camera": 1.0})
    assert slower.text == "the link slows 3 topics: /camera 2.1 → 1 Hz"


@pytest.mark.parametrize("change", [{"link_state": LinkState.OUTAGE}, {"active_daemon": "robot-2", "plan": NO_PLAN}])
def test_rates_are_no_event_of_an_outage_nor_of_a_daemon_that_stands_by(log, change):
    """The one has an event of its own, and the other sends no price."""
    first(log)
    told = log.wait(20.0, rates=dict.fromkeys(FULL, 0.0), **change)
    assert EventKind.RATES not in {event.kind for event in told}


# -- the link


def test_an_outage_says_since_when_and_the_recovery_how_long(log):
    """What the link carries again is the estimate it resumes at."""
    (out,) = log.tick(link_state=LinkState.OUTAGE, peer_ages_s={})
    assert (out.text, out.severity) == ("the link carries nothing: no topic sends more than its floor", Severity.ERROR)
    assert not log.wait(10.0)
    (back,) = log.tick(link_state=LinkState.STEADY, capacity=12 * MBIT, peer_ages_s={"ceddp": 0.0})[:1]
    assert back.text == "the link carries again after 10.2 s, at 12 Mbit/s"
    assert back.details["outage_seconds"] == "10.200"


def test_an_outage_counts_from_the_last_report(log):
    """The youngest report of any peer is the last sign of life."""
    log.tick(peer_ages_s={"ceddp": 0.1, "edge": 3.0})
    (out,) = log.tick(link_state=LinkState.OUTAGE, peer_ages_s={"ceddp": 0.5, "edge": 3.4})
    assert out.text == "the link carries nothing since 500 ms ago: no topic sends more than its floor"
    (back,) = log.tick(after_s=9.7, link_state=LinkState.STEADY, peer_ages_s={"ceddp": 0.0})
    assert back.text == "the link carries again after 10.2 s, at 20 Mbit/s"


def test_a_peer_that_is_given_up_is_no_recovery(log):
    """While nobody reports, the log does not say that the link carries."""
    log.tick(peer_ages_s={"ceddp": 0.1})
    log.tick(link_state=LinkState.OUTAGE, peer_ages_s={"ceddp": 0.5})
    (over,) = log.tick(after_s=9.5, link_state=LinkState.APP_LIMITED, peer_ages_s={"ceddp": 10.0})
    assert over.text == "no longer an outage after 10 s: other hosts answer, only the peer is silent"


def test_a_radio_that_goes_out_every_second_writes_few_lines(log):
    """Three outages are single events, the others of the minute a number, and the last event is true."""
    told = []
    for _ in range(130):
        told += log.wait(0.4, link_state=LinkState.OUTAGE)
        told += log.wait(0.4, link_state=LinkState.STEADY)
    times_s = [event.unix_time_s for event in told]
    assert max(sum(at_s <= other_s < at_s + 60.0 for other_s in times_s) for at_s in times_s) <= 8
    assert sum("more outages in the last minute" in event.text for event in told) == 2
    told += log.wait(120.0)
    assert told[-1].kind is EventKind.RECOVERED


def test_peers_come_and_go(log):
    """A peer is lost after ten silent seconds; while the link is out nobody is."""
    (found,) = log.tick(peer_ages_s={"ceddp": 0.1})
    assert found.text == "peer ceddp is found"
    told = log.wait(20.0, link_state=LinkState.OUTAGE, peer_ages_s={"ceddp": 11.0})
    assert [event.kind for event in told] == [EventKind.OUTAGE]
    told = log.wait(5.0, link_state=LinkState.STEADY, peer_ages_s={})
    told += log.wait(10.0)
    assert [event.kind for event in told] == [EventKind.RECOVERED, EventKind.PEER_LOST]
    assert (told[-1].text, told[-1].severity) == (
        "peer ceddp is lost, silent for 10 s: nobody reports what the link delivers",
        Severity.WARNING,
    )


def test_the_interface_is_told_when_it_changes(log):
    """It loses its carrier, is up again, is renamed, is gone."""
    told = [
        *log.tick(counters=counters(InterfaceState.NO_CARRIER)),
        *log.tick(counters=counters()),
        *log.tick(counters=counters(name="wlan1"), interface="wlan1"),
        *log.tick(counters=None),
    ]
    assert texts(told) == [
        "wlan0 has no carrier",
        "wlan0 is up",
        "the link interface wlan0 is now called wlan1",
        "wlan1 is gone",
    ]
    assert {event.kind for event in told} == {EventKind.INTERFACE}


def test_an_interface_that_was_never_there_is_not_gone():
    """A radio that has yet to come is a warning, and then it is up."""
    log = Log()
    (missing,) = log.tick(counters=None, has_interface=False)[1:]
    assert (missing.text, missing.severity) == ("wlan0 is not there yet", Severity.WARNING)
    assert texts(log.tick(counters=counters(), has_interface=True)) == ["wlan0 is up"]


# -- publishers and readers


def swapped(number, result="ok", **phases):
    return SwapRecord(
        number=number, result=result, depth=10, deadline_ns=125 * MS, seconds_by_phase=phases or {"matching": 3.0}
    )


def with_swap(log, topic, record, **more):
    return tuple(
        replace(state, last_swap=record, **more) if state.topic == topic else state for state in log.state["publishers"]
    )


def test_a_swap_says_what_it_came_to_and_where_its_time_went(log):
    """Depth, deadline and the phases that took time; the old writer drains beside the new one and does not count."""
    record = swapped(1, matching=3.1, watching=0.0, proving=0.3, draining=2.0)
    told = log.wait(3.0, publishers=with_swap(log, "/camera", record))
    assert texts(told) == ["/camera swapped to depth 10, deadline 125 ms in 3.4 s (matching 3.1, proving 0.3)"]
    assert (told[0].topic, told[0].node, told[0].kind) == ("/camera", "/camera", EventKind.WRITER_REPLACED)
    assert told[0].details["matching_seconds"] == "3.100"
    assert not log.wait(3.0)


def test_many_swaps_are_one_event(log):
    """Those of a plan come within seconds of each other."""
    publishers = tuple(replace(state, last_swap=swapped(1, matching=3.0)) for state in log.state["publishers"])
    told = [*log.tick(publishers=publishers[:2] + log.state["publishers"][2:]), *log.wait(3.0, publishers=publishers)]
    assert texts(told) == ["4 publishers swapped in 3 s: /camera, /front, /imu and 1 more"]


def test_a_swap_that_failed_says_why_and_is_no_refusal_as_well(log):
    """One event for one failure, in the publisher's own words."""
    publishers = with_swap(
        log,
        "/camera",
        swapped(1, "unmatched"),
        refusal="/rviz did not match the new writer in 10 s",
        refusal_reason=RefusalReason.UNMATCHED,
    )
    told = log.wait(3.0, publishers=publishers)
    assert texts(told) == [
        "/camera kept its writer, not swapped to depth 10, deadline 125 ms: /rviz did not match the new writer in 10 s"
    ]
    assert (told[0].kind, told[0].severity) == (EventKind.WRITER_KEPT, Severity.WARNING)


def test_swaps_from_before_the_start_are_history():
    """A restarted daemon does not repeat the events of the one before."""
    log = Log()
    told = log.wait(3.0, publishers=(publisher("/n", "/a", last_swap=swapped(7)),))
    assert [event.kind for event in told] == [EventKind.STARTED, EventKind.TOPIC_FOUND]
    told = log.wait(3.0, publishers=(publisher("/n", "/a", last_swap=swapped(8)),))
    assert [event.kind for event in told] == [EventKind.WRITER_REPLACED]


def test_a_refusal_is_told_once_however_often_it_is_announced(log):
    """It comes and goes with every plan, and its words change; a reader's refusal is the same."""
    refusing = replace(
        log.state["publishers"][1],
        refusal="/front is TRANSIENT_LOCAL",
        refusal_reason=RefusalReason.TRANSIENT_LOCAL,
    )
    others = log.state["publishers"][:1]
    told = []
    for n in range(10):
        said = replace(refusing, refusal=f"/front is TRANSIENT_LOCAL ({n})")
        told += log.wait(2.0, publishers=(*others, said))
        told += log.wait(0.5, publishers=(*others, replace(said, refusal="", refusal_reason=RefusalReason.NONE)))
    refused = [event for event in told if event.kind is EventKind.REFUSED]
    assert texts(refused) == ["/front refuses: /front is TRANSIENT_LOCAL (0)"]
    assert (refused[0].topic, refused[0].node) == ("/front", "/lidar")
    asking = reader("/rviz", "/camera", refusal="depth 4: no", refusal_reason=RefusalReason.UNMATCHED)
    assert texts(log.wait(3.0, readers=(asking,))) == ["/camera refuses: depth 4: no"]


def test_a_middleware_that_refuses_everywhere_is_one_event(log):
    """Four publishers with one reason are one line."""
    publishers = tuple(
        replace(state, refusal="no swaps on this middleware", refusal_reason=RefusalReason.MIDDLEWARE)
        for state in log.state["publishers"]
    )
    assert texts(log.wait(3.0, publishers=publishers)) == [
        "/camera, /front, /imu and 1 more refuse: no swaps on this middleware"
    ]


def test_topics_that_are_lost_are_told_after_a_while(log):
    """A restart of a node within two seconds is no loss; a longer one is, and the return is told too."""
    robot = log.state["publishers"]
    assert not log.wait(1.0, publishers=robot[:2])
    assert not log.wait(5.0, publishers=robot)
    told = log.wait(5.0, publishers=robot[:3]) + log.wait(5.0, publishers=robot)
    assert texts(told) == ["/imu lost: /imu no longer announces it", "/imu found: /imu publishes it"]
    assert (told[0].topic, told[0].node) == ("/imu", "/imu")


def test_a_topic_that_comes_as_another_is_lost_is_told(log):
    """The loss of one topic leaves the node of another that was found meanwhile."""
    robot = log.state["publishers"]
    told = log.wait(1.0, publishers=robot[:3]) + log.wait(5.0, publishers=(*robot[:3], publisher("/n", "/map")))
    assert texts(told) == ["/imu lost: /imu no longer announces it", "/map found: /n publishes it"]


# -- configuration and other daemons


def test_reloads_are_told_both_ways(log):
    """What changed is counted; a refusal names the place of the first fault."""
    before = log.state["totals"]
    (bad,) = log.tick(
        totals=replace(before, reloads_by_result={"failed": 1}), config_error="/etc/arpd/arpd.yaml:2:3: link.headrom"
    )
    assert bad.text == "reload refused: /etc/arpd/arpd.yaml:2:3: link.headrom (the configuration in force stays)"
    assert (bad.kind, bad.severity) == (EventKind.RELOAD_FAILED, Severity.ERROR)
    (good,) = log.tick(
        totals=replace(
            before,
            reloads_by_result={"failed": 1, "ok": 1},
            changed_keys_by_effect={"in_force": 3, "awaiting_restart": 1},
        ),
        awaiting=("http.port",),
        config_error="",
    )
    assert good.text == "reloaded: 3 keys changed; 1 key of the file after a restart only"
    assert not log.tick()
    (same,) = log.tick(totals=replace(log.state["totals"], reloads_by_result={"failed": 1, "ok": 2}), awaiting=())
    assert same.text == "reloaded: nothing changed"


def test_a_reload_before_the_first_tick_is_told():
    """A file that was refused while arpd started is an event."""
    told = Log().tick(totals=Totals(reloads_by_result={"failed": 1}), config_error="arpd.yaml:1:1: no")
    assert [event.kind for event in told] == [EventKind.STARTED, EventKind.RELOAD_FAILED]


def test_another_daemon_is_told_of(log):
    """It drives, stands by, or is gone: three events."""
    told = [
        *log.tick(active_daemon="robot-2", other_daemons=("robot-2",)),
        *log.tick(active_daemon="", other_daemons=("robot-2",)),
        *log.tick(other_daemons=()),
    ]
    assert texts(told) == [
        "standing by: another arpd daemon, on robot-2, has run for longer and drives this robot",
        "in charge; another arpd daemon stands by, on robot-2",
        "in charge; no other arpd daemon is left",
    ]
    assert [event.kind for event in told] == [EventKind.STANDING_BY, EventKind.IN_CHARGE, EventKind.IN_CHARGE]


# -- the log itself


def test_the_same_picture_twice_is_no_event(log):
    """Neither the same object nor an equal one is an event."""
    first(log)
    assert log.decision_log.follow(log.snapshot) == ()
    assert log.decision_log.follow(replace(log.snapshot)) == ()


def test_counts_have_every_kind_and_the_last_events_are_kept(log):
    """A kind that never happened counts 0; of many events the last two hundred stay, the oldest first."""
    assert set(log.decision_log.counts_by_kind) == {str(kind) for kind in EventKind}
    assert log.decision_log.counts_by_kind["outage"] == 0
    for number in range(300):
        log.tick(after_s=10.0, plan=plan_of(number + 1, camera=1 + number % 2), reason="up")
    assert log.decision_log.counts_by_kind["plan"] == 300
    assert len(log.decision_log.events) == MOST_EVENTS
    numbers = [event.number for event in log.decision_log.events]
    assert numbers == sorted(numbers)


_NAMES = st.text(max_size=300)
_STEP = st.fixed_dictionaries(
    {"after_s": st.floats(0.05, 2.0)},
    optional={
        "link_state": st.sampled_from([LinkState.STEADY, LinkState.OUTAGE]),
        "capacity": st.floats(0.0, 1e9),
        "cross_traffic": st.floats(0.0, 1e9),
        "counters": st.sampled_from([None, counters(), counters(InterfaceState.DOWN)]),
        "interface": st.sampled_from(["wlan0", "wlan1"]),
        "peer_ages_s": st.dictionaries(_NAMES, st.floats(0.0, 60.0), max_size=3),
        "peers": st.sampled_from([None, 0, 2]),
        "active_daemon": st.sampled_from(["", "a", "b\n"]),
        "refusals": st.sampled_from([(), ("dwell",), ("budget",)]),
        "rates": st.dictionaries(st.sampled_from(["a", "b", "c", "d" * 250]), st.floats(0.0, 1e4)),
        "status": st.sampled_from(list(AllocationStatus)),
        "degradation": _NAMES,
        "config_error": _NAMES,
        "confirmed": st.integers(0, 5),
        "totals": st.builds(
            Totals, reloads_by_result=st.dictionaries(st.sampled_from(["ok", "failed"]), st.integers(0, 9))
        ),
        "plan": st.builds(
            lambda generation, rows: plan_of(generation, **rows),
            st.integers(0, 9),
            st.dictionaries(
                st.sampled_from(["a", "b", "c", "d" * 250]),
                st.tuples(st.integers(1, 5000), st.integers(0, 10**6)),
            ),
        ),
        "reason": st.sampled_from(["", "start", "down", "up", "memory", "topics", "takeover"]),
        "publishers": st.lists(
            st.builds(
                publisher,
                st.sampled_from(["/n", "/m"]),
                st.sampled_from(["/a", "/b", "/c", "/" + "d" * 250]),
                source_rate_hz=st.floats(0.0, 1e4),
                rate_hz=st.floats(0.0, 1e4) | st.just(float("inf")),
                refusal=_NAMES,
                refusal_reason=st.sampled_from(list(RefusalReason)),
                last_swap=st.none()
                | st.builds(
                    SwapRecord,
                    number=st.integers(1, 9),
                    result=st.sampled_from(["ok", "reorder_possible", "unmatched", "superseded", "what"]),
                    depth=st.integers(1, 5000),
                    deadline_ns=st.integers(0, 10**10),
                    seconds_by_phase=st.dictionaries(st.sampled_from(["matching", "proving"]), st.floats(0.0, 99.0)),
                ),
            ),
            max_size=8,
        ).map(tuple),
    },
)
_MOST_IN_A_MINUTE = 13 * len(EventKind)


@settings(max_examples=60, deadline=None)
@given(st.lists(_STEP, min_size=1, max_size=60))
def test_whatever_happens_the_log_stays_readable_and_bounded(steps):
    """Any sequence of snapshots: printable lines of 600 characters at most, numbers in order, no flood."""
    log, told = Log(), []
    for step in steps:
        told += [(log.at_s, event) for event in log.tick(**step)]
        assert log.decision_log.follow(log.snapshot) == ()
    assert [event.number for _, event in told] == list(range(1, len(told) + 1))
    for _, event in told:
        assert event.text.isprintable()
        assert 0 < len(event.text) <= 600
        assert all(name == name.lower() and text.isprintable() for name, text in event.details.items())
        assert all(len(text) <= 200 for text in event.details.values())
    assert sum(log.decision_log.counts_by_kind.values()) == len(told)
    for at_s, _ in told:
        assert sum(at_s <= other_s < at_s + 60.0 for other_s, _ in told) <= _MOST_IN_A_MINUTE


def test_a_flood_of_one_kind_is_told_as_a_number(log):
    """Ten new plans a second are twelve lines in a minute, and one that counts the rest."""
    told = []
    for number in range(700):
        told += log.tick(plan=plan_of(number + 1, camera=1 + number % 2), reason="up")
    assert len(told) <= 26
    counted = [event for event in told if "more events of the kind plan in the last minute" in event.text]
    assert [event.details["untold"] for event in counted] == [counted[0].text.split()[0]]
    assert 590 < int(counted[0].details["untold"]) < 610
