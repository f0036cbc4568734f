"""How the robot publishes: by plain rclpy with some QoS, or under a daemon's care."""

from __future__ import annotations

from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping

RCLPY_DEPTH = 10  # what every rclpy tutorial passes


@dataclass(frozen=True, kw_only=True, slots=True)
class Manner:
    """What the nodes of one run are told.

    Parameters
    ----------
    daemon : what governs them, as arguments of ``python -m``; empty = nobody
    depth : DEPTH of every writer and reader (samples)
    deadline_ns : DEADLINE that every writer offers and every reader requests (ns); 0 = none
    rates_hz : topics published less often than their source would (Hz)
    """

    daemon: tuple[str, ...] = ()
    depth: int = RCLPY_DEPTH
    deadline_ns: int = 0
    rates_hz: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))

    @property
    def is_managed(self) -> bool:
        """Whether a daemon governs the robot, with a peer and a relay."""
        return bool(self.daemon)

    def rate_hz(self, topic: str, source_rate_hz: float) -> float:
        """Return the rate at which a topic is published (Hz)."""
        return min(source_rate_hz, self.rates_hz.get(topic, source_rate_hz))

    def arguments(self, topic: str, source_rate_hz: float) -> list[str]:
        """Return what a node is told on its command line."""
        return [
            *("--depth", str(self.depth), "--deadline-ns", str(self.deadline_ns)),
            *("--rate", repr(self.rate_hz(topic, source_rate_hz))),
        ]


RCLPY_DEFAULTS = Manner()
WITH_ARPD = Manner(daemon=("arpd.cli", "run"))
