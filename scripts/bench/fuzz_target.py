"""What `fuzz.py` can feed with bytes, and what the code under test promises.

A target's `load` imports the code under test, so that a fuzzer can instrument it first. What its function raises, apart
from the refusals named there, is a crash; so is an answer that breaks what the target says of it.
"""

from __future__ import annotations

import re
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

FAULT = re.compile(r"[^\n]+?:[1-9]\d*:[1-9]\d*: [^ \n][^\n]*?: [^\n]+; [^\n]+")


class BrokenPromiseError(Exception):
    """The code under test did not raise, and returned what it promises never to return."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Fuzzable:
    """Code under test, imported.

    Parameters
    ----------
    feed : takes any bytes and returns; whatever it raises is a crash
    seeds : inputs to start from
    words : pieces that inputs are likely made of
    """

    feed: Callable[[bytes], None]
    seeds: tuple[bytes, ...]
    words: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True, slots=True)
class Target:
    """One reader of foreign input.

    Parameters
    ----------
    what : for people
    load : imports it
    most_bytes : longest input
    """

    what: str
    load: Callable[[], Fuzzable]
    most_bytes: int = 4096


def memory_file() -> Path:
    """Return the path of a file in memory that lives as long as the process."""
    folder = "/dev/shm" if Path("/dev/shm").is_dir() else None  # a disk would be what is measured
    return Path(tempfile.mkdtemp(prefix="arpd-fuzz-", dir=folder)) / "input"


def insist(holds: bool, promise: str) -> None:  # noqa: FBT001 - the promise says what
    if not holds:
        raise BrokenPromiseError(promise)
