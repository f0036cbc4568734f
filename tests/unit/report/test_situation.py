"""The one judgement of a snapshot, and the line for systemd."""

import math
import re
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import pytest

import arpd.web
from arpd.model.allocation import AllocationStatus, Binding
from arpd.model.link import CapacityKind, LinkState
from arpd.model.observation import MessageKind, MessageRefusal
from arpd.model.plan import QosPlan
from arpd.model.relay import RelaySummary, RelayTopics
from arpd.model.settings import LinkSettings, RelaySettings, RelayTopic, Settings, TopicSettings
from arpd.report.conditions import Condition, Severity
from arpd.report.situation import judge, status_line
from tests.golden.sample import FINISHED_AT_S, changed, held, looked

NO_PLAN = QosPlan(generation=0, topics=MappingProxyType({}), level_bytes_per_second=0.0)
CALM = {"link": {"loss_ratio": 0.0}}


def findings(snapshot, **options):
    return {found.condition: found.text for found in judge(snapshot, **options).findings}


def test_the_verdict_answers_the_four_questions():
    """A limited link: that it is the limit, what arpd slowed, how much, and what queues now."""
    verdict = judge(changed(**CALM)).verdict
    assert (verdict.condition, verdict.condition.severity) == (Condition.LIMITED, Severity.WARNING)
    for number in ("3.4 Mbit/s of 4 Mbit/s", "1 of 3 topics", "/camera/image", "30 → 12.5 Hz", "; 12.5 ms of queue."):
        assert number in verdict.text
    camera = changed().observation.publishers[-1]
    twice = (*changed().observation.publishers, replace(camera, node="/camera2"))
    assert "1 of 3 topics" in judge(changed(observation={"publishers": twice}, **CALM)).verdict.text
    queueing = judge(changed(link={"queue_delay_s": 0.3, "loss_ratio": 0.05})).verdict
    assert all(words in queueing.text for words in ("still 300 ms of queue", "5 %"))
    lossy = judge(changed(link={"queue_delay_s": 0.0, "loss_ratio": 0.05})).verdict
    assert "; no queue and 5 % loss." in lossy.text


def test_a_link_is_not_enough_where_a_topic_does_not_leave_as_it_may():
    """Other robots behind the same access point, or a busy computer, keep what the estimate would allow."""
    camera = replace(changed().observation.publishers[-1], source_rate_hz=12.0)
    for published_hz, condition in ((11.5, Condition.CLEAR), (5.0, Condition.BEHIND)):
        publishers = (*changed().observation.publishers[:-1], replace(camera, published_rate_hz=published_hz))
        verdict = judge(changed(observation={"publishers": publishers}, **CALM)).verdict
        assert verdict.condition is condition
        assert ("leaves at 5 of 12 Hz, though 4 Mbit/s would be enough; " in verdict.text) is (published_hz == 5.0)


def test_a_topic_whose_far_reader_has_left_is_not_behind():
    """Its plan and max_rate_hz stay for a while, and the program no longer has it."""
    camera = replace(changed().observation.publishers[-1], published_rate_hz=5.0)
    allocation = {"topics": [topic for topic in changed().allocation.topics if topic.name != camera.topic]}
    observation = {"publishers": (*changed().observation.publishers[:-1], camera)}
    assert judge(changed(observation=observation, allocation=allocation, **CALM)).verdict.condition is Condition.CLEAR


def test_a_topic_that_is_behind_is_held_to_what_it_may_have():
    """Of 30 Hz, 12.5 are all that max_rate_hz lets go."""
    publishers = (
        *changed().observation.publishers[:-1],
        replace(changed().observation.publishers[-1], published_rate_hz=5.0),
    )
    image, *others = changed().allocation.topics
    allocation = {"topics": (replace(image, binding=Binding.DESIRED_RATE), *others)}
    verdict = judge(changed(observation={"publishers": publishers}, allocation=allocation, **CALM)).verdict
    assert "/camera/image leaves at 5 of 12.5 Hz, though 4 Mbit/s would be enough; " in verdict.text


