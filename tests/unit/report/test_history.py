"""The last ten minutes: one sample a second, bounded, and never half a sample."""

from __future__ import annotations

import json
import math
from dataclasses import replace

from arpd.report.history import MOST_TOPICS, SPAN_S, History
from arpd.web.api import history_json
from tests.sample_publishers import publisher


def at(snapshot, t_s, **observed):
    """Return the snapshot at another time, with other observations."""
    observation = replace(snapshot.observation, **observed)
    return replace(snapshot, finished_at_s=t_s, unix_time_s=1.7e9 + t_s, observation=observation)


def history_document(samples, events):
    return json.loads(b"".join(history_json(samples, events)))


def columns(history, topic):
    (found,) = [row for row in history_document(history.samples, ())["topics"] if row["topic"] == topic]
    return found


def named(count, *, first=0, **fields):
    return tuple(publisher(f"/node{number}", f"/t{number:04}", **fields) for number in range(first, first + count))


def test_a_sample_holds_what_the_snapshot_said(sample_snapshot):
    """Columns have the snapshot's values; unpaced, unplanned and unknown are null."""
    history = History()
    history.note(sample_snapshot)
    document = history_document(history.samples, ())
    link = document["link"]
    assert (link["capacity_bytes_per_second"], link["cross_traffic_bytes_per_second"]) == ([500_000.0], [62_500.0])
    assert (link["budget_bytes_per_second"], link["level_bytes_per_second"]) == ([425_000.0], [437_500.0])
    assert (link["queue_delay_s"], document["states"], link["allowed_ratio"]) == ([0.0125], ["steady"], [0.75])
    camera, imu = columns(history, "/camera/image"), columns(history, "/imu")
    assert (camera["planned_rate_hz"], camera["source_rate_hz"], camera["paced_rate_hz"]) == ([37.5], [30.0], [12.5])
    assert (imu["planned_rate_hz"], imu["paced_rate_hz"]) == ([None], [None])
    assert columns(history, "/diagnostics")["planned_rate_hz"] == [None]
    unknown = replace(sample_snapshot, link=replace(sample_snapshot.link, loss_ratio=None, queue_delay_s=math.nan))
    history.note(at(unknown, 2000.0))
    link = history_document(history.samples, ())["link"]
    assert (link["loss_ratio"][1], link["queue_delay_s"][1]) == (None, None)


def test_publishers_come_and_go(sample_snapshot):
    """A publisher has nulls before it came and after it left; a span later it is gone."""
    history = History()
    early, late = named(1), named(1, first=1)
    history.note(at(sample_snapshot, 0.0, publishers=early))
    history.note(at(sample_snapshot, 1.0, publishers=late))
    assert columns(history, "/t0000")["source_rate_hz"] == [20.0, None]
    assert columns(history, "/t0001")["source_rate_hz"] == [None, 20.0]
    for second in range(2, round(SPAN_S) + 3):
        history.note(at(sample_snapshot, float(second), publishers=late))
    assert [row["topic"] for row in history_document(history.samples, ())["topics"]] == ["/t0001"]
    history.note(at(sample_snapshot, SPAN_S + 3, publishers=(*early, *late)))
    assert columns(history, "/t0000")["source_rate_hz"][-2:] == [None, 20.0]


def test_ten_minutes_of_two_hundred_topics_are_kept(sample_snapshot):
    """Each new sample replaces the oldest; planned topics come first, and the others are only counted."""
    crowd = (*sample_snapshot.observation.publishers, *named(996))
    history = History()
    for second in range(700):
        history.note(at(sample_snapshot, float(second), publishers=crowd if second > 690 else ()))
    assert (len(history.samples), history.samples[0].at_s) == (SPAN_S, 100.0)
    document = history_document(history.samples[-2:], ())
    assert (len(document["topics"]), document["topics_omitted"]) == (MOST_TOPICS, 1000 - MOST_TOPICS)
    assert {"/camera/image", "/imu", "/cmd_vel"} <= {row["topic"] for row in document["topics"]}
