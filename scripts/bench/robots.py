"""Play robots over links that change, behind either bottleneck, with arpd and with what a user would do instead.

Real rclpy nodes publish real messages: a process for each node of the robot, one that reads its commands, and one each
for the commands and the readers of the base. Bottlenecks: `sender` is a token bucket with a queue of 256 kB on the
interface of each host, as a Pi's Wi-Fi; `middle` is the same between the hosts. A sample is small up to ten packets;
the age of large ones is that of the newest at the reader, because the latency of those that came says nothing of the
rest. Camera infos are in no class, because they are of no use without their image: whole sets count.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from functools import partial
from itertools import compress, product
from operator import not_
from statistics import median
from typing import Any, get_args

import numpy as np
import yaml

from arpd.model.settings import Settings, TopicSettings
from arpd.sim.demo import COMMAND_TOPIC, DEMO_CONFIG, demo_topics
from arpd.solve.program import Program
from arpd.solve.topics import Traffic, rows_of_traffic
from scripts.bench.account import AGE_S, Account
from scripts.bench.child import ChildError
from scripts.bench.links import DURATION_S, MBIT, STALL_S, Course, at, links
from scripts.bench.report import CELL, RIVALS, Figure, Summary, Table, by_place, figure, picked, ranged, table
from scripts.bench.samples import BASE, Topic
from scripts.bench.sides import PREFIX, SIDES, Robot, Service
from scripts.bench.world import world_of
from scripts.netns.simlink import Bottleneck

_MAP_SERVER = "map_server"
#: Type and node of each topic of the demo's robot; arpd/sim/demo.yaml has names, sizes and rates.
_DEMO = {
    "/scan/front": ("sensor_msgs/LaserScan", "lidar"),
    "/scan/rear": ("sensor_msgs/LaserScan", "lidar"),
    "/camera/image/compressed": ("sensor_msgs/CompressedImage", "camera"),
    "/points": ("sensor_msgs/PointCloud2", "points"),
    "/imu": ("sensor_msgs/Imu", "chassis"),
    "/odom": ("nav_msgs/Odometry", "chassis"),
    "/joint_states": ("sensor_msgs/JointState", "chassis"),
    "/range/front": ("sensor_msgs/Range", "slow"),
    "/gps/fix": ("sensor_msgs/NavSatFix", "slow"),
    "/temperature": ("sensor_msgs/Temperature", "slow"),
    "/battery": ("sensor_msgs/BatteryState", "slow"),
    COMMAND_TOPIC: ("geometry_msgs/TwistStamped", BASE),
}


def _topic(name: str, type_name: str, rate_hz: float, size: int, node: str, **more: Any) -> Topic:
    return Topic(name=name, type_name=type_name, rate_hz=rate_hz, size=size, node=node, **more)


def _image(size: int, rate_hz: float, name: str = "/image") -> Topic:
    return _topic(name, "sensor_msgs/Image", rate_hz, size, "camera")


def _imu(rate_hz: float, node: str = "imu") -> Topic:
    return _topic("/imu", "sensor_msgs/Imu", rate_hz, 324, node)


def _scan(node: str) -> Topic:
    return _topic("/scan", "sensor_msgs/LaserScan", 7.6, 8700, node)


def _telemetry(k: int) -> Topic:
    rate_hz = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0)[k % 6]
    return _topic(f"/telemetry/t{k:02}", "std_msgs/String", rate_hz, 100 + 700 * k // 99, f"half{k % 2}")


_cmd = partial(_topic, "/cmd_vel", "geometry_msgs/Twist", size=52, node=BASE)

_TOPICS: dict[str, tuple[Topic, ...]] = {
    "camera": (_image(921_600, 10.0), _imu(200.0), _cmd(rate_hz=20.0)),
    "camera270": (_image(270_000, 30.0), _imu(100.0), _cmd(rate_hz=20.0)),
    "tb4": (
        _image(270_000, 30.0),
        _scan("lidar"),
        _imu(100.0, "create"),
        _topic("/odom", "nav_msgs/Odometry", 20.0, 720, "create"),
        # One publisher in each of two nodes; the second one's samples carry the next source.
        _topic("/tf", "std_msgs/UInt8MultiArray", 50.0, 120, "create"),
        _topic("/tf", "std_msgs/UInt8MultiArray", 50.0, 400, "lidar"),
        _topic("/battery", "sensor_msgs/BatteryState", 1.0, 120, "create"),
        _cmd(rate_hz=20.0),
    ),
    "rgbd": (
        _image(814_000, 15.0, "/depth/image"),
        _topic("/depth/camera_info", "sensor_msgs/CameraInfo", 15.0, 380, "camera"),
        _image(922_000, 15.0, "/color/image"),
        _topic("/color/camera_info", "sensor_msgs/CameraInfo", 15.0, 380, "camera"),
        _imu(200.0),
        _cmd(rate_hz=20.0),
    ),
    "outdoor": (
        _topic("/points", "sensor_msgs/PointCloud2", 10.0, 900_000, "lidar"),
        _imu(100.0),
        _topic("/fix", "sensor_msgs/NavSatFix", 5.0, 130, "gps"),
        _topic("/nmea", "std_msgs/String", 10.0, 90, "gps"),
        _topic("/joy", "sensor_msgs/Joy", 30.0, 90, BASE),
        _cmd(rate_hz=30.0),
    ),
    "nav2": (
        _topic("/map", "nav_msgs/OccupancyGrid", 1.0, 4_000_000, _MAP_SERVER, is_latched=True),
        _topic("/local_costmap", "nav_msgs/OccupancyGrid", 5.0, 14_000, "planner"),
        _topic("/plan", "nav_msgs/Path", 1.0, 60_000, "planner"),
        _scan("lidar"),
        _topic("/tf", "std_msgs/UInt8MultiArray", 50.0, 400, "lidar"),
        _topic("/bond", "std_msgs/String", 4.0, 110, "bond", publishers=12),
        _cmd(rate_hz=20.0),
    ),
    "events": (
        _image(270_000, 30.0),
        _topic("/log", "std_msgs/String", 10.0, 300, "log", burst=40),
        _topic("/markers", "std_msgs/String", 5.0, 900, "planner", burst=10),
        _topic("/tf", "std_msgs/UInt8MultiArray", 60.0, 400, "planner", burst=6),
        _topic("/goal", "std_msgs/String", 0.25, 120, "planner"),
        _cmd(rate_hz=20.0),
    ),
    "telemetry": (*(_telemetry(k) for k in range(100)), _cmd(rate_hz=20.0)),
}
_LINKS = links()


def demo_robot() -> Robot:
    """Return the demo's robot, with its names and weights where no prefix is in use."""
    topics = {topic.name.removeprefix(PREFIX): topic for topic in demo_topics()}
    wanted = yaml.safe_load(DEMO_CONFIG.read_text("utf-8"))["topics"]
    return Robot(
        topics=tuple(
            _topic(name, type_name, topics[name].rate_hz, topics[name].payload_bytes, node)
            for name, (type_name, node) in _DEMO.items()
        ),
        settings={"topics": [{**each, "name": each["name"].removeprefix(PREFIX)} for each in wanted]},
    )


