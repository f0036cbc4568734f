"""What the daemon needs of the world around it, and of whoever estimates the link."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from arpd.model.link import LinkEstimate
    from arpd.model.observation import Observation
    from arpd.model.plan import Transition
    from arpd.model.probing import ProbeRequest
    from arpd.model.settings import GraphSettings, LinkSettings


class World(Protocol):
    """What the daemon observes and acts on: ROS (`arpd.adapters.ros.world`), or a simulated link."""

    def observe(self, now_s: float) -> Observation:
        """Return everything one tick sees."""

    def set_gate(self, gate: float) -> None:
        """Tell every publisher the gate."""

    def apply(self, transitions: Iterable[Transition], *, now_s: float) -> None:
        """Carry out the steps of a plan; called at every tick until the publishers announce it."""

    def probe(self, request: ProbeRequest) -> None:
        """Put one probe train on the link."""

    def reconfigure(self, graph: GraphSettings) -> None:
        """Take new pinned topic counts."""

    def results(self) -> Mapping[str, int]:
        """Count parameter calls by result."""

    def probes_sent(self) -> tuple[int, int]:
        """Count probes, and their wire bytes."""


class CapacityEstimator(Protocol):
    """What tells the daemon the capacity: `arpd.estimate.estimator`, or in a simulation one to compare it with."""

    @property
    def has_evidence(self) -> bool:
        """Whether the first plan may be made."""

    def update(self, observation: Observation) -> LinkEstimate:
        """Digest one observation and return what is believed now."""

    def wanted_probes(self, now_s: float) -> tuple[ProbeRequest, ...]:
        """Probes to send now."""

    def reconfigure(self, settings: LinkSettings) -> None:
        """Take new settings; what was measured stays."""
