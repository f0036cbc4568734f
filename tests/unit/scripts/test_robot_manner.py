"""The rates of the demo's robot, and the truth of the oracle."""

from __future__ import annotations

import pytest

from scripts.robot.manner import Manner
from scripts.robot.oracle import read_truth, write_truth


def test_a_manner_slows_its_topics_and_no_others():
    """A topic with a rate is published at it, but never faster than its source; others at their source's rate."""
    manner = Manner(rates_hz={"/imu": 39.0, "/battery": 39.0})
    assert [manner.rate_hz(topic, hz) for topic, hz in (("/imu", 200.0), ("/battery", 1.0), ("/odom", 50.0))] == [
        39,
        1,
        50,
    ]


@pytest.mark.parametrize(("loss", "is_out"), [(0.0, False), (0.5, False), (1.0, True)])
def test_the_oracle_reads_the_newest_truth(tmp_path, loss, is_out):
    """Capacity comes from the last write, and a link that loses everything is out."""
    truth = tmp_path / "truth.json"
    write_truth(truth, capacity_bytes_per_second=1.0, loss=0.0)
    write_truth(truth, capacity_bytes_per_second=625_000.0, loss=loss)
    read = read_truth(truth)
    assert (read.capacity_bytes_per_second, read.is_out) == (625_000.0, is_out)
    assert [path.name for path in tmp_path.iterdir()] == ["truth.json"]
