"""Metrics of the relay with two ends, from the summaries of its end on the robot."""

from __future__ import annotations

from typing import TYPE_CHECKING

from arpd.relay.calls import FailureReason
from arpd.web.families import counter_of, gauge, gauge_of

if TYPE_CHECKING:
    from collections.abc import Iterator

    from prometheus_client.metrics_core import Metric

    from arpd.model.observation import Observation


def relay_metrics(observation: Observation) -> Iterator[Metric]:
    """Yield the families: none without two ends, and only the first while the end on the robot is silent."""
    relay = observation.relay
    if relay is None and not observation.is_relay_silent:
        return
    text = "1 while the relay's end on the robot tells the daemon what it does."
    yield gauge("arpd_relay_end_up", text, relay is not None)
    if relay is None:
        return
    text = "1 while the relay's other end is heard and understood."
    yield gauge("arpd_relay_other_end_up", text, relay.is_reachable and not relay.fault)
    directions = (("to_base", relay.to_base), ("to_robot", relay.to_robot))
    yield gauge_of(
        "arpd_relay_topics",
        "Topics that one side offers, that the other one reads, and that an end refuses, with refused services.",
        (
            ({"direction": direction, "state": state}, many)
            for direction, each in directions
            for state, many in (("offered", each.offered), ("refused", len(each.refused)), ("wanted", each.wanted))
        ),
    )
    yield counter_of(
        "arpd_relay_samples",
        "Samples that the robot's end received: new, second copies, outdated in an outage, of unknown writers.",
        (({"result": result}, getattr(relay, result)) for result in ("doubled", "outdated", "received", "unknown")),
    )
    text = "Samples that the robot's end dropped because their group was never complete."
    yield counter_of("arpd_relay_incomplete_samples", text, (({}, relay.incomplete),))
    text = "Calls from the robot's nodes across the link that had no answer."
    known = sorted(reason.value for reason in FailureReason)  # no message can add a label
    series = (({"reason": reason}, relay.calls_failed.get(reason, 0)) for reason in known)
    yield counter_of("arpd_relay_calls_failed", text, series)