_MORE: dict[str, Any] = {
    "rgbd": {"groups": ("/depth/image", "/depth/camera_info", "/color/image", "/color/camera_info")},
    "nav2": {"service": Service(name="/map_server/map", node=_MAP_SERVER, answer_bytes=4_000_000, every_s=10.0)},
}
ROBOTS = {
    **{name: Robot(topics=topics, **_MORE.get(name, {})) for name, topics in _TOPICS.items()},
    "demo": demo_robot(),
}
_ZENOH = "two ends over Zenoh, without services: a priority per class"
#: Sides by name, and what each is in words.
WAYS = {
    "plain": "rclpy's defaults",
    "large_data": "plain with FASTDDS_BUILTIN_TRANSPORTS=LARGE_DATA, and a private /dev/shm for each process",
    "large_data_bbr": "large_data with TCP's congestion control BBR instead of cubic, which Debian and Ubuntu have",
    "profile": "rclpy's defaults, no IP fragments, and a heartbeat every 50 ms (arpd's Fast DDS profile)",
    "throttle": "rclpy's defaults, topics throttled to what `arpd solve` gives for the link's slowest tenth",
    "adaptive": "AdaptivePublishers in the nodes, with arpd's Fast DDS profile",
    "adaptive_tcp": "adaptive with LARGE_DATA for every process, and one /dev/shm per host, as in real life",
    "zenoh": f"{_ZENOH}; large samples wait for their turn",
    "zenoh_drop": f"{_ZENOH}; large samples are dropped where the queue is full (congestion control drop)",
    "zenoh_first": f"{_ZENOH}; large samples are dropped while one waits (congestion control block_first)",
    "zenoh_bbr": f"{_ZENOH}; large samples wait for their turn, TCP has BBR",
    "two_ends": "arpd: plain nodes that stay on their hosts, and the relay's two ends",
    "bound": "two_ends, told the mean of the link's next 0.2 s at every tick",
}
_OTHERS = frozenset(WAYS) - {"adaptive", "adaptive_tcp", "two_ends", "bound"}
_USUAL = (
    "tb4 fall-and-rise sender",
    "tb4 fall-and-rise middle",
    "outdoor fall-and-rise sender",
    "demo wifi-walk middle",
)
#: What a run without --only or --full plays, a part after the other: of each place, five sides.
USUAL_PARTS = tuple(f"^{place} (plain|large_data|large_data_bbr|zenoh_first|two_ends)$" for place in _USUAL)
_QUICK = "^tb4 fall-and-rise middle two_ends$"
ROUNDS = 3
#: What arpd should reach of the worst round of a rival: the column, what it has in words, its unit, the share of the
#: rival's, what is added to that, and whether it is the least.
_AIMS: tuple[tuple[str, str, str, float, float, bool], ...] = (
    ("small %", "small samples delivered", "%", 1.0, 0.0, True),
    ("small p99 ms", "latency of small samples, p99", "ms", 1.0, 0.0, False),
    ("small gap beyond its period s", "longest gap of small samples, less their period", "s", 1.0, 0.0, False),
    ("commands p99 ms", "latency of commands, p99", "ms", 1.0, 10.0, False),
    ("commands max ms", "latency of commands, longest", "ms", 1.0, 10.0, False),
    ("large/s", "large samples delivered", "/s", 0.9, 0.0, True),
    ("large age p99 s", "age of large samples, p99", "s", 1.0, 0.0, False),
    ("whole sets/s", "whole sets delivered", "/s", 0.9, 0.0, True),
)
FAULTS = ("doubled", "torn", "out_of_order", "never matched")
Cell = tuple[str, str, Bottleneck, str]
#: The robot, link, bottleneck and topic of the picture.
_SHOWN, _SHOWN_TOPIC, _EVERY = ("tb4", "fall-and-rise", "middle"), "/scan", 10


