"""What the models share: where their values come from, their kinds of numbers, and a line of the decision log."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import AliasPath, BaseModel, BeforeValidator, ConfigDict, Field

from arpd.model.quantities import shortened
from arpd.report.conditions import Severity

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

API_VERSION: Literal["v1"] = "v1"


def _measured(value: Any) -> Any:
    """Return a value in five digits, None for what JSON cannot say."""
    if not isinstance(value, float):
        return value
    return shortened(value) if math.isfinite(value) else None


def _time(value: Any) -> Any:
    """Return a time or an age, whose digits before the point count, too."""
    if not isinstance(value, float):
        return value
    return round(value, 3) if math.isfinite(value) else None


Count = Annotated[int, Field(ge=0)]
Amount = Annotated[float, Field(ge=0)]
Ratio = Annotated[float, Field(ge=0, le=1)]
Measured = Annotated[Amount | None, BeforeValidator(_measured)]
Kept = Annotated[Ratio, BeforeValidator(_measured)]
MeasuredRatio = Annotated[Ratio | None, BeforeValidator(_measured)]
Age = Annotated[Amount | None, BeforeValidator(_time)]
Time = Annotated[float, BeforeValidator(_time)]
Offset = Annotated[float | None, BeforeValidator(lambda offset: offset and round(offset, 6))]
Period = Annotated[Count | None, BeforeValidator(lambda value: value or None)]
Counts = Annotated[dict[str, Count], BeforeValidator(lambda counts: dict(sorted(counts.items())))]
Seconds = Annotated[dict[str, Amount], BeforeValidator(lambda times: dict(sorted(times.items())))]


def of(path: str, **options: Any) -> Any:
    """Return the field of a key that comes from another attribute than that of its name; None on the way is null."""
    return Field(validation_alias=AliasPath(*path.split(".")), **options)


class Part(BaseModel):
    """An object of a document, from an object of the daemon or from JSON; a key's docstring is its description."""

    model_config = ConfigDict(
        use_attribute_docstrings=True,
        from_attributes=True,
        populate_by_name=True,
        json_schema_serialization_defaults_required=True,
    )


class Event(Part):
    """One line of the decision log."""

    number: Count
    """Number of the line, from 1 at the start of the daemon."""
    unix_time_seconds: Time = of("unix_time_s")
    """Wall clock of the event (Unix time, s)."""
    event: str = of("kind")
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


def with_topics(head: Part, topics: Iterable[Part]) -> Iterator[bytes]:
    """Yield a document as JSON, its topics last and one by one, so that a tick that is due can begin in between.

    Parameters
    ----------
    head : the document without topics
    """
    yield f'{head.model_dump_json(exclude={"topics"})[:-1]},"topics":['.encode()
    for number, topic in enumerate(topics):
        yield f"{',' if number else ''}{topic.model_dump_json()}".encode()
    yield b"]}\n"
