"""The stream of the status document: what it costs, what it says, and who cannot hold it up."""

from __future__ import annotations

import json
import random
import socket
import zlib
from dataclasses import replace
from types import MappingProxyType

import pytest

from arpd.report.status import status_document
from tests.sample_publishers import publisher
from tests.unit.web_world import running
from tests.waiting import eventually

EVENTS = 20
MOST_BYTES = 2_000  # that one more second of the page may cost the link, with 12 topics


@pytest.fixture(autouse=True)
def _hurry(monkeypatch):
    monkeypatch.setattr("arpd.web.stream._PERIOD_S", 0.02)


class Moving:
    """A daemon with 12 topics where everything moves each time that somebody looks."""

    def __init__(self, snapshot):
        self.first = self.last = snapshot
        self.number = 0

    def __call__(self):
        self.number += 1
        now_s, moved = self.first.finished_at_s + self.number, random.Random(self.number).uniform
        count = 1000 * self.number
        publishers = tuple(
            publisher(
                "/relay",
                f"/sensor_{topic}",
                source_rate_hz=moved(20, 40),
                published_rate_hz=moved(10, 20),
                paced_rate_hz=moved(10, 20),
                payload_bytes=moved(900, 1100),
                offered=count + topic,
                published=count // 2 + topic,
                withheld=count // 2,
                withheld_by_cause=MappingProxyType({"rate": count // 8, "price": 3 * count // 8}),
                blocked_s=moved(0, 100),
                queued=round(moved(0, 3)),
                announced_at_s=now_s - moved(0, 1),
            )
            for topic in range(12)
        )
        rows = tuple(
            replace(
                self.first.allocation.topics[0],
                name=each.topic,
                share=moved(0, 1),
                rate_hz=moved(9, 20),
                depth=moved(9, 20),
            )
            for each in publishers
        )
        link = replace(
            self.first.link,
            capacity_bytes_per_second=moved(5e5, 6e5),
            queue_delay_s=moved(0, 0.02),
            delivery_rate_bytes_per_second=moved(4e5, 5e5),
            cross_traffic_bytes_per_second=moved(5e4, 6e4),
            loss_ratio=moved(0, 0.02),
            return_delay_s=moved(0, 0.02),
            age_s=moved(0, 2),
        )
        self.last = replace(
            self.first,
            finished_at_s=now_s,
            unix_time_s=self.first.unix_time_s + self.number,
            tick_s=moved(0.003, 0.009),
            observation=replace(self.first.observation, now_s=now_s, publishers=publishers),
            link=link,
            allocation=replace(self.first.allocation, topics=rows, capacity_bytes_per_second=moved(4e5, 5e5)),
            totals=replace(self.first.totals, ticks=count, reports=count),
        )
        return self.last


def applied(document, operations):
    """Apply patches as patch.js does."""
    for operation in operations:
        *keys, last = operation["path"].split("/")[1:]
        place = document
        for key in keys:
            place = place[int(key) if isinstance(place, list) else key]
        if operation["op"] == "remove":
            del place[int(last)]
        elif operation["op"] == "add":
            place.append(operation["value"])
        else:
            place[int(last) if isinstance(place, list) else last] = operation["value"]


def listen(world, *headers):
    """Open the stream; return the connection, and its file after the head of the answer."""
    raw = socket.create_connection(world.address, timeout=60.0)
    raw.sendall("\r\n".join(("GET /api/v1/stream HTTP/1.1", "Host: x", *headers, "", "")).encode())
    answer = raw.makefile("rb")
    while answer.readline().strip():
        pass
    return raw, answer


def chunks(answer):
    """Yield the chunks of a body."""
    while size := int(answer.readline(), 16):
        yield answer.read(size)
        answer.readline()


def test_a_second_of_the_page_costs_little_and_says_everything(tmp_path, sample_snapshot):
    """With 12 topics, changes stay below 2 kB in gzip, and lead from the first document to the last."""
    daemon = Moving(sample_snapshot)
    with running(tmp_path, snapshot=daemon) as world:
        raw, answer = listen(world, "Accept-Encoding: gzip")
        unpacked = zlib.decompressobj(wbits=31)
        costs, document = [], {}
        with raw:
            for cost, text in ((len(chunk), unpacked.decompress(chunk).decode()) for chunk in chunks(answer)):
                kind, data = (line.partition(": ")[2] for line in text.strip().split("\n")[-2:])
                if kind == "status":
                    document = json.loads(data)
                else:
                    applied(document, json.loads(data))
                    costs.append(cost)
                if len(costs) == EVENTS:
                    break
    assert max(costs) < MOST_BYTES - 200, costs  # the rest is for headers of HTTP, TLS, TCP and IP
    daemon.number = document["totals"]["ticks"] // 1000 - 1
    expected = status_document(daemon())
    assert {name: document[name] for name in ("topics", "link", "totals")} == {
        name: expected[name] for name in ("topics", "link", "totals")
    }


def test_who_does_not_read_is_cut_off_and_holds_up_nobody(tmp_path, sample_snapshot, monkeypatch):
    """A listener that takes nothing costs the buffers of its socket; others have their events meanwhile."""
    monkeypatch.setattr("arpd.web.handlers.ANSWER_S", 1.0)
    monkeypatch.setattr("arpd.web.handlers.MAX_STREAMS", 2)
    number = iter(range(10**9))
    snapshot = lambda: replace(sample_snapshot, config_path=f"{next(number)}" + "x" * 500_000)  # noqa: E731
    with running(tmp_path, snapshot=snapshot) as world:
        lazy, behind = listen(world)
        raw, answer = listen(world)
        with lazy, raw:
            seen = chunks(answer)
            assert world.get("/api/v1/stream", method="HEAD").status == 503
            eventually(
                "the listener that takes nothing is cut off",
                lambda: next(seen) and world.get("/api/v1/stream", method="HEAD").status == 200,
            )
            assert next(seen)
            behind.read()  # to its end