def throttled(robot: Robot, course: Course) -> Robot:
    """Return the robot with each topic throttled by hand, for the slowest tenth of the link's time without outages."""
    rates = [at(course, float(now_s))[0] for now_s in np.arange(0.0, DURATION_S, 0.1)]
    slowest = float(np.quantile([rate for rate in rates if rate > MBIT / 10], 0.1))
    settings = Settings(topics=(TopicSettings(name=COMMAND_TOPIC, weight=10.0, min_rate_hz=20.0),))
    named: dict[str, Traffic] = {}
    for topic in robot.topics:
        rate_hz = topic.rate_hz * topic.publishers + (named[topic.name].source_rate_hz if topic.name in named else 0.0)
        named[topic.name] = Traffic(topic=topic.name, payload_bytes=topic.size, source_rate_hz=rate_hz)
    program = Program(settings)
    rows = rows_of_traffic(tuple(named.values()), settings)
    answer = program.solve(program.on_link(slowest, rows), settings.program.memory_budget_bytes)
    shares = {each.name: each.rate_hz / named[each.name].source_rate_hz for each in answer.topics}
    return replace(robot, topics=tuple(replace(each, share=min(1.0, shares[each.name])) for each in robot.topics))


def measured(
    robot: str, link: str, bottleneck: Bottleneck, side: str, seconds: float
) -> tuple[dict[str, Any], Account]:
    """Return the figures of one side, and what became of every sample."""
    about, course = ROBOTS[robot], _LINKS[link][1]
    about = throttled(about, course) if side == "throttle" else about
    way = SIDES["plain" if side == "throttle" else side]
    with world_of(about, way, bottleneck=bottleneck, rate=course[0][1]) as world:
        account, spent = world.play(course, seconds)
    groups = account.groups()
    small, commands, large = (groups.get(name, {}) for name in ("small", "commands", "large"))
    row = {
        "robot": robot,
        "link": link,
        "bottleneck": bottleneck,
        "side": side,
        "small %": small.get("delivered_percent"),
        "worst topic %": small.get("worst_delivered_percent"),
        "small p99 ms": small.get("p99_ms"),
        "small gap beyond its period s": small.get("gap_over_period_s"),
        "commands %": commands.get("delivered_percent"),
        "commands p99 ms": commands.get("p99_ms"),
        "commands max ms": commands.get("max_ms"),
        "large/s": large.get("per_second"),
        "large age p99 s": large.get("age_p99_s"),
        "whole sets/s": account.sets_per_second() if about.groups else None,
        "Mbit/s": spent["to_base_mbit"],
        **account.faults(),
        "never matched": len({*spent["unmatched"]} - {"the service"}),  # of which no figure tells
    }
    return row, account


