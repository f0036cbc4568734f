"""What the governor sees when it decides on a plan."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from arpd.govern.plan import depths
from arpd.govern.swaps import swap_costs

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from arpd.model.allocation import Allocation, Topic
    from arpd.model.endpoints import PublisherState


@dataclass(frozen=True, kw_only=True, slots=True)
class Look:
    """One look of the governor at the robot: what a plan would be made for.

    Parameters
    ----------
    lasting : division of the budget that holds most of the time
    requests : tightest deadline that readers request, by topic (ns)
    silent : topics that nobody publishes on
    newest : newest generation that any endpoint announces
    participants : processes across the link
    """

    now_s: float
    lasting: Allocation
    topics: Sequence[Topic]
    publishers: Sequence[PublisherState]
    requests: Mapping[str, int]
    silent: frozenset[str]
    newest: int
    participants: int

    @property
    def crowd(self) -> tuple[frozenset[str], int]:
        """Names of the topics to plan for and, under the uniform policy, the number that shares the link."""
        return frozenset(row.name for row in self.lasting.topics), self.sharing

    @property
    def sharing(self) -> int:
        """Number of topics that share the link under the uniform policy, 0 under the other."""
        return self.lasting.uniform.topics if self.lasting.uniform else 0

    def costs(self) -> dict[str, float]:
        """Return the discovery bytes that a swap of each topic takes."""
        return swap_costs(self.publishers, participants=self.participants)

    def depths(self) -> dict[str, int]:
        """Return the depths that the program gives, in their classes (samples)."""
        return depths(self.lasting, self.topics)
