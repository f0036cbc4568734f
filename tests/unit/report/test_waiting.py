"""The next step of a robot that starts: one sentence for each thing that is missing."""

from __future__ import annotations

from dataclasses import replace

import pytest

from arpd.model.endpoints import Direction
from arpd.model.interface import InterfaceState
from arpd.model.link import CapacityKind, LinkState
from arpd.model.relay import RelaySummary, RelayTopics
from arpd.model.settings import LinkSettings, RelaySettings, Settings, TopicSettings
from arpd.report.situation import Condition, judge, status_line
from tests.golden.sample import changed

ONE_END = Settings(relay=RelaySettings(topics=("/scan",)))
TWO_ENDS = Settings(relay=RelaySettings(link_domain=77, robot="10.0.0.1"))
NAMED = Settings(topics={"/chatter": TopicSettings()})


def starting(settings=None, **observation):
    """Return a snapshot without publishers, relay and peers, in domain 7."""
    nobody = dict.fromkeys(("publishers", "readers"), ())
    return changed(
        observation={**nobody, "relay": None, "peer_ages_s": {}, "domain": 7, **observation},
        settings=settings or Settings(),
    )


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
        (starting(TWO_ENDS, relay=of_relay(to_ceddp=RelayTopics(offered=3))), ("3 topics", "start a reader")),
        (starting(TWO_ENDS, relay=of_relay(to_robot=RelayTopics(offered=3, wanted=1))), ("carry 1 topic",)),
    ],
    ids=["nothing", "named", "one end", "relay unknown", "other end", "no topics", "no readers", "begins"],
)
def test_without_publishers_the_verdict_names_the_next_step(snapshot, words):
    """The configuration and the relay tell who is missing; systemd's line says the same."""
    verdict = judge(snapshot).verdict
    assert verdict.condition is Condition.NOTHING_TO_GOVERN
    assert all(word in verdict.text for word in words), verdict.text
    assert verdict.phrase in status_line(snapshot)


def test_the_relays_domain_is_nobody_elses():
    """With two ends the daemon's domain is the relay's, in which no user starts a node."""
    situation = judge(starting(TWO_ENDS, relay=of_relay()))
    assert "domain 7" not in situation.verdict.text + situation.faults[-1].text


def test_a_topic_without_a_reader_on_the_other_side_is_named():
    """Its publisher is there, so the reader is the next step."""
    local = tuple(one for one in changed().observation.publishers if one.direction is Direction.LOCAL)
    text = judge(starting(publishers=local)).verdict.text
    assert local[0].topic in text
    assert "ROS domain 7" in text


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({}, ("systemctl enable --now arpd-peer", "ROS domain 7", "auto")),
        ({"observation": {"peers": 1}}, ("no report arrives",)),
        ({"observation": {"peer_ages_s": {"laptop": 20.0}}}, ("laptop",)),
        ({"link": {"kind": CapacityKind.CONFIGURED}}, ("link.initial_capacity",)),
        (
            {
                "link": {"kind": CapacityKind.CONFIGURED},
                "settings": Settings(link=LinkSettings(capacity_bytes_per_second=1e6)),
            },
            ("link.capacity",),
        ),
        ({"link": {"kind": CapacityKind.LOCAL}}, ("queue",)),
        ({"link": {"kind": CapacityKind.RADIO}}, ("radio",)),
    ],
)
def test_without_a_peer_all_is_well_but_a_finding_says_what_is_missing(change, words):
    """It names how the capacity is known, and the unit to start."""
    observation = {"peer_ages_s": {}, "domain": 7, "peers": 0, **change.pop("observation", {})}
    found = judge(changed(observation=observation, **change)).first_of({Condition.WITHOUT_PEER})
    assert found is not None
    assert not found.condition.is_wrong
    assert all(word in found.text for word in words), found.text


def test_a_named_interface_is_no_guess():
    """Only an interface that arpd chose is asked about."""
    named = Settings(link=LinkSettings(interface="wlan0"))
    assert "link.interface" not in judge(starting(named)).faults[-1].text


@pytest.mark.parametrize(
    "change",
    [
        {},
        {"observation": {"peer_ages_s": {}, "counters": None}},
        {"observation": {"peer_ages_s": {}, "active_daemon": "spare"}},
        {"observation": {"peer_ages_s": {}}, "link": {"state": LinkState.OUTAGE}},
    ],
)
def test_a_missing_peer_is_not_told_where_something_else_explains_it(change):
    """A peer that reports, a dead link and a daemon that stands by need no peer."""
    assert judge(changed(**change)).first_of({Condition.WITHOUT_PEER}) is None


def test_an_interface_without_carrier_needs_no_peer_either():
    """The interface is the next step."""
    counters = replace(changed().observation.counters, state=InterfaceState.NO_CARRIER)
    found = judge(changed(observation={"peer_ages_s": {}, "counters": counters}))
    assert found.verdict.condition is Condition.INTERFACE_DOWN
    assert found.first_of({Condition.WITHOUT_PEER}) is None
