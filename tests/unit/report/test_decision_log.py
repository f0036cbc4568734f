"""The decision log: what an operator reads between two snapshots of the daemon."""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from arpd.model.allocation import AllocationStatus, Binding
from arpd.model.endpoints import RefusalReason, SwapRecord
from arpd.model.interface import InterfaceState
from arpd.model.link import LinkState
from arpd.model.plan import QosPlan, TopicPlan
from arpd.report.conditions import MESSAGE_IDS, Condition, Happening, Severity
from arpd.report.decision_log import MOST_EVENTS, DecisionLog
from arpd.report.snapshot import Totals
from tests.examples import examples
from tests.golden.sample import changed as sample
from tests.sample_publishers import publisher

MBIT = 125_000.0
MS = 1_000_000
COUNTERS = sample().observation.counters
NO_PLAN = QosPlan(generation=0, topics={}, level_bytes_per_second=0.0)


def plan_of(generation, **rows):
    """Return a plan: topic without its slash → depth, or depth and deadline (ms)."""
    topics = {}
    for topic, row in rows.items():
        depth, deadline_ms = row if isinstance(row, tuple) else (row, 0)
        topics[f"/{topic}"] = TopicPlan(rate_hz=125.0, min_rate_hz=1.0, deadline_ns=deadline_ms * MS, depth=depth)
    return QosPlan(generation=generation, topics=topics, level_bytes_per_second=17 * MBIT)


def slowed(**rates_hz):
    """Return the program's answer for topics that the link slows to these rates."""
    (camera,) = [each for each in sample().allocation.topics if each.binding is Binding.LINK]
    return tuple(replace(camera, name=f"/{topic}", rate_hz=rate_hz) for topic, rate_hz in rates_hz.items())


CALM = {
    "observation": {
        "publishers": (),
        "counters": COUNTERS,
        "peer_ages_s": {"base": 0.1},
        "peers": None,
        "other_daemons": (),
        "active_daemon": "",
    },
    "link": {"state": LinkState.STEADY, "capacity_bytes_per_second": 20 * MBIT, "cross_traffic_bytes_per_second": 0.0},
    "allocation": {"topics": (), "status": AllocationStatus.OPTIMAL, "degradation": ""},
    "decision": {"plan": NO_PLAN, "reason": "", "is_postponed": False},
}


class Log:
    """Successive snapshots of a daemon; each differs from the last by the given values."""

    def __init__(self):
        self.decision_log = DecisionLog()
        self.at_s = 1000.0
        self.parts = {part: {**values} for part, values in CALM.items()}
        self.others = {"totals": Totals(), "confirmed": 0}
        self.snapshot = None

    def tick(self, after_s=0.1, **changed):
        """Show the next snapshot and return the events; a change names a field of whatever part has it."""
        self.at_s += after_s
        for name, value in {"reason": "", **changed}.items():
            part = next((part for part in self.parts.values() if name in part), self.others)
            part[name] = value
        at = {"finished_at_s": self.at_s, "unix_time_s": 1.7e9 + self.at_s}
        found = () if self.snapshot is None else self.snapshot.found
        self.snapshot = sample(**self.parts, **self.others, **at, found=found)
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
    return log.tick(plan=FIRST, reason="start", capacity_bytes_per_second=20 * MBIT)


def kinds(events):
    return [event.kind for event in events]


# -- plans


def test_a_fall_says_what_the_link_carries_and_what_the_plan_changes(log):
    """Depths and deadlines, equal changes together; no rate, because rates follow without a plan."""
    first(log)
    (fell,) = log.tick(plan=SLOW, reason="down", capacity_bytes_per_second=0.6e6)
    assert (fell.kind, fell.severity) == (Happening.PLAN, Severity.WARNING)
    for number in ("4.8 Mbit/s", "/camera 29 → 4", "/front and /rear 19 → 12", "43 ms → 600 ms", "1 topic unchanged"):
        assert number in fell.text
    assert {"cause": "down", "generation": "2", "topics_changed": "3"}.items() <= fell.details.items()
    assert fell.details["capacity_bytes_per_second"] == "600000"
    (rose,) = log.tick(plan=replace(FIRST, generation=3), reason="up", capacity_bytes_per_second=2.5e6)
    assert (rose.severity, "20 Mbit/s" in rose.text) == (Severity.INFO, True)