@pytest.mark.parametrize(
    ("change", "condition", "words"),
    [
        ({"link": {"state": LinkState.OUTAGE}}, Condition.OUTAGE, "than its minimum rate"),
        ({"observation": {"counters": None}}, Condition.INTERFACE_DOWN, "wlan0 is gone"),
        ({"observation": {"counters": None}, "has_interface": False}, Condition.INTERFACE_DOWN, "link.interface"),
        (
            {"observation": {"counters": None}, "has_interface": False},
            Condition.INTERFACE_DOWN,
            "not there yet, and the peer answers over another one",
        ),
        ({"link": {"state": LinkState.DRAINING}}, Condition.QUEUE, "12.5 ms of queue"),
        ({"link": {"queue_delay_s": math.nan, "state": LinkState.CONGESTED}}, Condition.QUEUE, "unknown length"),
        ({"allocation": {"budget_bytes_per_second": 1.0}}, Condition.QUEUE, "next to nothing of 4 Mbit/s"),
        ({"allocation": {"status": AllocationStatus.DEGRADED}}, Condition.MINIMUM_RATES, ""),
        (
            {"allocation": {"status": AllocationStatus.DEGRADED, "binding": Binding.MEMORY}},
            Condition.MINIMUM_RATES,
            "memory for histories is short (program.memory_budget), and arpd gives up",
        ),
        # A budget that follows a link that rises has no queue to drain.
        ({"link": {"capacity_bytes_per_second": 5e6}}, Condition.LIMITED, "of 40 Mbit/s"),
        ({"observation": {"publishers": ()}}, Condition.NOTHING_TO_MANAGE, "AdaptivePublisher"),
        ({"decision": {"plan": NO_PLAN}}, Condition.MEASURING, "3 topics"),
    ],
)
def test_the_condition_that_matters_most_is_the_verdict(change, condition, words):
    """Each has a headline that does not change with numbers, and a sentence with the reason."""
    verdict = judge(held(changed(**change))).verdict
    assert verdict.condition is condition
    assert verdict.text.startswith(f"{condition.headline}: ")
    assert words in verdict.text


@pytest.mark.parametrize("settings", [Settings(), Settings(link=LinkSettings(capacity_bytes_per_second=1e6))])
def test_a_queue_that_stays_names_a_capacity_that_is_pinned_too_high(settings):
    """Nothing corrects such a capacity, so the queue comes back for ever."""
    verdict = judge(changed(link={"state": LinkState.CONGESTED}, settings=settings)).verdict
    assert verdict.condition is Condition.QUEUE
    assert ("link.capacity pins more than the link carries" in verdict.text) is (settings != Settings())


def test_faults_stand_beside_the_verdict_the_worst_first():
    """Ticks, configuration, relay, confirmation and keys that need a restart; all but the last are wrong."""
    refused = {"to_base": {"/scan": "two types"}, "to_robot": {"/cmd": "not let in"}}
    ways = {way: RelayTopics(refused=topics) for way, topics in refused.items()}
    relay = RelaySummary(is_reachable=False, other_host="base", **ways)
    left_out = {"/relay": 44, "/node": 2}
    parts = {"keys_awaiting_restart": ("http.port",), "observation": {"relay": relay, "left_out": left_out}}
    faulty = held(changed(config_error="a.yaml:1:1: x", **parts))
    faults = judge(faulty, now_s=FINISHED_AT_S + Condition.STALE.holds_s + 1.0).faults
    wrong = ["stale", "reload_refused", "relay_cut", "relay_refuses", "left_out", "unconfirmed"]
    assert [fault.condition for fault in faults if fault.condition.is_wrong] == wrong
    assert [fault.condition for fault in faults[len(wrong) :]] == ["restart_needed", "postponed"]
    assert faults[-1].phrase.startswith("QoS changes postponed: limit")
    assert "the last one finished 4 s ago" in faults[0].text
    assert "/cmd: not let in; also /scan" in faults[3].text
    assert "46 publishers of /node and /relay have no plan" in faults[4].text
    assert all(number in faults[5].text for number in ("2 of 3 publishers", "1 min"))
    assert judge(changed(), now_s=FINISHED_AT_S + Condition.STALE.holds_s).faults == ()


def test_another_daemon_is_told_of_when_it_surely_stands_by():
    """The graph shows one that was killed for a while, and one that starts does not know at once which one drives."""
    spare = changed(observation={"other_daemons": ("this host",)})
    for for_s, is_found in ((20.0, False), (31.0, True)):
        assert (Condition.SPARE_DAEMON in findings(held(spare, for_s=for_s))) is is_found


def test_the_ports_of_the_link_are_named_while_its_other_end_was_never_heard():
    """An end that spoke before is behind no firewall."""
    for other_host, is_named in (("", True), ("base", False)):
        snapshot = held(starting(TWO_ENDS, relay=of_relay(is_reachable=False, other_host=other_host)))
        told = findings(snapshot)[Condition.RELAY_CUT]
        assert ("UDP ports 26660 to 26667" in told) is ("10.0.0.1 (relay.robot)" in told) is is_named


