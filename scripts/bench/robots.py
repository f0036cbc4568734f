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
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from contextlib import ExitStack, suppress
from functools import partial
from importlib import util
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import psutil
import yaml

from arpd.adapters.ros.runtime import FASTDDS_PROFILE
from scripts.bench.child import Child, ChildError
from scripts.bench.node import becomes_true
from scripts.bench.record import REPO, conditions, write
from scripts.bench.robots_figures import Figures
from scripts.bench.robots_link import courses, link_of
from scripts.bench.robots_nodes import BASE_SINK, CALLER, ROBOT_SINK
from scripts.bench.robots_sets import BASE, CALLED, GROUPED, MAP_SERVICE, ROBOTS, topics_of

if TYPE_CHECKING:
    from collections.abc import Iterator

    from scripts.bench.robots_link import Course, SenderLink
    from scripts.netns.namespaces import HostName

WARM_UP_S = {"plain": 4.0, "large_data": 4.0, "adaptive": 8.0, "adaptive_tcp": 8.0, "two_ends": 8.0, "other": 8.0}
_HAS_ENDS = {"two_ends", "other"}
_ADAPTIVE = {"adaptive", "adaptive_tcp"}
_OVER_TCP = {"large_data", "adaptive_tcp"}
_LARGE_DATA = {"FASTDDS_BUILTIN_TRANSPORTS": "LARGE_DATA"}
_MATCH_S, _DRAIN_S, _LEAD_S = 40.0, 4.0, 1.0
_TICK_S, _FOOTPRINT_S = 0.02, 0.5
_LINK_DOMAIN = 102  # SimLink takes lower ones
_NODES = "scripts.bench.robots_nodes"


def messages_path() -> str:
    """Return the folder of message packages that no wheel has; empty where they cannot be made."""
    spec = util.spec_from_file_location("messages", REPO / "tests" / "messages" / "generate.py")
    assert spec is not None
    assert spec.loader is not None
    generate = util.module_from_spec(spec)
    spec.loader.exec_module(generate)
    try:
        return str(generate.build("tf2_msgs"))
    except (generate.MessagesError, OSError, subprocess.CalledProcessError) as error:
        print(f"/tf is a topic of bytes, because tf2_msgs cannot be made: {error}", file=sys.stderr)
        return ""


