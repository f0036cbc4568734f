"""What the models share: their base, their kinds of numbers, and a line of the decision log."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

from arpd.report.events import Severity

Count = Annotated[int, Field(ge=0)]
Amount = Annotated[float, Field(ge=0)]
Ratio = Annotated[float, Field(ge=0, le=1)]


class Part(BaseModel):
    """An object of a document; the docstring of a key is its description in the JSON Schema."""

    model_config = ConfigDict(use_attribute_docstrings=True, allow_inf_nan=False)


class Event(Part):
    """One line of the decision log."""

    number: Count
    """Number of the line, from 1 at the start of the daemon."""
    unix_time_seconds: float
    """Wall clock of the event (Unix time, s)."""
    event: str
    """Kind of the event, a value of the label event of arpd_events_total; new kinds may come within v1."""
    severity: Severity
    """Severity: warning is worse than it should be while arpd goes on, error needs a person."""
    text: str
    """One plain sentence without a full stop."""
    topic: str
    """Topic of the event, empty for several or none."""
    node: str
    """Node of the event, empty for several or none."""
    details: dict[str, str]
    """Further facts by lower-case name, for programs."""
