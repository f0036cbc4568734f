"""Endpoints between two announcements: numbers, signs of life, and the same picture until something changes."""

from typing import Any, NamedTuple

import pytest

from arpd.model.endpoints import Direction
from arpd.observe.registry import Endpoints, Tag
from tests.sample_publishers import publisher, reader

LIFE, OTHER_LIFE = 7, 8
COMMON: dict[str, Any] = {"generation": 5, "lease_s": 30.0}


class Row(NamedTuple):
    number: int
    serial: int
    published: int

    def changes(self, told):
        return {"published": told["published"] + self.published}


@pytest.fixture
def endpoints():
    found: Endpoints[Any] = Endpoints(3.5)
    found.see(lambda _node, _topic: True, 0.0)
    found.note(publisher("/n", "/a", published=100), 0.0, Tag(LIFE, 1, 0))
    found.note(publisher("/n", "/b", published=200), 0.0, Tag(LIFE, 2, 4))
    return found


def tell(endpoints, *rows, life=LIFE, now_s=1.0, node="/n"):
    endpoints.note_rows(node, life, rows, common=COMMON, now_s=now_s)


def published(endpoints, now_s=1.0):
    return {state.topic: state.published for state in endpoints.live(now_s)}


def test_numbers_count_from_the_last_status(endpoints):
    """A row changes the numbers of its publisher, from its last status on, and the plan of all."""
    tell(endpoints, Row(1, 0, 7), Row(2, 4, 9))
    tell(endpoints, Row(1, 0, 8), Row(2, 4, 9))
    assert published(endpoints) == {"/a": 108, "/b": 209}
    assert {(state.generation, state.lease_s, state.announced_at_s) for state in endpoints.live(1.0)} == {
        (5, 30.0, 1.0)
    }


def test_a_publisher_that_is_not_listed_is_gone(endpoints):
    """The numbers are the sign of life."""
    tell(endpoints, Row(2, 4, 9), now_s=3.0)
    assert published(endpoints, 3.4) == {"/a": 100, "/b": 209}
    assert published(endpoints, 3.6) == {"/b": 209}
    assert published(endpoints, 6.6) == {}


def test_a_lost_status_leaves_the_sign_of_life(endpoints):
    """Numbers after a status that never came are left out, until the next one."""
    tell(endpoints, Row(1, 0, 7))
    tell(endpoints, Row(1, 1, 3), now_s=4.0)
    assert published(endpoints, 4.0) == {"/a": 107}
    endpoints.note(publisher("/n", "/a", published=300), 4.1, Tag(LIFE, 1, 2))
    tell(endpoints, Row(1, 2, 4), now_s=5.0)
    assert published(endpoints, 5.0) == {"/a": 304}


@pytest.mark.parametrize(("life", "node", "number"), [(OTHER_LIFE, "/n", 1), (LIFE, "/m", 1), (LIFE, "/n", 3)])
def test_numbers_of_somebody_else_change_nothing(endpoints, life, node, number):
    """Neither another node, nor its successor under the same name, nor an unknown number counts."""
    before = published(endpoints)
    tell(endpoints, Row(number, 0, 7), life=life, node=node)
    assert published(endpoints) == before
    assert published(endpoints, 3.6) == {}


def test_a_node_that_returns_takes_the_place_of_its_predecessor(endpoints):
    """After the first status of the new life, numbers of the old one change nothing."""
    endpoints.note(publisher("/n", "/a", published=1), 1.0, Tag(OTHER_LIFE, 1, 0))
    tell(endpoints, Row(1, 0, 50))
    assert published(endpoints)["/a"] == 1
    tell(endpoints, Row(1, 0, 2), life=OTHER_LIFE)
    assert published(endpoints)["/a"] == 3


def test_a_false_number_does_not_take_an_entry(endpoints):
    """Two topics that claim one number leave an entry each, and no key without one."""
    endpoints.note(publisher("/n", "/c"), 1.0, Tag(LIFE, 1, 0))
    endpoints.note(publisher("/n", "/a"), 1.5, Tag(LIFE, 9, 0))
    tell(endpoints, Row(1, 0, 3), Row(9, 0, 4), now_s=2.0)
    assert published(endpoints, 2.0) == {"/a": 4, "/b": 200, "/c": 3}
    for now_s in (9.0, 9.5):
        assert published(endpoints, now_s) == {}
        tell(endpoints, Row(1, 0, 3), Row(2, 4, 3), Row(9, 0, 4), now_s=now_s)


def test_the_picture_is_the_same_object_until_something_changes(endpoints):
    """Looks between two messages cost nothing; each message, expiry or change of the graph makes a new picture."""
    first = endpoints.live(0.1)
    assert endpoints.live(0.2) is first
    endpoints.see(lambda _node, _topic: True, 0.3)
    assert endpoints.live(0.4) is first
    tell(endpoints, Row(1, 0, 7))
    second = endpoints.live(1.0)
    assert second is not first
    assert second[1] is first[1], "a publisher that told nothing keeps its state"
    endpoints.see(lambda _node, topic: topic == "/a", 1.1)
    assert endpoints.live(3.4) is not second
    assert published(endpoints, 3.6) == {"/a": 107}
    endpoints.see(lambda _node, _topic: False, 3.7)
    tell(endpoints, Row(1, 0, 7), now_s=13.0)
    assert published(endpoints, 13.0) == {"/a": 107}
    assert published(endpoints, 13.8) == {}, "the graph has not shown it for ten seconds"


def test_what_the_graph_shows_is_joined_when_it_changes(endpoints):
    """Another function may return other fields; what it returns of the others changes nothing."""
    first = endpoints.live(0.1, known_of=lambda _node, _topic: {"remote_readers": 1})
    second = endpoints.live(0.1, known_of=lambda _node, topic: {"remote_readers": 2 if topic == "/a" else 1})
    assert [state.remote_readers for state in second] == [2, 1]
    assert second[1] is first[1]
    local = endpoints.live(0.1, known_of=lambda _node, _topic: {"direction": Direction.LOCAL})
    assert {(state.direction, state.remote_readers) for state in local} == {(Direction.LOCAL, 0)}


def test_a_repeated_announcement_is_a_sign_of_life():
    """A repeat renews the readers that are known, and returns false if one is not."""
    readers: Endpoints[Any] = Endpoints(10.0)
    readers.see(lambda _node, _topic: True, 0.0)
    readers.note(reader("/n", "/a"), 0.0)
    assert readers.renew([("/n", "/a")], 8.0)
    assert [state.announced_at_s for state in readers.live(12.0)] == [8.0]
    assert not readers.renew([("/n", "/a"), ("/n", "/b")], 12.5)
    assert [state.announced_at_s for state in readers.live(13.0)] == [12.5]


@pytest.mark.parametrize(("serial", "is_taken"), [(8, True), (7, True), (6, False), (200, False)])
def test_a_status_that_comes_late_replaces_no_newer_one(serial, is_taken):
    """One that waited for the graph while its successor came is ignored, also after the serials wrapped."""
    endpoints: Any = Endpoints(3.5)
    endpoints.see(lambda _node, _topic: True, 0.0)
    endpoints.note(publisher("/n", "/t", depth=7), 1.0, Tag(5, 1, 7))
    endpoints.note(publisher("/n", "/t", depth=8), 1.1, Tag(5, 1, serial))
    assert [state.depth for state in endpoints.live(1.2)] == [8 if is_taken else 7]
