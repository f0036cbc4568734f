"""The next step of a robot that starts: one sentence for each thing that is missing."""

from __future__ import annotations

import pytest

from arpd.model.link import CapacityKind
from arpd.model.relay import RelaySummary, RelayTopics
from arpd.model.settings import LinkSettings, RelaySettings, RelayTopic, Settings, TopicSettings
from arpd.report.situation import Condition, judge, status_line
from tests.golden.sample import changed

ONE_END = Settings(relay=RelaySettings(topics=(RelayTopic(name="/scan"),)))
TWO_ENDS = Settings(relay=RelaySettings(link_domain=77, robot="10.0.0.1"))
NAMED = Settings(topics=(TopicSettings(name="/chatter"),))


def starting(settings=None, **observation):
    """Return a snapshot without publishers, relay and peers, in domain 7."""
    return changed(
        observation={"publishers": (), "relay": None, "peer_ages_s": {}, "domain": 7, **observation},
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
        (starting(TWO_ENDS, relay=of_relay(to_base=RelayTopics(offered=3))), ("3 topics", "start a reader")),
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
