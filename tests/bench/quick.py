"""Runs the short form of a benchmark as `scripts/bench/all --quick` does."""

from __future__ import annotations

import json
import subprocess
import sys

from scripts.bench.record import REPO


def played(folder, name, *arguments):
    """Run a benchmark; return its document, which it wrote into the folder, and its output."""
    path = folder / f"{name}.json"
    command = [sys.executable, "-m", f"scripts.bench.{name}", "--quick", "--json", path, *arguments]
    finished = subprocess.run(command, cwd=REPO, capture_output=True, text=True, timeout=240, check=False)
    assert finished.returncode == 0, finished.stdout + finished.stderr
    document = json.loads(path.read_text())
    assert {"date", "python", "machine", "cpu_count", "load_average"} <= set(document["conditions"])
    return document, finished.stdout
