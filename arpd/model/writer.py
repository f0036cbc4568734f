"""A DDS writer as the flow and the swap of one publisher see it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol


@dataclass(frozen=True, kw_only=True, slots=True)
class WriterQos:
    """The two policies a swap changes: KEEP_LAST depth (samples) and offered deadline (ns, 0 = infinite)."""

    depth: int
    deadline_ns: int


class Writer(Protocol):
    """What a swap needs of a writer."""

    def publish(self, sample: bytes) -> None:
        """Write one serialized sample."""

    def matched(self) -> int:
        """Count the matched readers."""

    def is_acknowledged(self) -> bool:
        """Whether every sample written was acknowledged; never blocks."""

    def disconnects_readers(self) -> bool:
        """Whether a reader that its predecessor serves was discovered and refuses this writer's QoS; never blocks."""

    def deadlines_missed(self) -> int:
        """Count the offered deadlines missed since it was made, by a destroyed one as far as known; never blocks."""

    def destroy(self) -> None:
        """Destroy the writer."""
