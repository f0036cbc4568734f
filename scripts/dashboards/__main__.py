"""Write the Grafana dashboards, or check that the files are up to date.

Usage: .venv/bin/python -m scripts.dashboards [--check]

The JSON in etc/grafana/dashboards is what Grafana reads and what is committed. This script makes it because three
thousand lines of JSON hide what the panels have in common.
"""

from __future__ import annotations

import argparse
import sys

from scripts.dashboards.document import FOLDER, as_json
from scripts.dashboards.fleet import fleet
from scripts.dashboards.robot import robot


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m scripts.dashboards", description="Write the Grafana dashboards.")
    parser.add_argument("--check", action="store_true", help="write nothing; exit 1 if a file is out of date")
    is_check = parser.parse_args().check
    stale = 0
    for document in (robot(), fleet()):
        path, text = FOLDER / f"{document['uid']}.json", as_json(document)
        if path.is_file() and path.read_text(encoding="utf-8") == text:
            continue
        if is_check:
            stale += 1
            print(f"{path} is out of date; run `python -m scripts.dashboards` and commit", file=sys.stderr)
        else:
            path.write_text(text, encoding="utf-8")
            print(path)
    return 1 if stale else 0


if __name__ == "__main__":
    sys.exit(main())
