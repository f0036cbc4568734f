"""How the demo's robot publishes, and what the oracle is told."""

from __future__ import annotations

import pytest

from scripts.robot.manner import RCLPY_DEFAULTS, WITH_ARPD, Manner
from scripts.robot.oracle import read_truth, write_truth


def test_a_manner_slows_its_topics_and_no_others():
    """A topic is published at the rate the manner says, never faster than its source, others at their source's."""
    manner = Manner(rates_hz={"/imu": 39.0, "/battery": 39.0})
    assert [manner.rate_hz(topic, hz) for topic, hz in (("/imu", 200.0), ("/battery", 1.0), ("/odom", 50.0))] == [
        39,
        1,
        50,
    ]


def test_only_a_daemon_makes_a_robot_managed():
    """The defaults of rclpy have no daemon, arpd is one."""
    assert (RCLPY_DEFAULTS.is_managed, WITH_ARPD.is_managed) == (False, True)


@pytest.mark.parametrize(("loss", "is_out"), [(0.0, False), (0.5, False), (1.0, True)])
def test_the_oracle_believes_what_it_is_told(tmp_path, loss, is_out):
    """Capacity comes from the file as written last, and a link that loses everything is out."""
    truth = tmp_path / "truth.json"
    write_truth(truth, capacity_bytes_per_second=1.0, loss=0.0)
    write_truth(truth, capacity_bytes_per_second=625_000.0, loss=loss)
    told = read_truth(truth)
    assert (told.capacity_bytes_per_second, told.is_out) == (625_000.0, is_out)
    assert [path.name for path in tmp_path.iterdir()] == ["truth.json"]
