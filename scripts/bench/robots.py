"""Play robots that nobody tuned arpd on, over links that get worse, with arpd and without.

Usage: python -m scripts.bench.robots --robots tb4,camera --links steady20,steady5 --bottlenecks sender,middle \
           --sides plain,large_data,two_ends --seconds 20 --rounds 1 --out FILE.json [--tree OTHER]

Needs root, as the simulated link does. Run nothing else meanwhile: two cores are just enough.

Real rclpy nodes publish real messages: a process for each node of the robot, one that reads its commands, and one each
for the commands and the readers of the base. Bottlenecks: `sender` is a token bucket with a queue of 256 kB on the
interface of each host, as a Pi's Wi-Fi; `middle` is the same in a namespace between the hosts. Sides:

plain       rclpy's defaults
large_data  the same with FASTDDS_BUILTIN_TRANSPORTS=LARGE_DATA, and a private /dev/shm for each process
adaptive    AdaptivePublishers in the nodes, `arpd run` and `arpd peer`, all with arpd's Fast DDS profile
adaptive_tcp  the same with LARGE_DATA for every process, and one /dev/shm per host, as in real life
two_ends    plain nodes that stay on their hosts, `arpd run`, `arpd relay`, `arpd relay --far`, `arpd peer`
other       two_ends with the arpd of another source tree (--tree)

Nodes publish for a while before anything counts: 4 s without arpd, 8 s with it. A sample is small up to ten packets.
Camera infos are in no class, because they are of no use without their image: the table says whole sets per second.
`robot-small` is the robot without its large topics: what an unloaded link gives.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import yaml

from arpd.sim.demo import COMMAND_TOPIC, DEMO_CONFIG, demo_topics
from scripts.bench.child import ChildError
from scripts.bench.harness import conditions
from scripts.bench.links import courses
from scripts.bench.nodes import Service
from scripts.bench.samples import BASE, Topic
from scripts.bench.sides import PREFIX, SIDES, Robot
from scripts.bench.world import world_of

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
_GPS_SENTENCES = ("$GPGGA", "$GPRMC")

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
        _topic("/nmea", "std_msgs/String", 10.0, 90, "gps", kinds=_GPS_SENTENCES),
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
    "telemetry": (*(_telemetry(k) for k in range(100)), _cmd(rate_hz=20.0)),
}
GROUPED = {"rgbd": ("/depth/image", "/depth/camera_info", "/color/image", "/color/camera_info")}

_SERVICES = {"nav2": Service(name="/map_server/map", node=_MAP_SERVER, answer_bytes=4_000_000, every_s=10.0)}


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


def robot_of(name: str) -> Robot:
    """Return a robot; with "-small" after its name, only the small topics and the commands."""
    if name == "demo":
        return demo_robot()
    whole = name.removesuffix("-small")
    topics = _TOPICS[whole]
    if whole != name:
        topics = tuple(topic for topic in topics if topic.group in {"small", "commands"})
    return Robot(topics=topics, service=_SERVICES.get(name), groups=GROUPED.get(name, ()))


#: Title, figure and digits of the columns, those of one group beside each other; gap+ is the gap beyond the period.
_ALL, _P99, _GAP = ("all %", "delivered_percent", 1), ("p99 ms", "p99_ms", 1), ("gap+ s", "gap_over_period_s", 2)
COLUMNS = {
    "small": (_ALL, ("worst %", "worst_delivered_percent", 1), _P99, ("worst", "worst_p99_ms", 1), _GAP),
    "commands": (_ALL, _P99, ("max ms", "max_ms", 1), _GAP),
    "large": (("p99 ms", "p99_ms", 0),),
}


def header() -> str:
    titles = [" ".join(f"{title:>7}" for title, *_ in columns) for columns in COLUMNS.values()]
    groups = " | ".join(f"{group:^{len(each)}}" for group, each in zip(COLUMNS, titles, strict=True))
    columns = [f"{'robot link bottleneck':28} {'side':10}", *titles, f"{'large/s':>14}", "Mbit/s", "2x/torn/late"]
    return f"{'':39} | {groups} |\n{' | '.join([*columns, 'ends: CPU s, MiB'])}"


def line_of(run: dict[str, Any], label: str) -> str:
    """Return one run as a line of the table."""
    head = f"{label:28} {run['side']:10}"
    if "failed" in run:
        return f"{head} | failed: {run['failed']}"
    parts = [head]
    for group, columns in COLUMNS.items():
        figures = run["groups"].get(group, {})
        values = [(figures.get(key), digits) for _, key, digits in columns]
        texts = ("-" if value is None else f"{value:.{digits}f}" for value, digits in values)
        parts.append(" ".join(f"{text:>7}" for text in texts))
    large = [f"{topic['per_second']:.2f}" for topic in run["topics"].values() if topic["group"] == "large"]
    parts += [
        f"{' + '.join(large):>14}",
        f"{run['to_base_mbit']:6.1f}",
        f"{'/'.join(map(str, run['faults'].values())):>12}",
    ]
    ends = [end for end in ("relay", "relay_far") if end in run["cpu_s"]]
    parts.append(" + ".join(f"{run['cpu_s'][end]:.1f}, {run['max_rss_bytes'].get(end, 0) / 2**20:.0f}" for end in ends))
    calls = [f"{call['took_s']:.1f} s" if call["took_s"] else "none" for call in run["calls"]]
    sets = run["groups"].get("large", {}).get("sets_per_second")
    notes = {
        "sets/s": [f"{sets:.2f}"] if sets is not None else [],
        "unmatched": run["unmatched"],
        "calls": calls,
        "ended": run["ended"],
    }
    return " | ".join([*parts, *(f"{name} {', '.join(each)}" for name, each in notes.items() if each)])


def measured(options: argparse.Namespace, keys: dict[str, Any], logs: Path) -> dict[str, Any]:
    """Return one run, or why it failed."""
    is_stalled = keys["link"] == "stalled"
    seconds = max(options.seconds, 2.0 * options.stall) if is_stalled else options.seconds
    course = courses(seconds, options.stall)[keys["link"]]
    robot = robot_of(keys["robot"])
    side = replace(SIDES["two_ends"], tree=options.tree.resolve()) if keys["side"] == "other" else SIDES[keys["side"]]
    try:
        with world_of(robot, side, bottleneck=keys["bottleneck"], rate=course[0][1], logs=logs) as world:
            account, spent = world.play(course, seconds)
    except ChildError as error:
        return {**keys, "failed": str(error)}
    found = {"groups": account.groups(), "faults": account.faults(), "topics": account.topics, "calls": account.calls}
    return {**keys, "seconds": seconds, "warm_up_s": side.warm_up_s, **found, **spent}


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    listed = partial(str.split, sep=",")
    links = list(courses(20.0, 6.0))
    parser.add_argument(
        "--robots", type=listed, default=list(_TOPICS), metavar="LIST", help=", ".join([*_TOPICS, "demo"])
    )
    parser.add_argument("--links", type=listed, default=links, metavar="LIST", help="default all")
    parser.add_argument("--bottlenecks", type=listed, default=["sender", "middle"], metavar="LIST", help="default both")
    parser.add_argument("--sides", type=listed, default=["plain", "large_data", "two_ends"], metavar="LIST")
    parser.add_argument("--seconds", type=float, default=20.0, metavar="S", help="that count; default %(default)g")
    parser.add_argument("--stall", type=float, default=6.0, metavar="S", help="of the link stalled; at most half a run")
    parser.add_argument("--rounds", type=int, default=1, metavar="N", help="default %(default)d")
    parser.add_argument("--tree", type=Path, metavar="TREE", help="another source tree, whose two ends are a side too")
    parser.add_argument("--out", type=Path, metavar="FILE", help="document with everything")
    parser.add_argument("--keep-logs", type=Path, metavar="FOLDER", help="put arpd's logs there")
    options = parser.parse_args(argv)
    sides = list(dict.fromkeys([*options.sides, *(["other"] if options.tree else [])]))
    if unknown := [side for side in sides if side not in {*SIDES, "other"}]:
        parser.error(f"no side {', '.join(unknown)}; there are {', '.join(SIDES)}")
    document: dict[str, Any] = {"conditions": conditions(), "runs": []}
    print(header())
    conditions_of = product(range(options.rounds), options.robots, options.links, options.bottlenecks)
    with tempfile.TemporaryDirectory(prefix="arpd-robots-") as temporary:
        for number, robot, link, bottleneck in conditions_of:
            first = number % len(sides)
            for k, side in enumerate(sides[first:] + sides[:first]):
                keys = {"robot": robot, "link": link, "bottleneck": bottleneck, "side": side}
                folder = (options.keep_logs or Path(temporary)) / "-".join([*keys.values(), str(number)])
                run = measured(options, {**keys, "round": number}, folder)
                document["runs"].append(run)
                print(line_of(run, "" if k else f"{robot} {link} {bottleneck}"), flush=True)
    if options.out:
        options.out.write_text(json.dumps(document, indent=1) + "\n", "utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
