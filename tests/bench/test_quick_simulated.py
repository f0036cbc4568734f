"""The short forms of benchmarks without ROS run to their end, and leave sound documents."""

from scripts.bench.exposition import ARPD, FORMATS, LIBRARY
from tests.bench.quick import played


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
