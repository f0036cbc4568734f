"""The quick form of the paper's experiment, with real ROS 2 over the simulated link."""

import pytest

pytest.importorskip("pyroute2", reason="pyroute2 is not installed")
pytest.importorskip("rclpy", reason="ROS 2 is not installed")
pytest.importorskip("matplotlib", reason="matplotlib is not installed")

from scripts.netns.simlink import available
from tests.bench.quick import played

CAN, WHY = available()
pytestmark = [pytest.mark.link, pytest.mark.ros, pytest.mark.skipif(not CAN, reason=f"no simulated link here: {WHY}")]


@pytest.fixture(scope="module")
def document(tmp_path_factory):
    folder = tmp_path_factory.mktemp("paper")
    document, printed = played(folder, "paper", "--plot", folder / "paper.png")
    print(printed)
    assert {path.name for path in folder.iterdir()} == {"paper.json", "paper-latency.png", "paper-loss.png"}
    return document


def test_every_sensor_reaches_the_rate_it_was_told(document):
    """Load generation is not the bottleneck: eleven sensors publish for two seconds at the DEADLINE rate, unblocked."""
    assert len(document["runs"]) == 3
    for run in document["runs"]:
        assert run["void"] == ""
        assert run["reached_ratio"] == pytest.approx(1.0, abs=0.05)
        assert run["sensors_cpu"] > 0 < run["planner_cpu"]


def test_all_that_is_sent_crosses_the_link_and_is_answered(document):
    """More bytes cross than arrive, and commands come back later than their sample reached the planner."""
    for run in document["runs"]:
        assert run["robot_sent_bytes"] > run["sensing"]["count"] * run["payload_bytes"] > 0
        assert run["end_to_end"]["count"] > 0
        assert run["end_to_end"]["p50_s"] > run["sensing"]["p50_s"] > 0


def test_a_deep_history_loses_nothing_on_a_link_that_is_not_full(document):
    """RELIABLE with a DEPTH that covers a heartbeat sends again whatever the link lost."""
    deep = [run for run in document["runs"] if run["depth"] > 1]
    assert len(deep) == 2
    for run in deep:
        assert (run["lost"], run["end_to_end"]["lost_ratio"]) == (0, 0.0)
