"""Record `scripts/demo --quick` for docs/results.md.

Usage: .venv/bin/python scripts/bench/demo.py [--quick] [--json FILE]

The demo takes two minutes with or without --quick. With --quick, its document goes only to the file of --json.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from arpd.cli.progress import progress
from scripts.bench.demo_report import markdown
from scripts.bench.record import REPO, conditions, keep, options_of
from scripts.robot.demo import QUICK


def main() -> None:
    options = options_of(__doc__, "demo", quick="write nothing unless --json names a file").parse_args()
    document: dict[str, Any] = {"conditions": conditions(), "schedule": QUICK}
    with progress("the robot without arpd and with it, two minutes"):
        command = [str(REPO / "scripts/demo"), "--quick", "--json"]
        played = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=False)
    if played.returncode:
        sys.exit(played.returncode)
    document |= json.loads(played.stdout)
    if not all(topic["with"]["received"] for topic in document["topics"]):
        sys.exit("demo: nothing arrived on some topic with arpd")
    print(markdown(document))
    keep(document, options, "demo", is_partial=options.quick)


if __name__ == "__main__":
    main()
