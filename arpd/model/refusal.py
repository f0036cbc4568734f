"""Why a publisher or a reader keeps its QoS though another was asked for."""

from __future__ import annotations

from enum import StrEnum
from typing import NamedTuple


class RefusalReason(StrEnum):
    """Why QoS that was asked for is not in force; the words for a human stand beside it.

    A refusal that lasts is an answer: asking again changes nothing until the application itself does something else.
    """

    NONE = "none"
    MIDDLEWARE = "middleware"  # its QoS swaps were never measured
    TRANSIENT_LOCAL = "transient_local"  # a new endpoint would miss, or repeat, what late joiners need
    CLAMPED = "clamped"  # the deadline is the longest that a reader requests
    UNMATCHED = "unmatched"
    INCOMPATIBLE = "incompatible"
    FAILED = "failed"
    OTHER = "other"  # of an announcer that is older, or newer, than these words

    @property
    def is_lasting(self) -> bool:
        """Whether depth and deadline stay as they are for good."""
        return self in {RefusalReason.MIDDLEWARE, RefusalReason.TRANSIENT_LOCAL}

    @classmethod
    def told(cls, name: str | None, *, words: str) -> RefusalReason:
        """Understand what an announcement says; a refusal whose reason is not known counts as passing.

        Parameters
        ----------
        name : reason as announced, None where the announcer knows none
        words : refusal for a human, empty = nothing is refused
        """
        if not words:
            return cls.NONE
        reason = next((reason for reason in cls if reason == name), cls.OTHER)
        return cls.OTHER if reason is cls.NONE else reason


class Refusal(NamedTuple):
    """A reason, with the words for a human."""

    reason: RefusalReason = RefusalReason.NONE
    words: str = ""


NO_REFUSAL = Refusal()
