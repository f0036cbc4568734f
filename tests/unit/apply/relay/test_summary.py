"""The relay's summary: it crosses unchanged, stays small, and nothing else is taken for one."""

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from arpd.apply.relay.offers import EndState, ServiceOffer, TopicOffer
from arpd.apply.relay.summary import MOST_SUMMARY_BYTES, decode_summary, encode_summary, topics_of
from arpd.model.relay import RelaySummary, RelayTopics

FULL = RelaySummary(
    other_host="ceddp",
    is_reachable=True,
    fault="it speaks version 2",
    to_ceddp=RelayTopics(offered=4, wanted=2, refused={"/odd": "no such type"}),
    to_robot=RelayTopics(offered=2, wanted=1),
    received=1000,
    doubled=3,
    unknown=2,
    incomplete=7,
    calls_failed={"timeout": 5},
    strangers=("rviz",),
    types_differ={"/scan": "it is A there and B here"},
)
texts = st.text(max_size=2000)


def offer(*names):
    return {name: TopicOffer(type_name="t/msg/T", writers=(), link_name=name) for name in names}


@pytest.mark.parametrize("summary", [FULL, RelaySummary()])
def test_it_crosses_unchanged(summary):
    """A decoded summary is the one that was encoded."""
    assert decode_summary(encode_summary(summary)) == summary


@given(st.dictionaries(texts, texts, max_size=30), st.lists(texts, max_size=30), texts)
def test_whatever_names_it_has_it_stays_small_and_is_understood(named, strangers, fault):
    """Long, many and unprintable names are cut and shown."""
    topics = RelayTopics(offered=500, refused=named)
    summary = RelaySummary(
        fault=fault, to_ceddp=topics, to_robot=topics, types_differ=named, strangers=tuple(strangers), other_host=fault
    )
    data = encode_summary(summary)
    assert len(data) <= MOST_SUMMARY_BYTES
    decoded = decode_summary(data)
    assert decoded.to_ceddp.offered == 500
    assert bool(decoded.to_ceddp.refused) is bool(named)
    assert decoded.fault.isprintable()


def changed(**parts):
    return json.dumps({**json.loads(encode_summary(FULL)), **parts}).encode()


@given(st.binary(max_size=300))
def test_random_bytes_are_refused(data):
    """Random bytes raise ValueError and nothing else."""
    with pytest.raises(ValueError, match=r"."):
        decode_summary(data)


def test_each_refusal_counts_in_its_direction():
    """An end refuses what enters its side, or, where nobody offers that there, what leaves it."""
    here = EndState(
        session="1",
        number=1,
        topics=offer("/imu", "/odd"),
        wants=frozenset({"/cmd", "/gone"}),
        refused={"/cmd": "a", "/odd": "b", "/plan": "c"},
    )
    there = EndState(
        session="2",
        number=1,
        topics=offer("/cmd", "/goal"),
        services={"/plan": ServiceOffer(type_name="s/srv/S", node="/n")},
        wants=frozenset({"/imu"}),
        refused={"/imu": "d", "/goal": "e"},
    )
    refused = {"/cmd": "a", "/plan": "c", "/goal": "e"}
    assert topics_of(here, there) == RelayTopics(offered=2, wanted=1, refused={"/odd": "b", "/imu": "d"})
    assert topics_of(there, here) == RelayTopics(offered=2, wanted=1, refused=refused)