def test_a_relay_is_not_called_silent_while_the_link_is_out():
    """What it tells the daemon waits in the same buffer as what it sends over the link."""
    for state, is_found in ((LinkState.OUTAGE, False), (LinkState.STEADY, True)):
        silent = held(changed(observation={"relay": None, "is_relay_silent": True}, link={"state": state}))
        assert (Condition.RELAY_SILENT in findings(silent)) is is_found


def test_cross_traffic_that_takes_much_of_the_link_stands_in_the_sentence():
    """Else nobody knows why topics may use so little of it."""
    for cross, words in ((1.25e6, "20 Mbit/s beside 10 Mbit/s of cross traffic, and"), (1e5, "20 Mbit/s, and")):
        link = {"capacity_bytes_per_second": 2.5e6, "cross_traffic_bytes_per_second": cross}
        assert words in judge(changed(link=link)).verdict.text


@pytest.mark.parametrize("condition", [each for each in Condition if each.holds_s and each is not Condition.STALE])
def test_a_condition_counts_once_it_has_held_for_its_time(condition):
    """The monotonic clock counts, whatever somebody sets the wall clock to."""
    peers = {"base": 0.0} if condition is Condition.PEER_LOST else {}
    relay = {"relay": RelaySummary(is_reachable=False), "is_relay_silent": True}
    snapshot = changed(allocation={"status": AllocationStatus.DEGRADED}, observation={**relay, "peer_ages_s": peers})
    for second in range(20):
        ages_s = {peer: float(second) for peer in snapshot.observation.peer_ages_s}
        observation = replace(snapshot.observation, peer_ages_s=ages_s)
        clocks = {"finished_at_s": FINISHED_AT_S + second, "unix_time_s": 1.7e9 + (second % 3) * 1e8}
        snapshot = looked(snapshot, observation=observation, **clocks)
        assert (condition in findings(snapshot)) is (second >= condition.holds_s)


def test_a_node_that_later_refuses_is_found_although_all_had_confirmed():
    """Every time that publishers fall behind the plan counts anew, and so does every plan."""
    snapshot, told = changed(), []
    for second in range(60):
        plan = replace(snapshot.decision.plan, generation=3 if second < 45 else 4)
        fields = {"confirmed": 2 if second >= 20 else 3, "decision": replace(snapshot.decision, plan=plan)}
        snapshot = looked(snapshot, finished_at_s=FINISHED_AT_S + second, **fields)
        told += [second] if Condition.UNCONFIRMED in findings(snapshot) else []
    assert told == [*range(35, 45)]


def test_a_peer_that_was_there_is_missed_until_one_reports():
    """The world forgets it after a minute, arpd does not; a robot that never had one misses none."""
    lost = changed(observation={"peer_ages_s": {"base": 11.0}})
    forgotten = looked(lost, observation=replace(lost.observation, peer_ages_s={}))
    for snapshot in (lost, forgotten):
        assert Condition.PEER_LOST in findings(snapshot)
        assert Condition.WITHOUT_PEER not in findings(held(snapshot))
    back = looked(forgotten, observation=replace(lost.observation, peer_ages_s={"base": 0.5}))
    assert Condition.PEER_LOST not in findings(back)
    assert Condition.PEER_LOST not in findings(changed(observation={"peer_ages_s": {}}))


def test_a_daemon_that_stands_by_knows_of_no_outage():
    """No peer answers it, because it asks nothing, so it misses none either."""
    silence = {"peer_ages_s": {"base": 30.0}, "active_daemon": "robot-2"}
    spare = findings(held(changed(link={"state": LinkState.OUTAGE}, observation=silence)))
    assert Condition.STANDING_BY in spare
    assert Condition.OUTAGE not in spare
    assert Condition.PEER_LOST not in spare


def test_the_line_for_systemd_has_the_link_the_plan_and_every_fault():
    """A daemon that stands by says so instead of link and plan, and hides no fault."""
    spare = status_line(changed(observation={"active_daemon": "robot-2"}, config_error="a.yaml:1:1: x"))
    assert spare.startswith("standing by: another arpd daemon, on robot-2")
    assert "reload refused: a.yaml:1:1: x" in spare
    assert "Mbit/s" not in spare
    told = status_line(changed())
    for number in ("4.0 Mbit/s", "peer", "steady", "0.5 cross", "75 %", "plan 3", "2 of 3"):
        assert number in told
    faulty = status_line(changed(observation={"counters": None}, config_error="x", keys_awaiting_restart=("a", "b")))
    assert faulty.startswith("wlan0 is gone; 4.0 Mbit/s")
    assert all(words in faulty for words in ("reload refused: x", "a and b are not in force"))


