"""A saved status document (`arpd status --json > robot.json`), read as publishers with what the daemon measured."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from arpd.model.endpoints import Direction, PublisherState
from arpd.model.errors import ArpdError, UsageError
from arpd.model.quantities import printable

if TYPE_CHECKING:
    from pathlib import Path

_MAX_BYTES = 16 * 2**20
# Above any real payload (bytes), rate (Hz) or period (ns); keeps nonsense finite.
_Amount = Annotated[float, Field(ge=0, le=1e12, allow_inf_nan=False)]
_Count = Annotated[int, Field(ge=0, le=10**12)]
_STRICT = ConfigDict(strict=True)


class _Publisher(BaseModel):
    model_config = _STRICT
    direction: Direction
    topic: str
    node: str
    payload_bytes: _Amount
    source_rate_hz: _Amount
    remote_readers: _Count
    requested_deadline_ns: _Count = 0


class _Topic(BaseModel):
    model_config = _STRICT
    confirmed: _Publisher


class _Document(BaseModel):
    model_config = _STRICT
    api_version: str
    topics: list[_Topic] | None = None
    sensing_topics: _Count = 0
    actuation_topics: _Count = 0


@dataclass(frozen=True, kw_only=True, slots=True)
class SavedStatus:
    """Content of a status document that a plan needs.

    Parameters
    ----------
    publishers : with what the daemon measured; other fields are neutral
    sensing_topics, actuation_topics : topics that cross the link, managed or not
    """

    publishers: tuple[PublisherState, ...] = ()
    sensing_topics: int = 0
    actuation_topics: int = 0


def read_status(path: Path) -> SavedStatus:
    """Return what the daemon had measured.

    Raises
    ------
    UsageError
        If the file cannot be read.
    ArpdError
        If it is not a status document of a daemon that was ready.
    """
    name = printable(str(path), longest=4096)
    try:
        with path.open("rb") as file:
            text = file.read(_MAX_BYTES)
    except (OSError, ValueError) as error:  # ValueError: a NUL in the path
        reason = getattr(error, "strerror", None) or error
        raise UsageError(f"--status {name} cannot be read ({reason}); save it with arpd status --json > FILE") from None
    save = f"save it on the robot with arpd status --json > {name}"
    try:
        document = _Document.model_validate_json(text)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = ".".join(map(str, first["loc"])) or "file"
        raise ArpdError(f"{name}: is no status of arpd ({where}: {printable(first['msg'])}); {save}") from None
    if document.topics is None:
        raise ArpdError(f"{name}: was saved before the daemon was ready; {save}")
    return SavedStatus(
        publishers=tuple(_publisher(topic.confirmed) for topic in document.topics),
        sensing_topics=document.sensing_topics,
        actuation_topics=document.actuation_topics,
    )


def _publisher(row: _Publisher) -> PublisherState:
    return PublisherState(
        node=row.node,
        topic=row.topic,
        type_name="",
        direction=row.direction,
        payload_bytes=row.payload_bytes,
        source_rate_hz=row.source_rate_hz,
        remote_readers=row.remote_readers,
        requested_deadline_ns=row.requested_deadline_ns,
        # The plan of that time does not matter for a new one.
        depth=1,
        baseline_depth=1,
    )