def test_every_cause_has_its_own_words(log):
    """Each new plan is one event that says why."""
    told = set()
    for number, reason in enumerate(("start", "budget", "demand", "reload", "readers", "takeover", "memory", "new"), 1):
        (new,) = log.tick(plan=plan_of(number, camera=20 + number, front=10, rear=10, imu=10), reason=reason)
        assert new.kind is Happening.PLAN
        assert f"{20 + number} samples" in new.text
        told.add(new.text.partition(":")[0])
    assert len(told) == 8


def test_a_topic_that_is_given_back_is_told_with_what_its_application_chose(log):
    """Its row has no numbers of its own; the next plan, which has no row for it, does not say that it left again."""
    first(log)
    rows = {**FIRST.topics, "/imu": replace(FIRST.topics["/imu"], depth=0, deadline_ns=0)}
    back = replace(FIRST, generation=2, topics=rows)
    (told,) = log.tick(plan=back, reason="topics")
    assert told.text.startswith("/imu given back, 3 planned: deadline /imu 16 ms → none; 3 topics")
    rest = {name: row for name, row in rows.items() if name not in {"/imu", "/rear"}}
    (told,) = log.tick(plan=replace(back, generation=3, topics=rest), reason="topics")
    assert told.text.startswith("/rear left, 2 planned")


# -- conditions


def test_what_does_not_fit_is_told_when_it_lasts(log):
    """With what arpd gives up; while a queue drains it is no event, and an outage does not end it."""
    first(log)
    log.tick(confirmed=4)
    lacking = {"status": AllocationStatus.DEGRADED, "degradation": "rate reserve 40 % left"}
    assert not log.wait(5.0, **lacking)
    assert not log.wait(1.0, status=AllocationStatus.OPTIMAL)
    (told,) = log.wait(11.0, **lacking)
    assert (told.kind, told.details["state"], "40 %" in told.text) == (Condition.MINIMUM_RATES, "began", True)
    assert kinds(log.wait(5.0, state=LinkState.OUTAGE)) == [Condition.OUTAGE]
    assert kinds(log.wait(5.0, state=LinkState.STEADY)) == [Condition.OUTAGE]
    (fits,) = log.tick(status=AllocationStatus.OPTIMAL)
    assert (fits.kind, fits.severity, fits.details["state"]) == (Condition.MINIMUM_RATES, Severity.INFO, "ended")


def test_an_interface_that_goes_ends_no_outage(log):
    """What was silent before cannot be known to carry again."""
    assert kinds(log.tick(state=LinkState.OUTAGE)) == [Condition.OUTAGE]
    assert kinds(log.tick(counters=replace(COUNTERS, state=InterfaceState.DOWN))) == [Condition.INTERFACE_DOWN]
    assert kinds(log.tick(counters=COUNTERS, state=LinkState.STEADY)) == [Condition.OUTAGE, Condition.INTERFACE_DOWN]


# -- rates

FULL = slowed(camera=30.0, front=20.0, rear=20.0, imu=100.0)
FELL = slowed(camera=2.1, front=12.0, rear=12.0, imu=100.0)
ROSE = slowed(camera=10.0, front=18.5, rear=20.0, imu=100.0)


