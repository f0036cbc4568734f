"""The short forms of the older benchmarks run to their end, and what they leave is sound."""

import pytest

from scripts.bench.exposition import ARPD, FORMATS, LIBRARY
from scripts.bench.exposition_report import markdown as exposition_text
from scripts.bench.soak import QUICK_SWAPS, TOPICS
from scripts.bench.soak_report import markdown as soak_text
from scripts.netns.simlink import available
from tests.bench.quick import played

CAN, WHY = available()


def test_estimate(tmp_path):
    """One fall, arpd and the oracle: both deliver, and the estimate follows the link."""
    document, _ = played(tmp_path, "estimate", "--only", "fall 20 to 5", "--seeds", "1")
    ((_, ways),) = document["scenarios"].items()
    assert set(ways) == {"arpd", "oracle"}
    assert all(every[0]["goodput"] > 0.0 for every in ways.values())
    assert ways["arpd"][0]["reaction, estimate"] < 10.0
    assert document["targets"]


def test_exposition(tmp_path):
    """Both encoders write, and a daemon under scrapers ticks and answers."""
    document, _ = played(tmp_path, "exposition")
    for race in document["races"]:
        assert all(race["median_s"][form][side] > 0.0 for form in FORMATS for side in (ARPD, LIBRARY))
    assert all(found["ticks"] > 0 for found in document["ticking"]["by_scrapers"].values())
    assert document["ticking"]["by_scrapers"]["4"]["scrapes"] > 0
    assert "ticks began late" in exposition_text(document)


@pytest.mark.link
@pytest.mark.ros
@pytest.mark.skipif(not CAN, reason=WHY)
def test_soak(tmp_path):
    """Hundreds of swaps on a link that loses nothing: every topic goes on to its last sample, and none is lost."""
    pytest.importorskip("rclpy", reason="ROS 2 is not installed")
    document, _ = played(tmp_path, "soak")
    assert document["notes"][-1]["swaps"] == QUICK_SWAPS
    assert document["received"] == [document["sent"]] * TOPICS
    assert sum(document["late"]) == 0
    assert f"{QUICK_SWAPS} swaps" in soak_text(document)
