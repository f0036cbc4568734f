"""The ways in which the robot publishes: with plain rclpy and some QoS, or under a daemon."""

from __future__ import annotations

from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping

RCLPY_DEPTH = 10  # what every rclpy tutorial passes


@dataclass(frozen=True, kw_only=True, slots=True)
class Manner:
    """The settings of the nodes of one run.

    Parameters
    ----------
    daemon : arguments of ``python -m`` for the daemon; empty = none
    depth : DEPTH of every writer, and the least of every reader (samples)
    deadline_ns : DEADLINE that every writer offers and every reader requests (ns); 0 = none
    rates_hz : lower rates of some topics than their sources' (Hz)
    has_two_ends : the relay has an end on each side, so that every topic keeps its name, and every node is a plain one
    """

    daemon: tuple[str, ...] = ()
    depth: int = RCLPY_DEPTH
    deadline_ns: int = 0
    rates_hz: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))
    has_two_ends: bool = False

    @property
    def is_managed(self) -> bool:
        """True if a daemon governs the robot, with a peer and a relay."""
        return bool(self.daemon)

    def rate_hz(self, topic: str, source_rate_hz: float) -> float:
        """Return a topic's publishing rate (Hz)."""
        return min(source_rate_hz, self.rates_hz.get(topic, source_rate_hz))

    def arguments(self, topic: str, source_rate_hz: float) -> list[str]:
        """Return a node's command-line arguments."""
        return [
            *("--depth", str(self.depth), "--deadline-ns", str(self.deadline_ns)),
            *("--rate", repr(self.rate_hz(topic, source_rate_hz))),
        ]


RCLPY_DEFAULTS = Manner()
WITH_ARPD = Manner(daemon=("arpd.cli", "run"))
WITH_TWO_ENDS = Manner(daemon=("arpd.cli", "run"), has_two_ends=True)
