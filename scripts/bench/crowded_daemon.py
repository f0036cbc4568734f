"""A daemon with many topics, for `http_load.py`: it ticks in real time, and serves HTTP.

Usage: python -m scripts.bench.crowded_daemon TOPICS [WEB_CONFIG]

A simulated crowd of publishers replaces ROS, ten publishers to a node. Each announces itself once a second, a tenth of
them between two ticks, at rates that change a little each time, so that the daemon solves again and again. The cost to
receive and decode announcements is not included.
"""

from __future__ import annotations

import contextlib
import logging
import random
import sys
import threading
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

from arpd.adapters.http.service import serving
from arpd.adapters.systemd.notify import Notifier
from arpd.daemon.gc import Garbage
from arpd.daemon.supervisor import Signals, Supervisor
from arpd.daemon.tick import Daemon
from arpd.model.endpoints import Direction, PublisherState, SwapRecord
from arpd.model.interface import InterfaceState, LinkCounters
from arpd.model.observation import Glance, MemoryState, Observation
from arpd.model.settings import HttpSettings, LinkSettings, Settings

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping

    from arpd.model.plan import QosPlan
    from arpd.model.price import Price
    from arpd.model.probing import ProbeRequest
    from arpd.model.settings import GraphSettings

_TOPICS_PER_NODE = 10
_CAPACITY = 2.5e6  # bytes/s
_MANY = MappingProxyType({"matching": 40.5, "watching": 2.25, "holding": 0.125, "proving": 1.5, "draining": 9.75})
_RESULTS = MappingProxyType({"ok": 11, "reorder_possible": 1, "unmatched": 2})
_DROPS = MappingProxyType({"rate": 170_000, "price": 1_234})


class Crowd:
    """A `arpd.daemon.world.World` with so many publishers, each with all that a publisher announces."""

    def __init__(self, topics: int) -> None:
        self._random = random.Random(topics)
        self._publishers = [self._publisher(number, topics) for number in range(topics)]
        self._announced_s = [0.0] * topics
        self._turn = 0
        self._tx_bytes = 0

    def _publisher(self, number: int, topics: int) -> PublisherState:
        return PublisherState(
            node=f"/robot/sensor_node_{number // _TOPICS_PER_NODE:03d}",
            topic=f"/robot/sensor_{number:04d}/data_raw",
            type_name="sensor_msgs/msg/Imu",
            direction=Direction.SENSING if number % 20 else Direction.ACTUATION,
            payload_bytes=328.0,
            source_rate_hz=4000.0 / topics,
            published_rate_hz=3000.0 / topics,
            offered=100_000 + number,
            published=80_000 + number,
            withheld=171_234,
            withheld_by_cause=_DROPS,
            deadlines_missed=number % 7,
            depth=10,
            baseline_depth=10,
            remote_readers=1,
            swaps_begun=14,
            swaps_by_result=_RESULTS,
            swap_seconds_by_phase=_MANY,
            last_swap=SwapRecord(number=14, result="ok", depth=10, deadline_ns=0, seconds_by_phase=_MANY),
        )

    def observe(self, now_s: float) -> Observation:
        """Return the observation of one tick."""
        self._turn = (self._turn + 1) % 10
        for number in range(self._turn, len(self._publishers), 10):
            self._publishers[number] = self._announce(self._publishers[number])
            self._announced_s[number] = now_s
        self._tx_bytes += int(0.1 * _CAPACITY)
        return Observation(
            now_s=now_s,
            counters=LinkCounters(
                interface="wlan0",
                rx_bytes=0,
                tx_bytes=self._tx_bytes,
                rx_packets=0,
                tx_packets=0,
                tx_dropped=0,
                state=InterfaceState.UP,
            ),
            reports=(),
            publishers=tuple(
                replace(publisher, announced_at_s=announced_s)
                for publisher, announced_s in zip(self._publishers, self._announced_s, strict=True)
            ),
            memory=MemoryState(total_bytes=2**32, available_bytes=2**31),
            sensing_topics=len(self._publishers),
            actuation_topics=0,
        )

    def _announce(self, publisher: PublisherState) -> PublisherState:
        return replace(
            publisher,
            offered=publisher.offered + 4,
            published=publisher.published + 3,
            source_rate_hz=publisher.source_rate_hz * self._random.uniform(0.98, 1.02),
        )

    def apply(self, plan: QosPlan, *, lease_s: float, missing: Collection[str], now_s: float) -> None:  # noqa: ARG002
        """Let every node show what the plan asks of it."""
        if missing:
            self._publishers = [
                each
                if (row := plan.topics.get(each.topic)) is None
                else replace(
                    each,
                    generation=plan.generation,
                    lease_s=lease_s,
                    rate_hz=row.rate_hz,
                    depth=row.depth,
                    deadline_ns=row.deadline_ns,
                )
                for each in self._publishers
            ]

    def set_price(self, price: Price) -> None:
        """Ignore the price."""

    def probe(self, request: ProbeRequest) -> None:
        """Send nothing."""

    def reconfigure(self, graph: GraphSettings) -> None:
        """Pin nothing."""

    def results(self) -> Mapping[str, int]:
        """Count the plans sent, by result."""
        return {}

    def stand_by(self) -> None:
        """Take back nothing."""

    def glance(self) -> Glance:
        """Return that every tick is worth its cost."""
        return Glance(has_reports=True, backlog_bytes=None)

    def probes_sent(self) -> tuple[int, int]:
        """Count probes, and their wire bytes."""
        return 0, 0


def crowded_daemon(topics: int) -> Daemon:
    """Return a daemon over so many topics, before its first tick."""
    settings = Settings(link=LinkSettings(capacity_bytes_per_second=_CAPACITY))
    return Daemon(Crowd(topics), settings, interface="wlan0")


def main() -> None:
    """Tick and serve until stdin closes; print the URL."""
    logging.disable(logging.WARNING)
    topics, *web_config = sys.argv[1:]
    daemon = crowded_daemon(int(topics))
    signals, resting = Signals(is_looping=True), threading.Event()

    def wait_for_the_end() -> None:
        sys.stdin.read()
        signals.stop = True

    http = HttpSettings(host="127.0.0.1", port=0, web_config=web_config[0] if web_config else "none")
    with (
        contextlib.suppress(KeyboardInterrupt),
        serving(http, lambda: daemon.snapshot, directory=Path(), resting=resting) as url,
    ):
        print(url, flush=True)
        threading.Thread(target=wait_for_the_end, daemon=True).start()
        garbage = Garbage()
        garbage.take_over()
        Supervisor(
            daemon,
            signals,
            Notifier(),
            load=lambda: daemon.settings,
            resting=resting,
            after_tick=(garbage.collect_if_due,),
        ).run()


if __name__ == "__main__":
    main()
