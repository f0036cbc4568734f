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


def test_turns_that_take_long_are_rarer_but_not_rare():
    """They rest for thirty times their duration, and for two seconds at most: something else may have held one up."""
    turns = Turns()
    turned(turns, 10.0, took_s=0.02)
    assert not turns.is_due(10.55, facts=AFTER, publishers=())
    assert turns.is_due(10.65, facts=AFTER, publishers=())
    turned(turns, 10.0, took_s=5.0)
    assert not turns.is_due(11.9, facts=AFTER, publishers=())
    assert turns.is_due(12.1, facts=AFTER, publishers=())
