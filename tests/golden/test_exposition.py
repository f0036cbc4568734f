"""The whole exposition against a file, which ``ARPD_REGENERATE_GOLDEN=1`` rewrites."""

from __future__ import annotations

import difflib
import os
import re
import subprocess
from pathlib import Path

from prometheus_client import CollectorRegistry, generate_latest

from arpd.daemon.run import new_durations
from arpd.web.access import HttpCounts
from arpd.web.metrics import SnapshotCollector
from tests.golden.sample import FINISHED_AT_S

GOLDEN = Path(__file__).with_name("exposition.txt")


def exposition(snapshot) -> str:
    registry, durations = CollectorRegistry(), new_durations()
    registry.register(SnapshotCollector(lambda: snapshot, clock=lambda: FINISHED_AT_S + 0.25))
    HttpCounts(registry)
    seen_s = ((0.0078125, 3.0), (0.0, 0.0625), (0.000125,))
    for histogram, observed_s in zip(durations.values(), seen_s, strict=True):
        registry.register(histogram)
        for each_s in observed_s:
            histogram.observe(each_s)
    build = 'arpd_build_info{python="3.11.0",version="1.2.3"}'
    return re.sub(r"arpd_build_info{.*}", build, generate_latest(registry).decode())


def test_the_exposition_is_the_golden_file(sample_snapshot):
    """One snapshot gives exactly the text in the golden file."""
    got = exposition(sample_snapshot)
    if os.environ.get("ARPD_REGENERATE_GOLDEN") == "1":
        GOLDEN.write_text(got)
    wanted = GOLDEN.read_text()
    diff = difflib.unified_diff(wanted.splitlines(), got.splitlines(), "golden", "got", lineterm="")
    assert got == wanted, "\n".join(diff)


def test_promtool_finds_nothing_to_complain_about(promtool):
    """Prometheus's promtool accepts the golden file, which also has the metrics of a relay with two ends."""
    with GOLDEN.open() as text:
        checked = subprocess.run(
            [promtool, "check", "metrics"], stdin=text, capture_output=True, text=True, check=False
        )
    assert (checked.returncode, checked.stdout + checked.stderr) == (0, "")
