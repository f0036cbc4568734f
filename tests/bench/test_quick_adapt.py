"""The quick form of the benchmark of adaptation, as CI runs it: real rclpy over a real, if short-lived, link."""

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from scripts.netns.simlink import available
from tests.bench.quick import played

CAN, WHY = available()
pytestmark = [pytest.mark.link, pytest.mark.ros, pytest.mark.skipif(not CAN, reason=WHY)]
PLAIN, MANAGED = "defaults", "arpd"


def test_the_quick_form_measures_both_sides_of_a_step_down(tmp_path):
    """Two robots meet a step down; every topic arrives, arpd withholds and swaps, and both pictures of it are there."""
    found, picture = tmp_path / "adapt.json", tmp_path / "adapt.png"
    document, printed = played(tmp_path, "adapt", "--plot", picture)
    runs = {run["side"]: run for run in document["runs"]}
    assert runs.keys() == {PLAIN, MANAGED}
    for run in runs.values():
        assert len(run["topics"]) == 12
        assert all(topic["received"] > 0 for topic in run["topics"].values())
        assert len(run["ages_over_time_s"]) >= 10
    assert runs[PLAIN]["cpu"].keys() == {"sources", "machine"}
    assert runs[MANAGED]["cpu"].keys() == {"run", "relay", "peer", "sources", "machine"}
    assert runs[PLAIN]["all"]["withheld_ratio"] == 0.0 == runs[PLAIN]["swaps"]
    assert runs[MANAGED]["all"]["withheld_ratio"] > 0.0
    assert picture.read_bytes().startswith(b"\x89PNG")
    for text in (str(found), str(picture), "defaults", "arpd"):
        assert text in printed
