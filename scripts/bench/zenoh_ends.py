"""Two ends over Zenoh, one on each host, as most would try instead of arpd. Services do not cross.

They forward as zenoh-bridge-ros2dds does: serialized samples, a key for each topic, readers and writers with the QoS of
the robot's, and `put` blocks on a full queue (`reliable_routes_blocking`). Beyond that they are tuned. A topic has a
thread of its own, so that a large one that blocks delays no other, and each class of topics has its priority
(`pub_priorities`). Large samples have a TCP connection of their own: on a shared one, small ones overtake them in
Zenoh's queues and wait in the socket (tb4, bottleneck between the hosts: 1.8 s). Commands alone are express: a small
sample that takes a batch of its own fills its queue (54 % lost).

Usage: python -m scripts.bench.zenoh_ends WORLD.json HOST ADDRESS SIDE      (`scripts.bench.world.World` starts both)
"""

from __future__ import annotations

import json
import sys
import time
from functools import partial
from pathlib import Path
from typing import Any

import zenoh

from arpd.ros.raw_reader import RawReader, ReadingThread, Sample
from scripts.bench.child import serve
from scripts.bench.nodes import created, plain_node, qos_of
from scripts.bench.samples import BASE, Topic, class_of
from scripts.bench.sides import Way

_PORTS = {7447: "prio=1-5", 7448: "prio=6-7"}  # and what crosses there
_LISTENS = "robot"  # the other end connects to it
_MATCH_S, _REST_S = 0.05, 60.0
_SETTLES_S = 1.0  # 1.9.0 loses some of what is put as soon as somebody has subscribed
#: What large samples do on a full queue, by side. The last two drop what comes while one waits, which Zenoh's authors
#: recommend for images on a slow Wi-Fi.
_LARGE = {
    "zenoh": zenoh.CongestionControl.BLOCK,
    "zenoh_drop": zenoh.CongestionControl.DROP,
    "zenoh_first": zenoh.CongestionControl.BLOCK_FIRST,
    "zenoh_bbr": zenoh.CongestionControl.BLOCK_FIRST,
}
_PRIORITY = {"commands": zenoh.Priority.REAL_TIME, "large": zenoh.Priority.DATA_LOW}  # others: interactive


def session(host: str, address: str) -> zenoh.Session:
    """Open the session of one end; what is not named here is Zenoh's default, as the sizes of its queues are."""
    endpoints = [f"tcp/{address}:{port}?{what}" for port, what in _PORTS.items()]
    document = {
        "mode": "peer",
        "listen": {"endpoints": []},
        "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
        "transport": {"shared_memory": {"enabled": False}, "unicast": {"max_links": len(_PORTS)}},
        "listen" if host == _LISTENS else "connect": {"endpoints": endpoints},
    }
    return zenoh.open(zenoh.Config.from_json5(json.dumps(document)))


def put(publisher: zenoh.Publisher, sample: Sample) -> None:
    publisher.put(sample.data)


def publish(publisher: Any, sample: zenoh.Sample) -> None:
    publisher.publish(sample.payload.to_bytes())


def main() -> None:
    path, host, address, side = sys.argv[1:]
    topics = [Topic(**one) for one in json.loads(Path(path).read_text("utf-8"))["topics"]]
    node, leaving, arriving = plain_node(f"zenoh_{host}"), {}, []
    with session(host, address) as end:
        for key, topic in {topic.name.lstrip("/"): topic for topic in topics}.items():
            if (topic.node == BASE) != (host == "base"):
                publisher = created(node, topic, Way())
                arriving.append(end.declare_subscriber(key, partial(publish, publisher)))
                continue
            is_large = topic.group == "large"
            leaving[topic] = end.declare_publisher(
                key,
                congestion_control=_LARGE[side] if is_large else zenoh.CongestionControl.BLOCK,
                priority=_PRIORITY.get(topic.group, zenoh.Priority.INTERACTIVE_HIGH),
                express=topic.group == "commands",
            )

        def turn() -> float:
            """Read all topics once somebody subscribes to each key, so that latched samples cross, too."""
            if not leaving or not all(publisher.matching_status for publisher in leaving.values()):
                return _MATCH_S if leaving else _REST_S
            time.sleep(_SETTLES_S)
            while leaving:
                topic, publisher = leaving.popitem()
                how = class_of(topic.type_name), topic.name, qos_of(topic, topic.depth)
                RawReader(node, *how, deliver=partial(put, publisher), thread=ReadingThread())
            return _REST_S

        serve(turn, lambda _order: {})


if __name__ == "__main__":
    main()
