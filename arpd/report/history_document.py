"""The history document of ``/api/v1/history``: the last ten minutes, one sample a second, in columns.

``null`` stands where there was nothing: before a publisher came and after it left, for a rate that is unpaced or not
planned, for a loss that is not known. Keys are only ever added within ``v1``.
"""

from __future__ import annotations

import json
import math
from typing import TYPE_CHECKING, Any

from arpd.report.history import LINK_SERIES, PERIOD_S, RATE_SERIES, SPAN_S
from arpd.report.status import API_VERSION, event_documents

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from arpd.report.events import Event
    from arpd.report.history import Sample

_MISSING = (math.nan,) * len(RATE_SERIES)


def history_document(samples: tuple[Sample, ...], events: tuple[Event, ...]) -> dict[str, Any]:
    """Return the history as a JSON-safe document.

    Parameters
    ----------
    samples : oldest first
    events : of the decision log, oldest first
    """
    return {**_head(samples, events), "topics": list(_topics(samples))}


def history_json(samples: tuple[Sample, ...], events: tuple[Event, ...]) -> bytes:
    """Return the document as JSON, written a topic at a time: a tick that is due need not wait for all of them."""
    head = json.dumps(_head(samples, events), allow_nan=False)
    topics = ", ".join(json.dumps(topic, allow_nan=False) for topic in _topics(samples))
    return f'{head[:-1]}, "topics": [{topics}]}}\n'.encode()


def _head(samples: tuple[Sample, ...], events: tuple[Event, ...]) -> dict[str, Any]:
    newest = samples[-1] if samples else None
    link = {name: _column(getattr(sample.link, name) for sample in samples) for name in LINK_SERIES}
    gate = link.pop("gate")
    return {
        "api_version": API_VERSION,
        "unix_time_seconds": newest and newest.unix_time_s,
        "period_seconds": PERIOD_S,
        "span_seconds": SPAN_S,
        # Counted back from the newest: the wall clock may have been set in between, and charts need times that rise.
        "times": [round(newest.unix_time_s - (newest.at_s - sample.at_s), 3) for sample in samples] if newest else [],
        "link": link,
        "gate": gate,
        "topics_omitted": newest.omitted if newest else 0,
        "events": event_documents(events),
    }


def _topics(samples: tuple[Sample, ...]) -> Iterator[dict[str, Any]]:
    if not samples:
        return
    width = len(RATE_SERIES)
    for identity in sorted(samples[-1].slots):
        slots = (sample.slots.get(identity) for sample in samples)
        rows = [
            _MISSING if slot is None else sample.rates_hz[slot * width : (slot + 1) * width]
            for sample, slot in zip(samples, slots, strict=True)
        ]
        series = {name: _column(row[number] for row in rows) for number, name in enumerate(RATE_SERIES)}
        yield {"topic": identity.topic, "node": identity.node, **series}


def _column(values: Iterable[float | str]) -> list[float | str | None]:
    return [value if isinstance(value, str) or math.isfinite(value) else None for value in values]