def test_rates_that_the_link_takes_for_long_are_told_both_ways(log):
    """From the source's rate to what is left, after ten seconds, and back."""
    first(log)
    log.wait(12.0, topics=FULL, confirmed=4)
    assert not log.wait(8.0, topics=FELL)
    (slowed,) = log.wait(4.0)
    assert (slowed.kind, slowed.severity) == (Happening.RATES, Severity.WARNING)
    assert all(number in slowed.text for number in ("3 topics", "/camera 30 → 2.1 Hz", "/front and /rear 20 → 12 Hz"))
    assert not log.wait(30.0)
    (rose,) = log.wait(12.0, topics=ROSE)
    assert rose.severity is Severity.INFO
    assert rose.text.startswith("the link lets 3 topics send more: /camera 2.1 → 10 Hz")
    (free,) = log.wait(12.0, topics=FULL)
    assert (free.severity, "/camera 10 → 30 Hz" in free.text) == (Severity.INFO, True)
    other = publisher("/camera2", "/camera", source_rate_hz=12.0)
    log.tick(publishers=(*log.snapshot.observation.publishers, other))
    (slowed,) = log.wait(12.0, topics=FELL)
    assert "/camera 30 → 2.1 Hz" in slowed.text  # of several publishers the one that is slowed most


def test_a_rate_that_the_configuration_caps_is_told_against_the_cap(log):
    """What `max_rate_hz` keeps back is not the link's doing, and the link gives back no more than that."""
    first(log)
    log.wait(12.0, topics=FELL, confirmed=4)
    plan = log.snapshot.decision.plan
    capped = replace(plan, topics={**plan.topics, "/camera": replace(plan.topics["/camera"], max_rate_hz=4.0)})
    *_, free = log.wait(12.0, plan=capped, topics=FULL)
    assert "/camera 2.1 → 4 Hz" in free.text
    *_, slowed = log.wait(12.0, topics=FELL)
    assert "/camera 4 → 2.1 Hz" in slowed.text


def test_a_topic_that_has_left_is_not_told_to_send_more(log):
    """Nobody sends it any longer, so the link does not let it."""
    first(log)
    log.wait(12.0, topics=FELL, confirmed=4)
    publishers = [each for each in log.snapshot.observation.publishers if each.topic != "/camera"]
    told = [event for event in log.wait(12.0, publishers=publishers, topics=FULL[1:]) if event.kind == "rates"]
    assert [event.text for event in told] == ["the link slows no topic any longer: /front and /rear 12 → 20 Hz"]


# -- publishers


def swapped(number, result="ok", **phases):
    return SwapRecord(
        number=number, result=result, depth=10, deadline_ns=125 * MS, seconds_by_phase=phases or {"matching": 3.0}
    )


def test_swaps_from_before_the_start_are_history():
    """A restarted daemon does not repeat the events of the one before."""
    log = Log()
    told = log.wait(3.0, publishers=(publisher("/n", "/a", last_swap=swapped(7)),))
    assert kinds(told) == [Happening.STARTED]
    told = log.wait(3.0, publishers=(publisher("/n", "/a", last_swap=swapped(8)),))
    assert kinds(told) == [Happening.SWAP]


def test_a_refusal_is_told_once_however_often_it_is_announced(log):
    """It comes and goes with every plan, and its words change."""
    camera, front, *_ = log.parts["observation"]["publishers"]
    told = []
    for reason in 5 * (RefusalReason.TRANSIENT_LOCAL, RefusalReason.NONE):
        said = f"/front is {reason} ({len(told)})" if reason is not RefusalReason.NONE else ""
        told += log.wait(2.0, publishers=(camera, replace(front, refusal=said, refusal_reason=reason)))
    (refused,) = [event for event in told if event.kind is Happening.SWAP]
    assert (refused.topic, refused.node, "/front is " in refused.text) == ("/front", "/lidar", True)


SWAP = {"last_swap": swapped(1, matching=3.1, watching=0.0, proving=0.3)}
KEPT = {"last_swap": swapped(1, "unmatched"), "refusal": "/r is late", "refusal_reason": RefusalReason.UNMATCHED}


