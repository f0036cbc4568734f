"""What probe trains read on the real link, for `adapt.py --trains`: bias and spread by rate.

Trains are those of the daemon's probing, received by `arpd peer`, on a link that is otherwise idle. For each rate and
packet size there are as many trains as asked for, each as long as the estimator's (15 ms of the link, at least 12 kB),
but of at most 100 packets. A train counts if it loses at most a tenth of its packets. "sent in" is the sender's time to
publish a train over the link's time to carry it: from about 1 on, the sender is the bottleneck, not the link.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from statistics import median
from typing import Any

from arpd.adapters.sim.result import percentile
from arpd.cli.progress import progress
from arpd.model.probing import ProbeRequest
from arpd.model.wire import probe_wire_bytes
from scripts.bench.adapt_links import MBIT
from scripts.bench.child import Child, answer, commands
from scripts.bench.report import percent, table
from scripts.netns.simlink import SimLink

RATES_MBIT = (2.0, 5.0, 10.0, 20.0, 50.0, 100.0)
PACKET_BYTES = (1300, 200)
EVERY_S = 0.3
_MOST_PACKETS = 100


@dataclass(frozen=True, kw_only=True, slots=True)
class Cell:
    """Trains of one size at one rate."""

    rate_mbit: float
    packet_bytes: int

    @property
    def packets(self) -> int:
        """Number of packets of the estimator's trains at this rate."""
        size = max(12_000.0, 0.015 * self.rate_mbit * MBIT)
        return min(_MOST_PACKETS, 1 + math.ceil(size / self.packet_bytes))

    @property
    def link_s(self) -> float:
        """Time that the link needs for all packets after the first (s)."""
        return (self.packets - 1) * probe_wire_bytes(self.packet_bytes) / (self.rate_mbit * MBIT)


def measure_trains(trains: int) -> dict[str, Any]:
    """Send trains of each size at each rate, and return what they read."""
    cells = [Cell(rate_mbit=rate_mbit, packet_bytes=size) for rate_mbit in RATES_MBIT for size in PACKET_BYTES]
    measured = []
    with progress("measuring", total=len(cells)) as shown:
        for cell in cells:
            shown.step(f"{cell.rate_mbit:g} Mbit/s, {cell.packet_bytes} bytes")
            measured.append(_measure(cell, trains))
    return {"trains": measured}


def trains_report(document: dict[str, Any]) -> str:
    """Return a row per rate and packet size; the readings are compared with the rate."""
    return table(
        document["trains"],
        ("Mbit/s", "rate_mbit", "{:g}"),
        ("bytes", "packet_bytes"),
        ("packets", "packets"),
        ("sent", "sent"),
        ("counted", "arrived"),
        ("sent in %", "publishing_share", percent),
        *((f"{name} %", name, percent) for name in ("least", "p10", "bias", "p90", "most")),
    )


def _measure(cell: Cell, trains: int) -> dict[str, Any]:
    """Send one cell's trains over a link of its own."""
    with SimLink(f"trains-{time.monotonic_ns() % 10**9}", rate_bytes_per_second=cell.rate_mbit * MBIT) as link:
        peer = Child(link, "ceddp", "arpd.cli", "peer", "--interface", link.ceddp.interface, "--name", "ceddp")
        sender = Child(link, "robot", "scripts.bench.adapt_trains")
        sender.ask(trains=5, packets=2, packet_bytes=200)  # until both sides are matched
        found = sender.ask(trains=trains, packets=cell.packets, packet_bytes=cell.packet_bytes)
        peer.process.terminate()
        for child in (sender, peer):
            child.end()
    reads = [size / duration_s / (cell.rate_mbit * MBIT) - 1.0 for size, duration_s in found["trains"]]
    return {
        "rate_mbit": cell.rate_mbit,
        "packet_bytes": cell.packet_bytes,
        "packets": cell.packets,
        "sent": len(found["spans_s"]),
        "arrived": len(reads),
        "publishing_share": median(found["spans_s"]) / cell.link_s,
        "bias": median(reads) if reads else None,
        "p10": percentile(reads, 0.1),
        "p90": percentile(reads, 0.9),
        "least": min(reads, default=None),
        "most": max(reads, default=None),
    }


def send() -> None:
    """Send the trains of each order through the daemon's adapter, and answer with the peer's readings."""
    from arpd.adapters.ros.runtime import ros_node
    from arpd.adapters.ros.world import RosControl
    from arpd.model.settings import GraphSettings

    orders = commands()
    with ros_node("adapt_trains") as node:
        world = RosControl(node, interface="link0", graph=GraphSettings(), on_report=lambda: None)
        number = 0
        while (command := orders.get()) is not None:
            spans_s, trains = [], []
            for _ in range(command["trains"] + 1):
                number += 1
                request = ProbeRequest(packets=command["packets"], packet_bytes=command["packet_bytes"], number=number)
                started_s = time.monotonic()
                world.probe(request)
                spans_s.append(time.monotonic() - started_s)
                time.sleep(EVERY_S)
                reports = world.observe(time.monotonic()).reports
                trains += [(train.payload_bytes, train.duration_s) for report in reports for train in report.trains]
            answer(spans_s=spans_s, trains=trains)


if __name__ == "__main__":
    send()
