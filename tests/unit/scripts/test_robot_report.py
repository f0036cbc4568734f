"""The demo's account of what was lost, and where."""

import pytest

from arpd.sim.result import TopicResult
from scripts.robot.report import Pair, as_document, losses_text


def result(**counts):
    figures = dict.fromkeys(("latency_p50_s", "latency_p99_s", "latency_max_s", "age_p50_s", "age_p99_s"), 0.01)
    numbers = {"doubled": 0, "reordered": 0, "delivered_bytes": 0, "source_rate_hz": 20.0, "expected": 100}
    return TopicResult(topic="/imu", **figures, **(numbers | counts))


@pytest.mark.parametrize(
    ("sent", "handed", "received", "places"),
    [
        (90, 90, 90, (0, 0, 0)),
        (87, 87, 87, (3, 0, 0)),
        (90, 88, 88, (0, 2, 0)),
        (90, 90, 85, (0, 0, 5)),
        (89, 87, 84, (1, 2, 3)),
        (89, None, 84, (1, 5, 0)),  # without a far end
    ],
)
def test_every_lost_sample_is_named_by_its_place(sent, handed, received, places):
    """What was withheld is not lost."""
    with_arpd = result(offered=100, withheld=10, sent=sent, handed=handed, received=received)
    pairs = [Pair(without=result(offered=100, withheld=0, sent=100, received=60), with_arpd=with_arpd)]
    near, link, far = places
    (topic,) = as_document(pairs)["topics"]
    assert topic["with"]["losses"] == {"before_near_end": near, "on_link": link, "behind_far_end": far}
    assert all(str(count) in losses_text(pairs)[0] for count in places) if any(places) else not losses_text(pairs)