@pytest.mark.parametrize(("severity", "change", "words"), [("info", SWAP, "3.4 s"), ("warning", KEPT, "/r is late")])
def test_a_swap_is_one_event_with_its_reason_and_so_are_many(log, severity, change, words):
    """It names the topic, and how long it took or why not; of many it names the first."""
    publishers = log.parts["observation"]["publishers"]
    (told,) = log.wait(5.0, publishers=(replace(publishers[0], **change), *publishers[1:]))
    assert (told.kind, str(told.severity), told.topic) == (Happening.SWAP, severity, "/camera")
    assert words in told.text
    again = {"last_swap": replace(change["last_swap"], number=2, result="ok")}
    (told,) = log.wait(5.0, publishers=tuple(replace(each, **again) for each in publishers))
    assert told.text == "4 publishers swapped: /camera, /front, /imu and 1 more"


# -- the log itself


def test_counts_have_every_kind_and_the_last_events_are_kept(log):
    """A kind that never happened counts 0; of many events the last two hundred stay, the oldest first."""
    assert set(log.decision_log.counts_by_kind) == set(MESSAGE_IDS)
    assert log.decision_log.counts_by_kind["outage"] == 0
    for number in range(300):
        log.tick(after_s=10.0, plan=plan_of(number + 1, camera=1 + number % 2), reason="up")
    assert log.decision_log.counts_by_kind["plan"] == 300
    assert len(log.decision_log.events) == MOST_EVENTS
    numbers = [event.number for event in log.decision_log.events]
    assert numbers == sorted(numbers)


_WORDS = st.text(max_size=300)
_NAMES = st.sampled_from(["a", "b", "d" * 250, "\x1b[2J\n"])
_PUBLISHER = st.builds(
    lambda name, **fields: publisher("/n", name, **fields),
    _NAMES,
    refusal=_WORDS,
    refusal_reason=st.sampled_from(list(RefusalReason)),
    last_swap=st.integers(1, 8).map(swapped),
)
_STEP = st.fixed_dictionaries(
    {"after_s": st.floats(0.05, 2.0)},
    optional={
        "state": st.sampled_from([LinkState.STEADY, LinkState.OUTAGE]),
        "active_daemon": st.sampled_from(["", "a", "b\n"]),
        "topics": st.dictionaries(_NAMES, st.floats(0.0, 1e4)).map(lambda rates: slowed(**rates)),
        "config_error": _WORDS,
        "plan": st.dictionaries(_NAMES, st.integers(1, 5000)).map(lambda rows: plan_of(len(rows), **rows)),
        "publishers": st.lists(_PUBLISHER, max_size=8).map(tuple),
    },
)


@examples(60)
@given(st.lists(_STEP, min_size=1, max_size=60))
def test_whatever_happens_the_log_stays_readable(steps):
    """Any words and any sequence of snapshots: printable lines of 600 characters at most, and numbers in order."""
    log = Log()
    told = [event for step in steps for event in log.tick(**step)]
    assert [event.number for event in told] == list(range(1, len(told) + 1))
    for event in told:
        assert 0 < len(event.text) <= 600
        assert all(text.isprintable() for text in (event.text, *event.details.values()))
        assert all(name == name.lower() for name in event.details)
        assert all(len(text) <= 200 for text in event.details.values())


def test_a_flood_of_one_kind_is_told_as_a_number(log):
    """Ten new plans a second are twelve lines in a minute; the next says how many are left out."""
    told = []
    for number in range(700):
        told += log.tick(plan=plan_of(number + 1, camera=1 + number % 2), reason="up")
    assert 12 < len(told) <= 24
    (counted,) = [event for event in told if "omitted" in event.details]
    assert counted.text.startswith(f"after {counted.details['omitted']} more events")
    assert 580 < int(counted.details["omitted"]) < 610


def test_a_condition_that_flaps_is_told_less_often_and_never_wrongly(log):
    """Whatever was last said of it holds, or will be corrected within a minute."""
    told = []
    for number in range(200):
        told += log.tick(state=(LinkState.OUTAGE, LinkState.STEADY)[number % 2])
    assert [event.details["state"] for event in told] == ["began", "ended"] * 12
    told = log.wait(60.0, state=LinkState.OUTAGE)
    assert [event.details["state"] for event in told if event.kind is Condition.OUTAGE] == ["began"]
