"""Targets of `fuzz.py`, and the promises of the code under test.

A target's `load` imports the code under test, so that a fuzzer can instrument it first. An exception of its function is
a crash, except for the refusals that it catches; a broken promise is a crash too.
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
    """The code under test returned a value that it promises never to return."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Fuzzable:
    """Code under test, imported.

    Parameters
    ----------
    feed : takes any bytes; an exception is a crash
    seeds : inputs to start from
    words : likely pieces of inputs
    """

    feed: Callable[[bytes], None]
    seeds: tuple[bytes, ...]
    words: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True, slots=True)
class Target:
    """One reader of outside input.

    Parameters
    ----------
    load : imports the code under test
    most_bytes : longest input
    """

    load: Callable[[], Fuzzable]
    most_bytes: int = 4096


def memory_file() -> Path:
    """Return the path of a file in memory that lives as long as the process."""
    folder = "/dev/shm" if Path("/dev/shm").is_dir() else None  # a disk would take most of the time
    return Path(tempfile.mkdtemp(prefix="arpd-fuzz-", dir=folder)) / "input"


def insist(holds: bool, promise: str) -> None:  # noqa: FBT001 - the promise names it
    if not holds:
        raise BrokenPromiseError(promise)
