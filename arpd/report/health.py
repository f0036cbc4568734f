"""Judgements of `arpd doctor` in common: each says what is well or harmful, and the line that mends it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple


class Health(StrEnum):
    """Result of one judgement."""

    FINE = "fine"
    WRONG = "wrong"  # somebody should do something
    UNKNOWN = "unknown"


class Unknown(NamedTuple):
    """A fact that could not be read, and why, in words that follow "because"."""

    why: str


@dataclass(frozen=True, kw_only=True, slots=True)
class Judgement:
    """Result of one check.

    Parameters
    ----------
    about : name of the check
    text : the finding, or the reason why nothing is known
    remedies : lines to type, or to do; the first one mends it now, others for good
    """

    about: str
    health: Health
    text: str
    remedies: tuple[str, ...] = ()


def fine(about: str, text: str) -> Judgement:
    """Judge that nothing needs to be done."""
    return Judgement(about=about, health=Health.FINE, text=text)


def wrong(about: str, text: str, *remedies: str) -> Judgement:
    """Judge that something should be done."""
    return Judgement(about=about, health=Health.WRONG, text=text, remedies=remedies)


def unknown(about: str, reason: Unknown | str) -> Judgement:
    """Judge nothing, for a reason."""
    why = reason.why if isinstance(reason, Unknown) else reason
    return Judgement(about=about, health=Health.UNKNOWN, text=why)