class Run:
    """One robot on one link, under one side.

    Parameters
    ----------
    workdir : folder for the logs
    tree : source tree of arpd's processes
    messages : as `messages_path` returns it
    """

    def __init__(self, robot: str, side: str, link: SenderLink, workdir: Path, *, tree: Path, messages: str) -> None:
        self._robot, self._side, self._link = robot, side, link
        self._workdir, self._tree, self._messages = workdir, tree, messages
        self._children: dict[str, Child] = {}
        self._daemons: dict[str, subprocess.Popen[Any]] = {}

    def play(self, course: Course, seconds: float) -> dict[str, Any]:
        """Start everything, play the link's course, and return the figures."""
        rate, loss = course(0.0, seconds)
        with ExitStack() as stack:
            self._start_nodes(stack)
            if self._side in {*_ADAPTIVE, *_HAS_ENDS}:
                self._start_arpd()
            for child in self._children.values():
                child.receive()
            becomes_true(lambda: not any(self._unmatched()), _MATCH_S, poll_s=0.3)
            unmatched = list(self._unmatched())
            self._link.set_loss(loss)
            begin_s = time.monotonic() + _LEAD_S
            from_s = begin_s + WARM_UP_S[self._side]
            times = {"begin_s": begin_s, "from_s": from_s, "until_s": from_s + seconds}
            for child in self._children.values():
                child.ask(do="begin", **times)
            spent = self._follow(course, from_s, seconds)
            self._link.set_rate(rate)
            self._link.set_loss(0.0)
            time.sleep(_DRAIN_S)
            found = {name: child.ask(do="report") for name, child in self._children.items()}
        return {"unmatched": unmatched, **self._figures(found, times), **spent}

    def _figures(self, found: dict[str, dict[str, Any]], times: dict[str, float]) -> dict[str, Any]:
        sources = {int(number): noted for each in found.values() for number, noted in each["sources"].items()}
        arrivals = {name: rows for each in found.values() for name, rows in each["arrivals"].items()}
        figures = Figures(self._robot, sources, arrivals, times["from_s"], times["until_s"])
        groups = figures.groups()
        if self._robot in GROUPED:
            groups["large"]["sets_per_second"] = figures.sets_per_second(GROUPED[self._robot])
        return {
            "groups": groups,
            "faults": figures.faults(),
            "topics": figures.topics,
            "calls": found[CALLER]["calls"] if CALLER in found else [],
        }

    def _start_nodes(self, stack: ExitStack) -> None:
        nodes = dict.fromkeys(topic.node for topic in topics_of(self._robot))
        hosts: dict[str, HostName] = {name: "ceddp" if name == BASE else "robot" for name in nodes}
        hosts |= {ROBOT_SINK: "robot", BASE_SINK: "ceddp"}
        if self._robot in CALLED:
            hosts[CALLER] = "ceddp"
        environment = {
            "FASTRTPS_DEFAULT_PROFILES_FILE": str(FASTDDS_PROFILE) if self._side in _ADAPTIVE else "",
            "PYTHONPATH": f"{REPO}:{self._messages}",
            **self._transports(),
        }
        for name, host in hosts.items():
            child = Child(self._link, host, _NODES, self._robot, name, self._side, environment=environment)
            self._children[name] = child
            stack.callback(child.end)

    def _start_arpd(self) -> None:
        config = self._workdir / "arpd.yaml"
        config.write_text(yaml.safe_dump(self._configuration()), encoding="utf-8")
        peer = ("peer", "--interface", self._link.ceddp.interface, "--name", "ceddp")
        self._start_daemon("peer", "ceddp", config, *peer)
        self._start_daemon("run", "robot", config, "run")
        if self._side in _HAS_ENDS:
            self._start_daemon("relay", "robot", config, "relay")
            self._start_daemon("relay_far", "ceddp", config, "relay", "--far")

    def _configuration(self) -> dict[str, Any]:
        """Return what two ends need to know, and nothing of the robot's rates and sizes."""
        if self._side not in _HAS_ENDS:
            return {}
        relay: dict[str, Any] = {
            "link_domain": _LINK_DOMAIN,
            "robot": self._link.robot.address,
            "ceddp": self._link.ceddp.address,
            "to_robot": [topic.name for topic in topics_of(self._robot) if topic.node == BASE],
        }
        if self._robot in CALLED:
            relay["services"] = [MAP_SERVICE]
        if self._robot in GROUPED:
            relay["groups"] = [{"topics": GROUPED[self._robot], "by": "stamp"}]
        return {"relay": relay}

    def _start_daemon(self, name: str, host: HostName, config: Path, *argv: str) -> None:
        # Without the safe path, `-m` would take the arpd of the working directory.
        environment = {"PYTHONPATH": f"{self._tree}:{self._messages}", "PYTHONSAFEPATH": "1"}
        environment |= self._transports()
        python = self._tree / ".venv" / "bin" / "python"
        command = [str(python) if python.exists() else sys.executable, "-u", "-m", "arpd.cli", *argv]
        with (self._workdir / f"{name}.log").open("w") as log:
            self._daemons[name] = self._link.popen(
                host,
                ["env", *(f"{key}={value}" for key, value in environment.items()), *command, "--config", str(config)],
                stdout=log,
                stderr=log,
                cwd=self._workdir,
            )

    def _transports(self) -> dict[str, str]:
        if self._side in _HAS_ENDS:
            return _confined()
        return _LARGE_DATA if self._side in _OVER_TCP else {}

    def _unmatched(self) -> Iterator[str]:
        for name, child in self._children.items():
            said = child.ask(do="matched")
            yield from said["unmatched"]
            if not said["is_read"]:
                yield name

    def _follow(self, course: Course, from_s: float, seconds: float) -> dict[str, Any]:
        """Let the link follow its course, and return what it carried and what arpd's processes took."""
        time.sleep(max(0.0, from_s - time.monotonic()))
        cpu_before_s, carried_before = self._footprints("cpu_s"), self._carried()
        rss_bytes: Counter[str] = Counter()
        now, next_s = course(0.0, seconds), 0.0
        while (elapsed_s := time.monotonic() - from_s) < seconds:
            if (wanted := course(elapsed_s, seconds)) != now:
                now = wanted
                self._link.set_rate(now[0])
                self._link.set_loss(now[1])
            if elapsed_s >= next_s:
                next_s = elapsed_s + _FOOTPRINT_S
                rss_bytes |= Counter(self._footprints("rss_bytes"))  # the greater of each
            time.sleep(_TICK_S)
        carried = self._carried()
        return {
            "to_base_mbit": (carried["ceddp"] - carried_before["ceddp"]) * 8e-6 / seconds,
            "to_robot_mbit": (carried["robot"] - carried_before["robot"]) * 8e-6 / seconds,
            "cpu_s": {name: cpu_s - cpu_before_s.get(name, 0.0) for name, cpu_s in self._footprints("cpu_s").items()},
            "max_rss_bytes": rss_bytes,
            "ended": [name for name, process in self._daemons.items() if process.poll() is not None],
        }

    def _carried(self) -> dict[str, int]:
        return {name: counters.rx_bytes for name, counters in self._link.counters().items()}

    def _footprints(self, what: str) -> dict[str, Any]:
        """Return the CPU time (s) or the resident memory (bytes) of arpd's processes."""
        found: dict[str, Any] = {}
        for name, process in self._daemons.items():
            with suppress(psutil.Error):
                one = psutil.Process(process.pid)
                found[name] = sum(one.cpu_times()[:2]) if what == "cpu_s" else one.memory_info().rss
        return found


