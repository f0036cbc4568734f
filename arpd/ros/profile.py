"""Judges the Fast DDS profile of this process: arpd needs short heartbeats, and parts that fit a packet."""

from __future__ import annotations

import os
import threading
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree as ET

from arpd.ros.runtime import FASTDDS_PROFILE, PROFILE_VARIABLES

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

INSTALLED_PROFILE = Path("/usr/share/arpd/fastdds.xml")
_IN_FOLDER = ("DEFAULT_FASTDDS_PROFILES.xml", "DEFAULT_FASTRTPS_PROFILES.xml")  # Fast DDS reads these, too
_LONGEST_HEARTBEAT_S = 0.5
_MOST_MESSAGE_BYTES = 1472  # with UDP and IP an Ethernet packet
_WITHOUT = (
    "this process publishes without arpd's Fast DDS profile ({why}): swaps take longer, and a link that loses packets "
    "loses most large samples; set it before the process starts: {line}"
)
_warned = threading.Lock()  # held for good by the first that warns


def profile_line(installed: Path = INSTALLED_PROFILE) -> str:
    """Return the line of a shell that gives the profile to processes started after it.

    Parameters
    ----------
    installed : path that the Debian package has; the file beside this module serves where it is missing
    """
    return f"export {PROFILE_VARIABLES[0]}={installed if os.access(installed, os.R_OK) else FASTDDS_PROFILE}"


def missing_in_profile(environment: Mapping[str, str], *, folder: Path) -> str:
    """Return what the profiles that Fast DDS reads do not set, in words; empty if they set all.

    A profile of the user's own is as good as arpd's if it has both settings.

    Parameters
    ----------
    environment, folder : environment and working directory of the process
    """
    named = [Path(environment[name]) for name in PROFILE_VARIABLES if environment.get(name)]
    read = {path: root for path in (*named, *map(folder.joinpath, _IN_FOLDER)) if (root := _parsed(path)) is not None}
    if not read:
        return f"{named[0]} cannot be read" if named else f"{PROFILE_VARIABLES[0]} is not set"
    wanting = []
    if not any(_period_s(each) <= _LONGEST_HEARTBEAT_S for each in _all(read, "heartbeatPeriod")):
        wanting.append(f"no heartbeat period up to {_LONGEST_HEARTBEAT_S:g} s")
    if not any(size <= _MOST_MESSAGE_BYTES for size in _message_sizes(read)):
        wanting.append(f"no messages up to {_MOST_MESSAGE_BYTES} bytes")
    return f"{next(iter(read))} sets {' and '.join(wanting)}" if wanting else ""


@cache
def missing_here() -> str:
    """Return what the profiles of this process do not set; Fast DDS reads them once."""
    return missing_in_profile(os.environ, folder=Path())  # the working directory, which may be gone


def warn_once(logger: Any, missing: str) -> None:
    """Say once per process what is missing, and the line that mends it.

    Parameters
    ----------
    logger : logger of a node
    missing : what `missing_in_profile` returned; nothing is said if it is empty
    """
    if missing and _warned.acquire(blocking=False):
        logger.warning(_WITHOUT.format(why=missing, line=profile_line()))


def _parsed(path: Path) -> ET.Element | None:
    try:
        return ET.fromstring(path.read_bytes())  # noqa: S314 - the user's own file, which Fast DDS reads, too
    except (OSError, ValueError, LookupError, ET.ParseError):  # also an encoding that nobody knows
        return None


def _all(read: Mapping[Path, ET.Element], name: str) -> Iterator[ET.Element]:
    """Yield all elements of a name, whatever their namespace."""
    for root in read.values():
        yield from root.iterfind(f".//{{*}}{name}")


def _number(text: str | None) -> float:
    """Return a number; infinite where it is none, such as DURATION_INFINITY."""
    try:
        return float(text or "inf")
    except ValueError:
        return float("inf")


def _period_s(period: ET.Element) -> float:
    """Return a DurationType (s)."""
    return _number(period.findtext("{*}sec", "0")) + _number(period.findtext("{*}nanosec", "0")) / 1e9


def _message_sizes(read: Mapping[Path, ET.Element]) -> Iterator[float]:
    """Yield the limits of RTPS messages: transports have an element, writers and participants a property."""
    for element in _all(read, "maxMessageSize"):
        yield _number(element.text)
    for each in _all(read, "property"):
        if (each.findtext("{*}name") or "").strip() == "fastdds.max_message_size":
            yield _number(each.findtext("{*}value"))
