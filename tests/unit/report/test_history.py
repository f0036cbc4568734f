"""The last ten minutes: one sample a second, bounded."""

import json
import math
from dataclasses import replace

from arpd.report.history import SPAN_S, History
from arpd.web.api import history_json


def test_a_sample_holds_what_the_snapshot_said(sample_snapshot):
    """Columns have the snapshot's values; what is unknown is null."""
    history = History()
    history.note(sample_snapshot)
    unknown = replace(sample_snapshot.link, loss_ratio=None, queue_delay_s=math.nan)
    history.note(replace(sample_snapshot, link=unknown, finished_at_s=2000.0, unix_time_s=1.0))
    document = json.loads(history_json(history.samples, ()))
    link = {name: column[0] for name, column in document["link"].items()}
    assert (link["capacity_bytes_per_second"], link["cross_traffic_bytes_per_second"]) == (500_000.0, 62_500.0)
    assert (link["budget_bytes_per_second"], link["level_bytes_per_second"]) == (425_000.0, 437_500.0)
    assert (link["queue_delay_s"], document["states"][0], link["allowed_ratio"]) == (0.0125, "steady", 0.75)
    assert (document["link"]["loss_ratio"][1], document["link"]["queue_delay_s"][1]) == (None, None)
    assert document["times"] == [-999.0, 1.0]  # they rise, although somebody has set the clock


def test_ten_minutes_are_kept(sample_snapshot):
    """Each new sample replaces the oldest, and a tick between two samples adds none."""
    history = History()
    for tenth in range(7000):
        history.note(replace(sample_snapshot, finished_at_s=tenth / 10))
    assert (len(history.samples), history.samples[0].at_s) == (SPAN_S, 100.0)