def _confined() -> dict[str, str]:
    """Return the environment of a host whose nodes stay on it, with its own shared memory, as on a real robot."""
    return {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "FASTDDS_BUILTIN_TRANSPORTS": "DEFAULT"}


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


def measured(options: argparse.Namespace, keys: dict[str, Any], workdir: Path, messages: str) -> dict[str, Any]:
    """Return one run, or why it failed."""
    workdir.mkdir(parents=True, exist_ok=True)
    course = courses(options.stall)[keys["link"]]
    seconds = max(options.seconds, 2.0 * options.stall) if keys["link"] == "stalled" else options.seconds
    tree = options.tree.resolve() if keys["side"] == "other" else REPO
    with tempfile.TemporaryDirectory(prefix="arpd-robots-", dir="/dev/shm") as memory:
        link = link_of(
            keys["bottleneck"],
            f"robots-{os.getpid()}-{threading.get_native_id()}",
            memory=Path(memory),
            is_memory_private=keys["side"] == "large_data",
            rate_bytes_per_second=course(0.0, seconds)[0],
        )
        try:
            with link:
                run = Run(keys["robot"], keys["side"], link, workdir, tree=tree, messages=messages)
                return {**keys, "seconds": seconds, "warm_up_s": WARM_UP_S[keys["side"]], **run.play(course, seconds)}
        except ChildError as error:
            return {**keys, "failed": str(error)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    listed = partial(str.split, sep=",")
    parser.add_argument("--robots", type=listed, default=list(ROBOTS), metavar="LIST", help=", ".join(ROBOTS))
    parser.add_argument("--links", type=listed, default=list(courses(6.0)), metavar="LIST", help="default all")
    parser.add_argument("--bottlenecks", type=listed, default=["sender", "middle"], metavar="LIST", help="default both")
    parser.add_argument("--sides", type=listed, default=["plain", "large_data", "two_ends"], metavar="LIST")
    parser.add_argument("--seconds", type=float, default=20.0, metavar="S", help="that count; default %(default)g")
    parser.add_argument("--stall", type=float, default=6.0, metavar="S", help="of the link stalled; at most half a run")
    parser.add_argument("--rounds", type=int, default=1, metavar="N", help="default %(default)d")
    parser.add_argument("--tree", type=Path, metavar="TREE", help="another source tree, whose two ends are a side too")
    parser.add_argument("--out", type=Path, metavar="FILE", help="document with everything")
    parser.add_argument("--keep-logs", type=Path, metavar="FOLDER", help="put arpd's logs there")
    options = parser.parse_args()
    sides = list(dict.fromkeys([*options.sides, *(["other"] if options.tree else [])]))
    if unknown := [side for side in sides if side not in WARM_UP_S]:
        parser.error(f"no side {', '.join(unknown)}; there are {', '.join(WARM_UP_S)}")
    document: dict[str, Any] = {"conditions": conditions(), "runs": []}
    messages = messages_path()
    print(header())
    conditions_of = product(range(options.rounds), options.robots, options.links, options.bottlenecks)
    with tempfile.TemporaryDirectory(prefix="arpd-robots-") as temporary:
        for number, robot, link, bottleneck in conditions_of:
            first = number % len(sides)
            for k, side in enumerate(sides[first:] + sides[:first]):
                keys = {"robot": robot, "link": link, "bottleneck": bottleneck, "side": side}
                folder = (options.keep_logs or Path(temporary)) / "-".join([*keys.values(), str(number)])
                run = measured(options, {**keys, "round": number}, folder, messages)
                document["runs"].append(run)
                print(line_of(run, "" if k else f"{robot} {link} {bottleneck}"), flush=True)
    write(document, options.out)


if __name__ == "__main__":
    main()
