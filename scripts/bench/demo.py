"""`scripts/demo --quick`, recorded for docs/results.md.

Usage: .venv/bin/python scripts/bench/demo.py [--quick] [--json FILE]

The demo is two minutes long whether this is quick or not; with --quick its document is kept only where --json says.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from arpd.cli.progress import progress
from scripts.bench.demo_report import markdown
from scripts.bench.record import REPO, conditions, keep, target
from scripts.robot.demo import QUICK


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="keep nothing unless --json names a file")
    parser.add_argument("--json", type=Path, metavar="FILE", help="default results/demo.json")
    options = parser.parse_args()
    document: dict[str, Any] = {"conditions": conditions(), "schedule": QUICK}
    with progress("the robot without arpd and with it, two minutes"):
        played = subprocess.run(
            [REPO / "scripts/demo", "--quick", "--json"], stdout=subprocess.PIPE, text=True, check=False
        )
    if played.returncode:
        sys.exit(played.returncode)
    document |= json.loads(played.stdout)
    if not all(topic["with"]["received"] for topic in document["topics"]):
        sys.exit("demo: nothing arrived on some topic with arpd")
    print(markdown(document))
    keep(document, target(options.json, "demo.json", is_partial=options.quick))


if __name__ == "__main__":
    main()
