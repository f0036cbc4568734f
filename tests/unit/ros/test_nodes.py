"""Nodes and their publishers, as the daemon counts them."""

from dataclasses import replace
from types import SimpleNamespace

from hypothesis import given
from hypothesis import strategies as st

from arpd.model.endpoints import MOST_PUBLISHERS, Direction, NodeSnapshot
from arpd.model.plan import NO_PLAN
from arpd.ros.nodes import MOST_NODES, SILENT_S, Nodes
from tests.examples import examples


def snapshot(node, *topics, **fields):
    neutral = {"type_name": "t", "direction": Direction.LOCAL, "payload_bytes": 0.0, "source_rate_hz": 0.0}
    usual = {**neutral, "node": node, "depth": 10, "baseline_depth": 10, **fields}
    return NodeSnapshot(node=node, answer=NO_PLAN, publishers=[{**usual, "topic": topic} for topic in topics])


def shows(is_shown):
    """Return a graph in which a function of node and topic says what is shown."""
    return SimpleNamespace(shows_writer=is_shown, fields_of=lambda _topic: {})


def topics(nodes, now_s):
    return [state.topic for state in nodes.live(now_s)]


def test_a_publisher_counts_once_the_graph_has_shown_it():
    """A publisher is pending until the graph shows it, and gone when its node falls silent."""
    nodes = Nodes()
    nodes.note(b"1", snapshot("/n", "/real", "/invented"), 0.0)
    assert (topics(nodes, 0.1), nodes.pending) == ([], 2)
    nodes.see(shows(lambda _node, topic: topic == "/real"))
    assert (topics(nodes, 0.2), nodes.pending) == (["/real"], 1)
    nodes.see(shows(lambda _node, _topic: False))  # as for some seconds behind a bad link
    nodes.note(b"1", snapshot("/n", "/real", "/invented"), 1.0)
    assert topics(nodes, 1.1) == ["/real"]
    assert (topics(nodes, 1.1 + SILENT_S), nodes.pending) == ([], 0)


def test_entries_are_bounded():
    """Nodes and publishers beyond all bounds are left out; those that are known stay."""
    nodes = Nodes()
    full = [f"/t{number}" for number in range(MOST_PUBLISHERS)]
    assert nodes.note(b"1", snapshot("/n", *full), 0.0)
    assert not nodes.note(b"2", snapshot("/m", "/t"), 0.0)
    assert nodes.note(b"1", snapshot("/n", "/t"), 0.0)
    assert sum(nodes.note(f"w{k}".encode(), snapshot(f"/n{k}"), 0.0) for k in range(2 * MOST_NODES)) == MOST_NODES - 2
    nodes.see(shows(lambda _node, _topic: True))
    assert topics(nodes, 0.1) == ["/t"]


def test_a_node_for_which_there_is_little_room_keeps_what_it_made_first():
    """The rest is named, with what the node itself leaves out; once another node has gone, all are managed."""
    nodes = Nodes()
    nodes.see(shows(lambda node, _topic: node != "/invented"))
    many = [f"/t{number}" for number in range(MOST_PUBLISHERS)]
    nodes.note(b"1", replace(snapshot("/invented", *many), left_out=9), 0.0)
    assert nodes.note(b"2", snapshot("/small", *many[:-2]), 0.1)
    for now_s in (0.2, 1.2):
        assert not nodes.note(b"3", replace(snapshot("/late", "/a", "/b", "/c"), left_out=4), now_s)
        assert not nodes.note(b"4", snapshot("/last", "/d"), now_s)
        assert nodes.left_out == {"/late": 5, "/last": 1}
        late = [(state.node, state.topic) for state in nodes.live(now_s) if state.node != "/small"]
        assert late == [("/late", "/a"), ("/late", "/b")]
    nodes.live(0.1 + SILENT_S + 0.1)
    assert nodes.note(b"3", snapshot("/late", "/a", "/b", "/c"), 5.0)
    assert nodes.note(b"4", snapshot("/last", "/d"), 5.0)
    assert (nodes.left_out, topics(nodes, 5.1)) == ({}, ["/d", "/a", "/b", "/c"])


@examples(40)
@given(st.lists(st.tuples(st.integers(0, 3), st.integers(0, 4), st.booleans(), st.floats(0, 4)), max_size=60))
def test_nothing_lives_that_was_not_both_shown_and_told(events):
    """At any order of events, a live publisher was shown once and told lately, and no other one is missing."""
    nodes = Nodes()
    now_s, told = 0.0, {}
    shown = frozenset()
    for node, topic, is_graph, pause_s in events:
        now_s += pause_s
        key = (f"/n{node}", f"/t{topic}")
        nodes.live(now_s)  # forgets who is silent
        if is_graph:
            shown = shown ^ {key}
        else:
            nodes.note(key[0].encode(), snapshot(*key), now_s)
            told[key[0]] = key[1], now_s
        if is_graph:
            nodes.see(shows(lambda *known, shown=shown: known in shown))
        live = {(state.node, state.topic) for state in nodes.live(now_s)}
        lately = {(name, last) for name, (last, at_s) in told.items() if now_s - at_s <= SILENT_S}
        assert live <= lately
        assert shown & lately <= live
