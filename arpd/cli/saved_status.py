"""A saved status document (`arpd status --json > robot.json`): what the daemon measured, to plan for."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from pydantic import ValidationError

from arpd.model.endpoints import PublisherState
from arpd.model.errors import ArpdError, UsageError
from arpd.model.quantities import printable
from arpd.web.json_text import read

if TYPE_CHECKING:
    from pathlib import Path

_MOST_BYTES = 16 * 2**20
_MOST = 1e12  # above any real payload (bytes), rate (Hz) or period (ns); keeps nonsense finite
NESTED = (Mapping, PublisherState)  # who reads a document finds them here


@dataclass(frozen=True, kw_only=True, slots=True)
class SavedTopic:
    """One publisher."""

    confirmed: PublisherState


@dataclass(frozen=True, kw_only=True, slots=True)
class SavedStatus:
    """The keys of a status document that a plan needs, so that one of an older arpd can be read, too."""

    api_version: str = ""
    topics: tuple[SavedTopic, ...] | None = None
    sensing_topics: int = 0
    actuation_topics: int = 0

    @property
    def publishers(self) -> list[PublisherState]:
        """What the daemon measured; the plan of that time does not matter for a new one."""
        return [topic.confirmed for topic in self.topics or ()]


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
            text = file.read(_MOST_BYTES)
    except (OSError, ValueError) as error:  # ValueError: a NUL in the path
        reason = getattr(error, "strerror", None) or error
        raise UsageError(f"--status {name} cannot be read ({reason}); save it with arpd status --json > FILE") from None
    try:
        status = read(SavedStatus, json.loads(text))
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        wrong = f"{'.'.join(map(str, first['loc'])) or 'file'}: {printable(first['msg'])}"
    except (ValueError, RecursionError) as error:
        wrong = f"file: {printable(str(error))}"
    else:
        if status.topics is None:
            raise ArpdError(f"{name}: was saved before the daemon was ready; {_save(name)}")
        numbers: list[float] = [status.sensing_topics, status.actuation_topics]
        for each in status.publishers:
            numbers += [each.payload_bytes, each.source_rate_hz, each.remote_readers, each.requested_deadline_ns]
        if all(0 <= number <= _MOST for number in numbers):
            return status
        wrong = "it has an impossible number"
    raise ArpdError(f"{name}: is no status of arpd ({wrong}); {_save(name)}")


def _save(name: str) -> str:
    return f"save it on the robot with arpd status --json > {name}"