def test_the_line_for_systemd_has_no_figures_while_nothing_can_cross():
    """An outage says so in its own words; a link that is down without topics does not allow 100 %."""
    told = status_line(held(changed(link={"state": LinkState.OUTAGE})))
    assert told.startswith("the link carries nothing: no topic sends more than its minimum rate")
    told = status_line(held(starting(counters=None)))
    assert (told.startswith("wlan0 is gone"), "allowed" in told) == (True, False)


def test_the_page_calls_a_snapshot_stale_at_the_same_age():
    """The browser cannot import the threshold, so it repeats it."""
    script = (Path(arpd.web.__file__).parent / "assets" / "page.js").read_text()
    assert re.findall(r"STALE_S = ([\d.]+)", script) == [f"{Condition.STALE.holds_s:g}"]


# -- what arpd waits for

ONE_END = Settings(relay=RelaySettings(topics=(RelayTopic(name="/scan"),)))
TWO_ENDS = Settings(relay=RelaySettings(link_domain=77, robot="10.0.0.1"))
PINNED = Settings(link=LinkSettings(capacity_bytes_per_second=1e6))
NAMED = Settings(topics=(TopicSettings(name="/chatter"),))


def starting(settings=None, **observation):
    """Return a snapshot without publishers, relay and peers, in domain 7."""
    return changed(
        observation={"publishers": (), "relay": None, "peer_ages_s": {}, "domain": 7, **observation},
        settings=settings or Settings(),
    )


@pytest.mark.parametrize("topics", [RelayTopics(offered=2), RelayTopics()])
def test_nodes_that_ran_before_an_address_changed_must_start_again(topics):
    """They run, and the relay's end, which has started again, never finds them."""
    relay = RelaySummary(is_reachable=True, other_host="base", to_base=topics, to_robot=RelayTopics())
    verdict = judge(starting(TWO_ENDS, relay=relay)).verdict
    assert verdict.condition is Condition.NOTHING_TO_MANAGE
    assert "(again, if an address of its computer has changed since)" in verdict.text


def of_relay(**fields):
    return RelaySummary(**{"other_host": "laptop", "is_reachable": True, **fields})


@pytest.mark.parametrize(
    ("snapshot", "words"),
    [
        (starting(), ("AdaptivePublisher", "ROS domain 7", "arpd topics")),
        (starting(NAMED), ("/chatter", "ROS domain 7", "start its node")),
        (starting(ONE_END), ("/link/scan", "arpd-relay")),
        (starting(TWO_ENDS), ("both ends",)),
        (starting(TWO_ENDS, relay=of_relay(is_reachable=False)), ("both ends",)),
        (starting(TWO_ENDS, relay=of_relay()), ("ROS_DOMAIN_ID",)),
        (starting(TWO_ENDS, relay=of_relay(to_base=RelayTopics(offered=3))), ("3 topics", "start a reader")),
        (starting(TWO_ENDS, relay=of_relay(to_robot=RelayTopics(offered=3, wanted=1))), ("carry 1 topic",)),
    ],
)
def test_without_publishers_the_verdict_names_the_next_step(snapshot, words):
    """The configuration and the relay tell who is missing; systemd's line says the same."""
    verdict = judge(snapshot).verdict
    assert verdict.condition is Condition.NOTHING_TO_MANAGE
    assert all(word in verdict.text for word in words), verdict.text
    assert verdict.phrase in status_line(snapshot)


UNREADABLE = {(MessageKind.REPORTS, MessageRefusal.MALFORMED): 2}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({}, ("systemctl enable --now arpd-peer", "ROS domain 7", "auto")),
        ({"observation": {"peers": 1, "refused": {}}}, ("no report arrives",)),
        ({"observation": {"peers": 1, "refused": UNREADABLE}}, ("install one arpd",)),
        ({"link": {"kind": CapacityKind.CONFIGURED}, "settings": PINNED}, ("link.capacity",)),
        ({"link": {"kind": CapacityKind.RADIO}}, ("radio",)),
    ],
)
def test_without_a_peer_all_is_well_but_a_finding_says_what_is_missing(change, words):
    """It names how the capacity is known, and the unit to start."""
    observation = {"peer_ages_s": {}, "domain": 7, "peers": 0, **change.pop("observation", {})}
    found = findings(held(changed(observation=observation, **change)))
    assert not Condition.WITHOUT_PEER.is_wrong
    assert all(word in found[Condition.WITHOUT_PEER] for word in words), found
