"""The last ten minutes: one sample a second, bounded, and never half a sample."""

from __future__ import annotations

import json
import math
import threading
import tracemalloc
from dataclasses import replace
from itertools import pairwise

from arpd.report.history import MOST_TOPICS, SPAN_S, History, history_json
from tests.sample_publishers import publisher


def at(snapshot, t_s, **observed):
    """Return the snapshot at another time, with other observations."""
    observation = replace(snapshot.observation, **observed)
    return replace(snapshot, finished_at_s=t_s, unix_time_s=1.7e9 + t_s, observation=observation)


def history_document(samples, events):
    return json.loads(history_json(samples, events))


def columns(history, topic):
    (found,) = [row for row in history_document(history.samples, ())["topics"] if row["topic"] == topic]
    return found


def named(count, *, first=0, **fields):
    return tuple(publisher(f"/node{number}", f"/t{number:04}", **fields) for number in range(first, first + count))


def test_ticks_ten_times_a_second_give_one_sample_a_second(sample_snapshot):
    """At any rhythm of ticks samples are about a second apart, and a pause causes no double sample."""
    history = History()
    for tick in range(100):
        history.note(at(sample_snapshot, 5.0 + tick * 0.1003))
    history.note(at(sample_snapshot, 60.0))
    history.note(at(sample_snapshot, 60.1))
    history.note(at(sample_snapshot, 61.0))
    times = [sample.at_s for sample in history.samples]
    assert len(times) == 12
    assert all(0.9 < later - earlier < 1.1 for earlier, later in pairwise(times[:10]))
    assert times[-2:] == [60.0, 61.0]


def test_the_span_is_bounded(sample_snapshot):
    """After ten minutes each new sample replaces the oldest."""
    history = History()
    for second in range(700):
        history.note(at(sample_snapshot, float(second)))
    assert len(history.samples) == SPAN_S
    assert history.samples[0].at_s == 100.0


def test_a_sample_holds_what_the_snapshot_said(sample_snapshot):
    """Columns have the snapshot's values; unpaced, unplanned and unknown are null."""
    history = History()
    history.note(sample_snapshot)
    document = history_document(history.samples, ())
    link = document["link"]
    assert (link["capacity_bytes_per_second"], link["foreign_bytes_per_second"]) == ([500_000.0], [62_500.0])
    assert (link["budget_bytes_per_second"], link["level_bytes_per_second"]) == ([425_000.0], [437_500.0])
    assert (link["queue_delay_seconds"], link["state"], document["gate"]) == ([0.0125], ["steady"], [0.75])
    camera, imu = columns(history, "/camera/image"), columns(history, "/imu")
    assert (camera["planned_rate_hz"], camera["source_rate_hz"], camera["paced_rate_hz"]) == ([37.5], [30.0], [12.5])
    assert (imu["planned_rate_hz"], imu["paced_rate_hz"]) == ([None], [None])
    assert columns(history, "/diagnostics")["planned_rate_hz"] == [None]
    unknown = replace(sample_snapshot, link=replace(sample_snapshot.link, loss_ratio=None, queue_delay_s=math.nan))
    history.note(at(unknown, 2000.0))
    link = history_document(history.samples, ())["link"]
    assert (link["loss_ratio"][1], link["queue_delay_seconds"][1]) == (None, None)


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


def test_two_nodes_on_one_topic_have_a_column_each(sample_snapshot):
    """Topic and node together identify a publisher."""
    history = History()
    both = (publisher("/a", "/tf", source_rate_hz=5.0), publisher("/b", "/tf", source_rate_hz=7.0))
    history.note(at(sample_snapshot, 0.0, publishers=both))
    assert [row["source_rate_hz"] for row in history_document(history.samples, ())["topics"]] == [[5.0], [7.0]]


def test_a_thousand_topics_take_the_room_of_two_hundred(sample_snapshot):
    """Planned topics come first, the others are only counted, and the memory is bounded."""
    crowd = (*sample_snapshot.observation.publishers, *named(996))
    history = History()
    tracemalloc.start()
    taken = []
    try:
        for second in range(31):
            history.note(at(sample_snapshot, float(second), publishers=crowd))
            taken.append(tracemalloc.get_traced_memory()[0])
    finally:
        tracemalloc.stop()
    document = history_document(history.samples[-2:], ())
    assert (len(document["topics"]), document["topics_omitted"]) == (MOST_TOPICS, 1000 - MOST_TOPICS)
    assert {"/camera/image", "/imu", "/cmd_vel"} <= {row["topic"] for row in document["topics"]}
    whole = taken[10] + (taken[30] - taken[10]) / 20 * SPAN_S
    print(f"history of 1,000 topics: {whole / 1e6:.2f} MB")
    assert whole < 5e6


def test_times_rise_when_the_wall_clock_is_set(sample_snapshot):
    """A chart's times come from the monotonic clock, counted back from the newest wall clock."""
    history = History()
    history.note(replace(at(sample_snapshot, 0.0), unix_time_s=5e8))
    history.note(at(sample_snapshot, 1.0))
    assert history_document(history.samples, ())["times"] == [1.7e9, 1.7e9 + 1.0]


def test_readers_never_see_half_a_sample(sample_snapshot):
    """While the tick writes, every document read has columns of one length that belong together."""
    history, faults, is_over = History(), [], threading.Event()

    def read():
        while not is_over.is_set():
            document = history_document(history.samples, ())
            length = len(document["times"])
            queues = document["link"]["queue_delay_seconds"]
            if len(queues) != length or document["gate"] != [None if q is None else round(1 - q, 3) for q in queues]:
                faults.append(document)

    threads = [threading.Thread(target=read) for _ in range(2)]
    for thread in threads:
        thread.start()
    for second in range(300):
        delay_s = (second % 100) / 1000
        picture = replace(sample_snapshot, link=replace(sample_snapshot.link, queue_delay_s=delay_s))
        decision = replace(picture.decision, gate=round(1 - delay_s, 3))
        history.note(at(replace(picture, decision=decision), float(second)))
    is_over.set()
    for thread in threads:
        thread.join()
    assert len(history.samples) == 300
    assert not faults
