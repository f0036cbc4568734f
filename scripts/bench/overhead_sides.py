"""The two sides of a benchmark: arpd of another revision, and arpd of this tree, each in processes of its own."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from arpd.adapters.ros.runtime import FASTDDS_PROFILE
from arpd.model.errors import ArpdError
from scripts.bench.record import REPO

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

BEFORE, AFTER = "before", "after"


@dataclass(frozen=True, kw_only=True, slots=True)
class Side:
    """One side.

    Parameters
    ----------
    name : `BEFORE` or `AFTER`
    tree : folder with its package arpd
    """

    name: str
    tree: Path = REPO

    def environment(self) -> dict[str, str]:
        """Return the variables that give a process this side's arpd, and this tree's scripts."""
        return {
            # Without the safe path, `-m` would take the arpd of the working directory.
            "PYTHONSAFEPATH": "1",
            "PYTHONPATH": os.pathsep.join(map(str, dict.fromkeys((self.tree, REPO)))),
            "FASTRTPS_DEFAULT_PROFILES_FILE": str(self.tree / FASTDDS_PROFILE.relative_to(REPO)),
        }

    def faults(self, config: dict[str, Any]) -> str:
        """Return what this side's `arpd check` says against a configuration; nothing if it accepts it."""
        with tempfile.NamedTemporaryFile("w", suffix=".yaml") as written:
            json.dump(config, written)  # JSON is YAML
            written.flush()
            command = [sys.executable, "-m", "arpd.cli", "check", "--no-interfaces", written.name]
            env = {**os.environ, **self.environment()}
            checked = subprocess.run(command, env=env, capture_output=True, text=True, check=False)
            return (checked.stderr or checked.stdout).strip() if checked.returncode else ""

    def accepted(self, configs: Sequence[dict[str, Any]], section: str) -> list[dict[str, Any]]:
        """Return configurations without a section that this side does not accept.

        Raises
        ------
        ArpdError
            If it does not accept them without the section either.
        """
        if not self.faults(configs[0]):
            return list(configs)
        shorter = [{key: value for key, value in config.items() if key != section} for config in configs]
        if faults := self.faults(shorter[0]):
            raise ArpdError(f"arpd {self.name} does not accept the configuration: {faults}")
        return shorter


@contextmanager
def side_of(revision: str) -> Iterator[Side]:
    """Extract arpd of a revision into a temporary folder, and yield it as the side `BEFORE`.

    Raises
    ------
    ArpdError
        If git does not know the revision.
    """
    with tempfile.TemporaryDirectory(prefix="arpd-before-") as folder:
        packed = subprocess.run(["git", "archive", revision, "arpd"], cwd=REPO, capture_output=True, check=False)
        if packed.returncode:
            raise ArpdError(f"--before {revision}: {packed.stderr.decode().strip()}")
        # Only the package: scripts and tests of both sides are this tree's.
        subprocess.run(["tar", "--extract", "--directory", folder], input=packed.stdout, check=True)
        yield Side(name=BEFORE, tree=Path(folder))
