"""The short form of the benchmark of arpd's own cost, with every process real."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed")
pytest.importorskip("pyroute2", reason="pyroute2 is not installed")

from arpd.sim.simlink import available

WORKS, WHY_NOT = available()
REPO = Path(__file__).parents[2]
pytestmark = [pytest.mark.ros, pytest.mark.link, pytest.mark.skipif(not WORKS, reason=f"no link here: {WHY_NOT}")]


def test_the_short_form_measures_everything(tmp_path):
    """Twelve topics at rest, carried and paced: each with CPU, memory and bytes of run and peer, and nothing typed."""
    kept = tmp_path / "overhead.json"
    done = subprocess.run(
        [sys.executable, "scripts/bench/overhead.py", "--quick", "--json", str(kept)],
        cwd=REPO,
        capture_output=True,
        text=True,
        timeout=240,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    (case,) = json.loads(kept.read_text())["cases"]
    assert [span["phase"] for span in case["spans"]] == ["rest without", "rest", "load", "paced"]
    for span in case["spans"][1:]:
        assert span["cpu_share"]["run"] > 0 < span["cpu_share"]["peer"]
        assert span["rss_bytes"]["run"] > 30e6
        assert span["control_bytes_per_second"]["probes"] > 0 < span["control_bytes_per_second"]["reports"]
    assert "CPU of run and peer with 12 topics" in done.stdout
