"""A saved status document (`arpd status --json > robot.json`), read as publishers with what the daemon measured."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from arpd.model.endpoints import Direction, PublisherState
from arpd.model.errors import ArpdError, UsageError
from arpd.model.quantities import printable

if TYPE_CHECKING:
    from pathlib import Path

_MAX_BYTES = 16 * 2**20
_HIGHEST = 1e12  # above any real payload (bytes), rate (Hz) or period (ns); keeps nonsense finite
_DIRECTIONS = tuple(str(direction) for direction in Direction)


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
    try:
        document = json.loads(_text(path))
    except (ValueError, RecursionError):  # ValueError: not JSON, not UTF-8, or a number too long to convert
        raise _refused(path, "is not JSON") from None
    if not isinstance(document, dict) or "api_version" not in document:
        raise _refused(path, "is not a status of arpd")
    rows = document.get("topics")
    if rows is None:
        raise _refused(path, "was saved before the daemon was ready")
    if not isinstance(rows, list):
        raise _refused(path, "topics: is not a list")
    return SavedStatus(
        publishers=tuple(_publisher(row, f"topics[{index}]", path) for index, row in enumerate(rows)),
        sensing_topics=_crossing(document, "sensing_topics", path),
        actuation_topics=_crossing(document, "actuation_topics", path),
    )


def _crossing(document: dict[str, Any], key: str, path: Path) -> int:
    """Return a count of the graph; 0 from a daemon that did not say it."""
    graph = document.get("graph", {})
    count = graph.get(key, 0) if isinstance(graph, dict) else graph
    if isinstance(count, bool) or not isinstance(count, int) or not 0 <= count <= _HIGHEST:
        raise _refused(path, f"graph.{key}: {_shown(count)} is not a number of topics")
    return count


def _text(path: Path) -> bytes:
    name = printable(str(path), longest=4096)
    try:
        with path.open("rb") as file:
            text = file.read(_MAX_BYTES + 1)
    except (OSError, ValueError) as error:  # ValueError: a NUL in the path
        reason = getattr(error, "strerror", None) or error
        raise UsageError(f"--status {name} cannot be read ({reason}); save it with arpd status --json > FILE") from None
    if not text:
        raise _refused(path, "is empty")
    if len(text) > _MAX_BYTES:
        raise _refused(path, "is larger than 16 MiB")
    return text


def _publisher(row: Any, where: str, path: Path) -> PublisherState:
    if not isinstance(row, dict):
        raise _refused(path, f"{where}: is not a publisher")

    def text(key: str) -> str:
        value = row.get(key)
        if not isinstance(value, str):
            raise _refused(path, f"{where}.{key}: {_shown(value)} is not text")
        return value

    def number(key: str) -> float:
        value = row.get(key)
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value <= _HIGHEST:
            raise _refused(path, f"{where}.{key}: {_shown(value)} is not a number of 0 to {_HIGHEST:g}")
        return float(value)

    direction = text("direction")
    if direction not in _DIRECTIONS:
        raise _refused(path, f"{where}.direction: {_shown(direction)} is none of {', '.join(_DIRECTIONS)}")
    return PublisherState(
        node=text("node"),
        topic=text("topic"),
        type_name="",
        direction=Direction(direction),
        payload_bytes=number("payload_bytes"),
        source_rate_hz=number("source_rate_hz"),
        remote_readers=int(number("remote_readers")),
        requested_deadline_ns=0 if row.get("requested_deadline_ns") is None else int(number("requested_deadline_ns")),
        # The plan of that time does not matter for a new one.
        depth=1,
        baseline_depth=1,
    )


def _shown(value: Any) -> str:
    return printable(json.dumps(value))


def _refused(path: Path, wrong: str) -> ArpdError:
    name = printable(str(path), longest=4096)
    return ArpdError(f"{name}: {wrong}; save it on the robot with arpd status --json > {name}")
