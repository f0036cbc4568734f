"""Belief about the capacity of the link: one Bayesian filter on its logarithm, and what is stated of it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from arpd.estimate.parameters import FALLEN, NOTICED, RADIO_SHARE
from arpd.model.link import CapacityKind
from arpd.model.quantities import format_rate

if TYPE_CHECKING:
    from numpy.typing import NDArray

_LEAST, _MOST = 500.0, 12.5e9  # bytes/s
_BIN = 0.04  # of the logarithm
_LOGS = np.arange(math.log(_LEAST), math.log(_MOST) + _BIN, _BIN)
_UPPER_EDGES = _LOGS + 0.5 * _BIN
_NOTHING = 1e-12  # least probability of a bin: no evidence excludes a capacity for good

# What a link does between two looks: it drifts, and sometimes it jumps. Sprout (Winstein et al., NSDI 2013, §3) filters
# a drifting rate likewise; Wi-Fi and a moving robot jump, too.
_DRIFT = 0.04  # standard deviation in a second, of the logarithm
_JUMPS_HZ = 1.0
_JUMP = 0.7  # scale of a Laplace distribution, of the logarithm: a factor of two
_RETURNS, _USUAL_S = 0.5, 20.0  # part of the jumps that lead back to where the link was, and how long that counts
_JUMPED = np.exp(-np.abs(np.arange(-75, 76)) * _BIN / _JUMP)
_JUMPED /= _JUMPED.sum()

_SPREAD = 0.06  # of a reading, of the logarithm: packets are counted whole, and clocks are read late
_IDLED = 0.05  # more where the link may have idled a little
_OUTLIER = 0.01  # likelihood of any reading; two of them in a row are believed
_UNDISTURBED = 0.7  # of the trains; the others had samples between their packets
_DISTURBED = 0.4  # scale by which those read low, of the logarithm
_NEVER_IDLE, _ALWAYS_DELAYED = 0.3, 0.35  # least likelihoods: pings meet bursts, and jitter, at any load
_LEAST_FREE = 0.1  # part of the time that is left for bytes, at any overhead of packets
_STATED, _CAUTIOUS = 0.45, 0.3  # quantiles


class CapacityBelief:
    """Probability of every capacity, on a grid of its logarithm.

    Evidence multiplies the probabilities by its likelihood; each kind errs to its own side.

    Parameters
    ----------
    capacity : most likely before any evidence (bytes/s)
    """

    def __init__(self, capacity: float) -> None:
        self._at_s = -math.inf
        self._p = np.exp(-np.abs(_LOGS - math.log(capacity)))
        self._weigh(np.ones_like(_LOGS))
        self._usual = self._p  # where the link was lately

    def wait(self, now_s: float) -> None:
        """Let time pass before evidence of the same moment: the link may have drifted, or jumped."""
        elapsed_s, self._at_s = min(1.0, now_s - self._at_s), now_s
        if elapsed_s <= 0.0:
            return
        moved = 0.5 * _DRIFT**2 * elapsed_s / _BIN**2
        self._p = np.convolve(self._p, (moved, 1.0 - 2.0 * moved, moved), mode="same")
        self._usual += -math.expm1(-elapsed_s / _USUAL_S) * (self._p - self._usual)
        jumped = -math.expm1(-_JUMPS_HZ * elapsed_s)
        anywhere = np.convolve(self._p, _JUMPED, mode="same")
        p = (1.0 - jumped) * self._p + jumped * ((1.0 - _RETURNS) * anywhere + _RETURNS * self._usual)
        self._p = p / p.sum()  # some jumped beyond the grid

    def delivered_busy(self, rate: float, *, overhead: float = 0.0) -> None:
        """Note what arrived while the link was never idle: the capacity, or a little less (bytes/s).

        Parameters
        ----------
        overhead : part of the time that went to the overhead of packets, 0..1; the error grows with it
        """
        free = max(_LEAST_FREE, 1.0 - overhead)
        z = free * (_LOGS - math.log(rate / free))
        self._weigh(_OUTLIER + np.exp(-0.5 * (z / np.where(z < 0, _SPREAD, _SPREAD + _IDLED)) ** 2))

    def carried(self, rate: float, *, overhead: float = 0.0) -> None:
        """Note what arrived: the capacity is at least that (bytes/s)."""
        free = max(_LEAST_FREE, 1.0 - overhead)
        z = free * np.minimum(0.0, _LOGS - math.log(rate / free))
        self._weigh(_OUTLIER + np.exp(-0.5 * (z / _SPREAD) ** 2))

    def filled_by(self, rate: float) -> None:
        """Note a queue that stays while so much is sent: the capacity is at most that (bytes/s)."""
        z = np.maximum(0.0, _LOGS - math.log(rate))
        self._weigh(_OUTLIER + np.exp(-0.5 * (z / _SPREAD) ** 2))

    def train(self, rate: float) -> None:
        """Note the dispersion of a train: samples in between make it read low, hardly anything high (bytes/s)."""
        z = _LOGS - math.log(rate)
        near = np.exp(-0.5 * (z / _SPREAD) ** 2)
        low = np.where(z > 0, np.exp(-np.maximum(z, 0.0) / _DISTURBED), near)
        self._weigh(_OUTLIER + _UNDISTURBED * near + (1.0 - _UNDISTURBED) * low)

    def ping(self, rate: float, *, was_idle: bool, weight: float, overhead: float = 0.0, shown: float = 1.0) -> None:
        """Note whether a ping met a queue: a link that carries R is idle for 1 − R/C of the time.

        Parameters
        ----------
        rate : what was carried meanwhile, R (bytes/s)
        weight : of this evidence; pings that are close to each other meet the same queue
        shown : part of a busy time in which the queue is long enough to be told from jitter, 0..1
        """
        used = shown * np.minimum(1.0, overhead + np.exp(math.log(rate) - _LOGS))
        likelihood = np.maximum(_NEVER_IDLE, 1.0 - used) if was_idle else np.maximum(_ALWAYS_DELAYED, used)
        self._weigh(likelihood**weight)

    def stated(self, before: float) -> float:
        """Return the capacity to state: about as likely exceeded as not, and what was stated before while it may be so.

        A link that may have recovered has two likely capacities, and what lies between is none of them (bytes/s).
        """
        return min(max(before, self._quantile(_CAUTIOUS)), self._quantile(_STATED))

    def _weigh(self, likelihood: NDArray[np.float64]) -> None:
        p = self._p * likelihood
        self._p = np.maximum(_NOTHING, p / p.sum())

    def _quantile(self, part: float) -> float:
        sums = np.cumsum(self._p)
        return math.exp(np.interp(part * sums[-1], sums, _UPPER_EDGES))


class Statement:
    """Capacity that is stated of a belief, and the evidence for it.

    Parameters
    ----------
    capacity : the one before any evidence (bytes/s)

    Attributes
    ----------
    belief : probability of every capacity
    fell_at_s : when it fell by much last (s)
    """

    def __init__(self, capacity: float) -> None:
        self.belief, self.capacity = CapacityBelief(capacity), capacity
        self.kind = CapacityKind.CONFIGURED
        self.changed_at_s = self.fell_at_s = -math.inf
        self.evidence = "no evidence yet"

    def follow(self, now_s: float, kind: CapacityKind, why: str) -> None:
        """State what is believed, by evidence of a kind, where that is news."""
        before, is_new, self.kind = self.capacity, kind is not self.kind, kind
        if is_new or abs(self.belief.stated(before) / before - 1.0) > NOTICED:
            self.change(now_s, why)
            if not is_new and kind is CapacityKind.PEER and self.capacity < FALLEN * before:
                self.fell_at_s = now_s

    def change(self, now_s: float, why: str) -> None:
        """State what is believed, for a reason."""
        self.capacity, self.changed_at_s = self.belief.stated(self.capacity), now_s
        self.evidence = why

    def in_force(self, *, pinned: float | None, radio: float | None) -> tuple[float, CapacityKind, str]:
        """Return the capacity that counts (bytes/s), its kind, and why.

        Parameters
        ----------
        pinned, radio : capacity that the configuration pins, over everything; bit rate of the radio (bytes/s)
        """
        if pinned is not None:
            return pinned, CapacityKind.CONFIGURED, "pinned by the configuration"
        if radio is not None and self.kind is not CapacityKind.PEER and (bound := RADIO_SHARE * radio) < self.capacity:
            return bound, CapacityKind.RADIO, f"the radio sends at {format_rate(radio)}"
        return self.capacity, self.kind, self.evidence
