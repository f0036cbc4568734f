"""Endpoints between two announcements: numbers, signs of life, and the same picture until something changes."""

from typing import Any, NamedTuple

import pytest

from arpd.observe.registry import Endpoints, Tag
from tests.sample_publishers import publisher

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
    found = Endpoints(3.5)
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


@pytest.mark.parametrize(("life", "node", "number"), [(OTHER_LIFE, "/n", 1), (LIFE, "/m", 1), (LIFE, "/n", 3)])
def test_numbers_of_somebody_else_change_nothing(endpoints, life, node, number):
    """Neither another node, nor its successor under the same name, nor an unknown number counts."""
    before = published(endpoints)
    tell(endpoints, Row(number, 0, 7), life=life, node=node)
    assert published(endpoints) == before
    assert published(endpoints, 3.6) == {}
