"""Belief about the capacity of the link: its value, age and reason."""

from __future__ import annotations

import math

from arpd.estimate.capacity import CapacityBelief
from arpd.estimate.parameters import FALLEN, NOTICED, RADIO_SHARE
from arpd.model.link import CapacityKind


class Belief:
    """Capacity that is believed, and the evidence for it.

    Parameters
    ----------
    capacity : the one before any evidence (bytes/s)

    Attributes
    ----------
    filter : probability of every capacity
    fell_at_s : when it fell by much last (s)
    pinned, radio : capacity that the configuration pins, over everything; bit rate of the radio (bytes/s)
    """

    def __init__(self, capacity: float) -> None:
        self.assume(capacity)
        self.pinned: float | None = None
        self.radio: float | None = None
        self.kind = CapacityKind.CONFIGURED
        self.changed_at_s = self.fell_at_s = -math.inf
        self.evidence = "no evidence yet"

    def assume(self, capacity: float) -> None:
        """Begin anew with a capacity, without evidence (bytes/s)."""
        self.filter, self.capacity = CapacityBelief(capacity), capacity

    def follow(self, now_s: float, kind: CapacityKind, why: str) -> None:
        """State what the filter holds, of a kind, where that is news."""
        before, is_new, self.kind = self.capacity, kind is not self.kind, kind
        if is_new or abs(self.filter.stated(before) / before - 1.0) > NOTICED:
            self.change(now_s, why)
            if not is_new and kind is CapacityKind.PEER and self.capacity < FALLEN * before:
                self.fell_at_s = now_s

    def change(self, now_s: float, why: str) -> None:
        """State what the filter holds, for a reason."""
        self.capacity, self.changed_at_s = self.filter.stated(self.capacity), now_s
        self.evidence = f"{self.capacity * 8e-6:.2f} Mbit/s: {why}"

    def in_force(self) -> tuple[float, CapacityKind, str]:
        """Return the capacity that counts (bytes/s), its kind, and why; the configuration or the radio may set it."""
        if self.pinned is not None:
            return self.pinned, CapacityKind.CONFIGURED, "pinned by the configuration"
        if self.radio is not None and self.kind is not CapacityKind.PEER:
            bound, radio_mbit = RADIO_SHARE * self.radio, self.radio * 8e-6
            if bound < self.capacity:
                why = f"{bound * 8e-6:.2f} Mbit/s: the radio sends at {radio_mbit:.1f} Mbit/s"
                return bound, CapacityKind.RADIO, why
        return self.capacity, self.kind, self.evidence
