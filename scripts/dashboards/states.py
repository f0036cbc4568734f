"""State sets of arpd as one number each, with the words and colours a panel shows for it.

A state set is one series per state, 1 for the current one. A state timeline wants one series whose value is the state.
The colours are those of Okabe and Ito, which people with any common colour blindness can tell apart. States that need
attention are vermillion and orange, and every state also has words.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

BLUE, SKY, GREEN, YELLOW = "#0072B2", "#56B4E9", "#009E73", "#F0E442"
ORANGE, VERMILLION, PINK, GREY = "#E69F00", "#D55E00", "#CC79A7", "#999999"


@dataclass(frozen=True, kw_only=True, slots=True)
class StateSet:
    """A family of series, one of them 1.

    Parameters
    ----------
    metric, label : name of the family, and of the label that names the state
    states : label value, words and colour of each; its number is its place, from 1
    """

    metric: str
    label: str
    states: tuple[tuple[str, str, str], ...]

    def expression(self, by: str, matchers: str = "") -> str:
        """Return PromQL for the number of the current state, one series per value of the labels ``by``."""
        each = " or ".join(
            f'{number} * {self.metric}{{{self.label}="{state}"{", " if matchers else ""}{matchers}}}'
            for number, (state, _, _) in enumerate(self.states, 1)
        )
        return f"max by ({by}) ({each})"

    @property
    def mappings(self) -> list[dict[str, Any]]:
        """Grafana's value mappings from the number to words and colour."""
        options = {
            str(number): {"color": colour, "index": number - 1, "text": text}
            for number, (_, text, colour) in enumerate(self.states, 1)
        }
        return [{"options": options, "type": "value"}]

    @property
    def mappings_of_names(self) -> list[dict[str, Any]]:
        """The same from the label's value, for a table that shows the label."""
        options = {
            state: {"color": colour, "index": place, "text": text}
            for place, (state, text, colour) in enumerate(self.states)
        }
        return [{"options": options, "type": "value"}]


LINK = StateSet(
    metric="arpd_link_state",
    label="state",
    states=(
        ("steady", "steady", GREEN),
        ("app_limited", "app-limited", SKY),
        ("draining", "draining", YELLOW),
        ("congested", "congested", ORANGE),
        ("outage", "outage", VERMILLION),
    ),
)
INTERFACE = StateSet(
    metric="arpd_link_interface_state",
    label="state",
    states=(
        ("up", "up", GREEN),
        ("no_carrier", "no carrier", ORANGE),
        ("down", "switched off", PINK),
        ("gone", "gone", VERMILLION),
    ),
)
KIND = StateSet(
    metric="arpd_link_capacity_kind",
    label="kind",
    states=(
        ("peer", "measured with the peer", GREEN),
        ("local", "measured alone", SKY),
        ("radio", "told by the radio", YELLOW),
        ("configured", "configured, not measured", ORANGE),
    ),
)
STATUS = StateSet(
    metric="arpd_allocation_status",
    label="status",
    states=(("optimal", "all fits", GREEN), ("empty", "no topics", GREY), ("degraded", "floors given up", VERMILLION)),
)
_BINDINGS = (
    ("nothing", "nothing", GREY),
    ("desired_rate", "nothing, it has all it wants", GREEN),
    ("max_depth", "greatest depth", SKY),
    ("latency_budget", "latency budget", BLUE),
    ("memory", "memory", PINK),
    ("link", "link", ORANGE),
    ("floor", "floor", VERMILLION),
)
BINDING = StateSet(metric="arpd_allocation_binding", label="binding", states=_BINDINGS)
RATE_BINDING = StateSet(metric="arpd_topic_rate_binding", label="binding", states=_BINDINGS)
DEPTH_BINDING = StateSet(metric="arpd_topic_depth_binding", label="binding", states=_BINDINGS)

STATE_SETS = (LINK, INTERFACE, KIND, STATUS, BINDING, RATE_BINDING, DEPTH_BINDING)
