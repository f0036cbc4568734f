"""The short forms of benchmarks without ROS run to their end, and leave sound documents."""

from scripts.bench.exposition import ARPD, FORMATS, LIBRARY
from tests.bench.quick import played


def test_estimate(tmp_path):
    """A walk and two cells of the grid: arpd and the bound deliver, and the fluid controller carries."""
    document, output = played(tmp_path, "estimate", "--only", "walk,grid", "--seeds", "1", "--grid", "2")
    ((_, ways),) = document["scenarios"].items()
    assert set(ways) == {"arpd", "bound", "fluid"}
    assert all(ways[way][0]["goodput"] > 0.0 for way in ("arpd", "bound"))
    assert all(every[0]["carried"] > 0.0 for every in ways.values())
    assert ways["bound"][0]["utilisation"] == 1.0
    assert {"walk, samples lost beyond the bound's: <= 0"} < {target["target"] for target in document["targets"]}
    assert len(document["grid"]) == 2
    assert all(cell["cell"] in output for cell in document["grid"])


def test_estimate_of_a_fall(tmp_path):
    """The estimate follows the link."""
    document, _ = played(tmp_path, "estimate", "--only", "fall 20 to 5", "--way", "arpd", "--seeds", "1")
    ((name, ways),) = document["scenarios"].items()
    assert (name, set(ways)) == ("fall 20 to 5", {"arpd"})
    assert ways["arpd"][0]["reaction, estimate"] < 10.0


def test_exposition(tmp_path):
    """Both encoders write, and a daemon under scrapers ticks and answers."""
    document, _ = played(tmp_path, "exposition")
    for race in document["races"]:
        assert all(race["median_s"][form][side] > 0.0 for form in FORMATS for side in (ARPD, LIBRARY))
    assert all(found["ticks"] > 0 for found in document["ticking"]["by_scrapers"].values())
    assert document["ticking"]["by_scrapers"]["4"]["scrapes"] > 0
