"""The Fast DDS profile of this process: arpd needs short heartbeats, and parts that fit a packet."""

from __future__ import annotations

import os
import threading
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from arpd.ros.runtime import FASTDDS_PROFILE, PROFILE_VARIABLE

if TYPE_CHECKING:
    from collections.abc import Mapping

_INSTALLED = Path("/usr/share/arpd/fastdds.xml")  # by the Debian package
_IN_FOLDER = "DEFAULT_FASTRTPS_PROFILES.xml"  # Fast DDS reads it, too
# A transport has an element for its size of messages, writers and participants a property.
_SETTINGS = {
    "heartbeat period": ["<heartbeatPeriod>"],
    "size of messages": ["maxMessageSize", "fastdds.max_message_size"],
}
_WITHOUT = (
    "this process publishes without arpd's Fast DDS profile ({why}): swaps take longer, and a link that loses packets "
    "loses most large samples; set it before the process starts: {line}"
)
_warned = threading.Lock()  # held for good by the first that warns


def profile_line() -> str:
    """Return the line of a shell that gives the profile to processes started after it."""
    return f"export {PROFILE_VARIABLE}={_INSTALLED if os.access(_INSTALLED, os.R_OK) else FASTDDS_PROFILE}"


def missing_in_profile(environment: Mapping[str, str], *, folder: Path) -> str:
    """Return what the profiles that Fast DDS reads in a folder do not set, in words; empty if they set all.

    A profile of the user's own is as good as arpd's if it has both settings, whatever their values.
    """
    named = environment.get(PROFILE_VARIABLE, "")
    read = {path: text for path in (Path(named), folder / _IN_FOLDER) if (text := _text(path))}
    if not read:
        return f"{named} cannot be read" if named else f"{PROFILE_VARIABLE} is not set"
    wanting = [words for words, names in _SETTINGS.items() if not any(map("\n".join(read.values()).count, names))]
    return f"{next(iter(read))} sets no {' and no '.join(wanting)}" if wanting else ""


@cache
def missing_here() -> str:
    """Return what the profiles of this process do not set; Fast DDS reads them once."""
    return missing_in_profile(os.environ, folder=Path())  # the working directory, which may be gone


def warn_once(logger: Any, missing: str) -> None:
    """Say once per process what `missing_in_profile` returned, if anything, and the line that mends it."""
    if missing and _warned.acquire(blocking=False):
        logger.warning(_WITHOUT.format(why=missing, line=profile_line()))


def _text(path: Path) -> str:
    try:
        return path.read_text(errors="replace")
    except (OSError, ValueError):
        return ""
