"""Whole turns of the daemon."""

from __future__ import annotations

from typing import Any

from arpd.daemon.turns import Turns

BEFORE, AFTER = ("steady",), ("outage",)


def turned(turns, now_s, *, took_s=0.002, is_settled=True):
    turns.note(now_s, facts=BEFORE, publishers=(), took_s=took_s, is_settled=is_settled)


def test_two_whole_turns_a_second():
    """Without news half a second passes between two."""
    turns = Turns()
    assert turns.is_due(10.0, facts=BEFORE, publishers=())
    turned(turns, 10.0)
    assert not turns.is_due(10.4, facts=BEFORE, publishers=())
    assert turns.is_due(10.5, facts=BEFORE, publishers=())


def test_news_brings_a_turn_at_once():
    """New facts do, and announcements while a plan is under way."""
    turns = Turns()
    announced: Any = (object(),)
    turned(turns, 10.0)
    assert turns.is_due(10.1, facts=AFTER, publishers=())
    assert not turns.is_due(10.1, facts=BEFORE, publishers=announced)
    turned(turns, 10.0, is_settled=False)
    assert turns.is_due(10.1, facts=BEFORE, publishers=announced)
