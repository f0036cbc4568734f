"""The short forms of benchmarks without ROS run to their end, and leave sound documents."""

from tests.bench.quick import played


def test_estimate(tmp_path):
    """A walk and two cells of the grid: arpd and the bound deliver, and the fluid controller carries."""
    document, output = played(tmp_path, "estimate", "--only", "walk,grid", "--seeds", "1", "--grid", "2")
    ((_, ways),) = document["scenarios"].items()
    assert set(ways) == {"arpd", "bound", "fluid"}
    assert all(ways[way][0]["goodput"] > 0.0 for way in ("arpd", "bound"))
    assert all(every[0]["carried"] > 0.0 for every in ways.values())
    assert ways["bound"][0]["utilisation"] == 1.0
    assert "| walk, samples lost beyond the bound's | ≤ 0 |" in output
    assert len(document["grid"]) == 2
    assert all(cell["cell"] in output for cell in document["grid"])


def test_estimate_of_a_fall(tmp_path):
    """The estimate follows the link."""
    document, _ = played(tmp_path, "estimate", "--only", "fall 20 to 5", "--way", "arpd", "--seeds", "1")
    ((name, ways),) = document["scenarios"].items()
    assert (name, set(ways)) == ("fall 20 to 5", {"arpd"})
    assert ways["arpd"][0]["reaction, estimate"] < 10.0


def test_fleet(tmp_path):
    """Two robots share a channel like the oracle's, and still have it when their coordinator dies."""
    picture = tmp_path / "fleet.png"
    document, output = played(tmp_path, "fleet", "--plot", picture)
    runs = {(run["case"], run["side"]): run for run in document["runs"]}
    assert set(runs) == {("4 alike", "fleet"), ("4 alike", "oracle"), ("killed", "fleet")}
    assert all(min(run["goodputs"]) > 0 for run in runs.values())
    assert runs["4 alike", "oracle"]["jain"] > 0.95
    assert "| Jain's index of airtime, 4 alike | ≥ 0.980 |" in output
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_http_load(tmp_path):
    """Under every load the daemon ticks, and answers its scraper."""
    document, output = played(tmp_path, "http_load")
    assert all(each["ticks"] > 0 for each in document["loads"].values())
    assert all(each["scrapes"] > 0 for name, each in document["loads"].items() if "no scraper" not in name)
    assert all(name in output for name in document["loads"])


def test_solve(tmp_path):
    """Ours solve every instance, many times as fast as the paper's way, in little memory and without cvxpy."""
    document, output = played(tmp_path, "solve", "--plot", tmp_path / "solve.png")
    assert [race["topics"] for race in document["races"]] == [1, 12]
    for race in document["races"]:
        spent_s, wrong = race["median_s"], race["failed_or_wrong"]
        assert not any(count for name, count in wrong.items() if name != "cvxpy, built anew")
        assert spent_s["cvxpy, built anew"] >= 40 * max(spent_s["OSQP, direct"], spent_s["exact"])
    for name, found in document["footprints"].items():
        assert found["loads_cvxpy"] == (name == "cvxpy")
        assert found["loads_cvxpy"] or found["peak_rss_bytes"] <= 60 * 2**20
    assert "exact, whole numbers" in output
    assert (tmp_path / "solve.png").read_bytes().startswith(b"\x89PNG")
