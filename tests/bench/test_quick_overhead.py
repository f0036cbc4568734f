"""The short form of the benchmark of arpd's own cost, with every process real."""

import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed")
pytest.importorskip("pyroute2", reason="pyroute2 is not installed")

from scripts.netns.simlink import available
from tests.bench.quick import played

WORKS, WHY_NOT = available()
pytestmark = [pytest.mark.ros, pytest.mark.link, pytest.mark.skipif(not WORKS, reason=f"no link here: {WHY_NOT}")]


def test_the_short_form_measures_everything(tmp_path):
    """Twelve topics at rest, carried and paced: each with CPU, memory and bytes of run and peer, and nothing typed."""
    document, printed = played(tmp_path, "overhead")
    (case,) = document["cases"]
    assert [span["phase"] for span in case["spans"]] == ["rest without", "rest", "load", "paced"]
    for span in case["spans"][1:]:
        assert span["cpu_share"]["run"] > 0 < span["cpu_share"]["peer"]
        assert span["rss_bytes"]["run"] > 30e6
        assert span["control_bytes_per_second"]["probes"] > 0 < span["control_bytes_per_second"]["reports"]
    assert "CPU of run and peer with 12 topics" in printed