def chosen(only: str) -> list[Cell]:
    """Return robot, link, bottleneck and side of what a regular expression picks."""
    axes: Any = (ROBOTS, _LINKS, get_args(Bottleneck), WAYS)
    every: dict[str, Cell] = {" ".join(cell): cell for cell in product(*axes)}
    known = "; ".join(f"{what}s {', '.join(names)}" for what, names in zip(CELL, axes, strict=True))
    return [every[name] for name in picked(every, only, there_are=f"names as `tb4 ramp middle plain`, of {known}")]


def play(*, is_quick: bool, rounds: int = 1, only: str = "") -> Summary:
    """Play robots, links and bottlenecks, each with every side in turn, for several rounds."""
    cells, found, failed = chosen(_QUICK if is_quick else only), list[dict[str, Any]](), list[list[str]]()
    ages_s: dict[str, list[float]] = {}
    for number, (robot, link, bottleneck, side) in product(range(1 if is_quick else max(ROUNDS, rounds)), cells):
        lasts_s = 8.0 if is_quick else 2 * STALL_S if link == "stalled" else DURATION_S
        try:
            row, account = measured(robot, link, bottleneck, side, lasts_s)
        except ChildError as error:
            failed.append([robot, link, bottleneck, side, str(error)])
            print(*failed[-1], sep=", ", file=sys.stderr)
            continue
        found.append(row)
        if (robot, link, bottleneck) == _SHOWN and number == 0 and side in RIVALS:
            every_s = account.ages_s[_SHOWN_TOPIC]
            ages_s[side] = [max(every_s[k : k + _EVERY]) for k in range(0, len(every_s), _EVERY)]
    lines = [
        {"s": AGE_S * _EVERY * k, **dict(zip(ages_s, each, strict=True))}
        for k, each in enumerate(zip(*ages_s.values(), strict=True))
    ]
    summary = summary_of(table("", found), drawn=table(f"oldest age of {_SHOWN_TOPIC} (s)", lines))
    summary.failed = failed
    return summary


def summary_of(rounds: Table, *, drawn: Table | None = None) -> Summary:
    """Return a table for each place, and arpd beside the best of its rivals, from what each round found."""
    places = by_place(rounds)
    played = {side for sides in places.values() for side in sides}
    return Summary(
        about="Medians, and the range of the rounds. Small are samples up to ten packets, large all others, commands "
        "what the base sends. %: delivered of what was offered, and of the topic that fares worst. p99, max: "
        "latency of what came. Gap: longest time without a sample of a small topic, less its period. Large age: of "
        "the newest one at the base. Mbit/s: what the link carried. "
        f"Targets: no worse than the worst round of the best rival that was played {ROUNDS} times, but for 10 ms of "
        "commands and a tenth of the large samples; rounds in which a rival's topics never matched set none.",
        figures=[each for place, sides in places.items() for each in _aims(place, sides)],
        tables=[
            table("Sides", [{"side": side, "what": what} for side, what in WAYS.items() if side in played]),
            *(_of_place(*each) for each in places.items()),
        ],
        rounds=rounds,
        drawn=drawn,
    )


def _of_place(place: tuple[str, ...], sides: dict[str, dict[str, list[Any]]]) -> Table:
    """Return a line for each side, without columns that say nothing."""
    rows = []
    for side, columns in sorted(sides.items(), key=lambda each: [*WAYS].index(each[0])):
        found = {key: ranged(values) for key, values in columns.items() if key not in FAULTS}
        faults = {key.replace("_", " "): max(columns[key]) for key in FAULTS}
        rows.append({"side": side, "rounds": len(columns["small %"]), **found, **faults})
    said = {key for row in rows for key, value in row.items() if value not in {None, 0, "0"}}
    return table(", ".join(place), [{key: value for key, value in row.items() if key in said} for row in rows])


def _aims(place: tuple[str, ...], sides: dict[str, dict[str, list[Any]]]) -> list[Figure]:
    """Return arpd's figures, each beside that of the rival that is the hardest to beat."""
    rivals = {
        side: {key: list(compress(values, map(not_, columns["never matched"]))) for key, values in columns.items()}
        for side, columns in sides.items()
        if side in _OTHERS and len(columns["small %"]) >= ROUNDS
    }
    found = []
    for key, said, unit, share, more, is_least in _AIMS if "two_ends" in sides else ():
        known = {side: columns[key] for side, columns in rivals.items() if None not in columns.get(key, [None])}
        limits = {side: share * (min if is_least else max)(each) + more for side, each in known.items() if each}
        if limits:
            side = (max if is_least else min)(limits, key=lambda name: limits[name])
            ours = sides["two_ends"][key]
            limit = {"least" if is_least else "most": limits[side]}
            what = f"{', '.join(place)}: {said}, beside {side}"
            found.append(figure(what, None if None in ours else float(median(ours)), unit, **limit))
    return found
