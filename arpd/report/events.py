"""Events of the decision log: one plain sentence each, and what a program needs to find them."""

from __future__ import annotations

from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping

    from arpd.report.conditions import Condition, Happening, Severity


@dataclass(frozen=True, slots=True)
class Event:
    """One line of the decision log.

    Parameters
    ----------
    kind, severity : what it is about, and its weight
    text : a plain sentence without a full stop: "the link slows 1 topic: /camera/image 30 → 2.1 Hz"
    topic, node : the topic and the node it is about, empty when there are several
    details : further facts by lower-case name, for programs
    number : counts up from 1 since the daemon started; 0 until it is in the log
    at_s, unix_time_s : monotonic and wall clock when it happened (s)
    """

    kind: Condition | Happening
    severity: Severity
    text: str
    topic: str = ""
    node: str = ""
    details: Mapping[str, str] = field(default_factory=lambda: MappingProxyType({}))
    number: int = 0
    at_s: float = 0.0
    unix_time_s: float = 0.0
