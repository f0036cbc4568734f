"""The rates of the demo's robot, and the truth of the oracle."""

from __future__ import annotations

import math

import pytest

from arpd.adapters.sim.loss import LossStep
from arpd.adapters.sim.schedule import RateSchedule
from scripts.robot.manner import Manner
from scripts.robot.oracle import Course, write_course


def test_a_manner_slows_its_topics_and_no_others():
    """A topic with a rate is published at it, but never faster than its source; others at their source's rate."""
    manner = Manner(rates_hz={"/imu": 39.0, "/battery": 39.0})
    assert [manner.rate_hz(topic, hz) for topic, hz in (("/imu", 200.0), ("/battery", 1.0), ("/odom", 50.0))] == [
        39,
        1,
        50,
    ]


# -- the oracle's truth

MBIT = 125_000.0


def course(path, *, started_s=100.0):
    """20 Mbit/s, from 5 s on 5 Mbit/s; half is lost from 1 s to 2 s, all from 2 s to 3 s."""
    rates = RateSchedule.parse("0:20mbit,5:5mbit")
    losses = [LossStep(start_s=start_s, loss=loss) for start_s, loss in ((1.0, 0.5), (2.0, 1.0), (3.0, 0.0))]
    write_course(path, rates, losses, started_s=started_s)
    return Course.read(path)


def told(found, now_s, waiting_bytes=0):
    return found.truth(now_s, waiting_bytes=waiting_bytes, delivered_bytes_per_second=7.0)


@pytest.mark.parametrize(("elapsed_s", "mbit"), [(0.0, 20), (4.8, 20), (4.9, 12.5), (5.0, 5), (60.0, 5)])
def test_the_oracle_knows_the_mean_rate_of_the_next_fifth_of_a_second(tmp_path, elapsed_s, mbit):
    """A fall in 0.1 s counts by half."""
    truth = told(course(tmp_path / "truth.json"), 100.0 + elapsed_s)
    assert truth.capacity_bytes_per_second == pytest.approx(mbit * MBIT)
    assert truth.delivered_bytes_per_second == 7.0


def test_before_the_course_begins_its_first_rate_holds(tmp_path):
    """The robot starts before its run does."""
    truth = told(course(tmp_path / "truth.json", started_s=math.inf), 1e6)
    assert (truth.capacity_bytes_per_second, truth.is_out) == (20 * MBIT, False)


@pytest.mark.parametrize(("elapsed_s", "is_out"), [(0.0, False), (1.5, False), (2.0, True), (2.99, True), (3.0, False)])
def test_a_link_that_loses_everything_now_is_out(tmp_path, elapsed_s, is_out):
    """Half a loss is no outage."""
    assert told(course(tmp_path / "truth.json"), 100.0 + elapsed_s).is_out is is_out


def test_the_queue_waits_for_the_rates_to_come(tmp_path):
    """0.1 s before the fall to a quarter, a queue of 0.2 s at the rate of now takes 0.1 s and 4 times 0.1 s."""
    found = course(tmp_path / "truth.json")
    assert told(found, 104.9, waiting_bytes=round(0.2 * 20 * MBIT)).queue_delay_s == pytest.approx(0.5)
    assert told(found, 104.9).queue_delay_s == 0.0


def test_a_course_that_is_written_again_leaves_one_file(tmp_path):
    """The second course replaces the first whole."""
    course(tmp_path / "truth.json", started_s=math.inf)
    assert course(tmp_path / "truth.json").started_s == 100.0
    assert [path.name for path in tmp_path.iterdir()] == ["truth.json"]
