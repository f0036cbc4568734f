"""The oracle, an estimator to compare arpd's with.

The governor sees delivery rates, outages and queues by the same definitions as with arpd's estimator.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

from arpd.estimate import parameters

if TYPE_CHECKING:
    from collections.abc import Callable

    from arpd.model.link import LinkEstimate
    from arpd.model.observation import Observation
    from arpd.model.probing import ProbeRequest
    from arpd.model.settings import LinkSettings


class Oracle:
    """An estimator that knows the link, the upper bound for every estimator; it sends no probes.

    Parameters
    ----------
    truth : returns the true state of the link
    """

    has_evidence = True

    def __init__(self, truth: Callable[[], LinkEstimate]) -> None:
        self._truth = truth

    def update(self, observation: Observation) -> LinkEstimate:
        """Return the truth, and what one large message explains of a queue."""
        truth = self._truth()
        capacity = max(1.0, truth.capacity_bytes_per_second)
        largest_bytes = max((each.wire_bytes(math.inf) for each in observation.publishers), default=0.0)
        burst_s = min(parameters.BURST_CAP_S, largest_bytes / capacity)
        return replace(truth, capacity_bytes_per_second=capacity, queue_allowance_s=parameters.QUEUE_LOW_S + burst_s)

    def wanted_probes(self, now_s: float, *, is_short: bool) -> tuple[ProbeRequest, ...]:  # noqa: ARG002 - as the estimator's
        """Ask for none."""
        return ()

    def reconfigure(self, settings: LinkSettings) -> None:
        """Ignore the settings."""
