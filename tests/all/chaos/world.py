"""The test's side of a chaos test: it starts and kills processes, and observes them as any other process can."""

from __future__ import annotations

import itertools
import json
import math
import os
import queue
import signal
import socket
import subprocess
import sys
import threading
import urllib.request
from collections import defaultdict
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import SimpleNamespace

import pytest
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile
from std_msgs.msg import String

from arpd.model.plan import PlanAnswer, TopicPlan
from arpd.ros.graph import deadline_ns_of
from arpd.ros.runtime import FASTDDS_PROFILE, prepare_environment
from scripts.bench.child import number_of, spinning
from tests.all.chaos.nodes import DEPTH, TOPICS
from tests.ros.world import Announced, Plans
from tests.waiting import PATIENCE_S, eventually

REPO = Path(__file__).resolve().parents[3]
DOMAIN = 50
SHORT_LEASE = """
    <participant profile_name="mortal" is_default_profile="true">
      <rtps><builtin><discovery_config>
        <leaseDuration><sec>3</sec></leaseDuration>
        <leaseAnnouncement><sec>0</sec><nanosec>500000000</nanosec></leaseAnnouncement>
      </discovery_config></builtin></rtps>
    </participant>
"""


@contextmanager
def this_host_only():
    """Limit ROS to UDP on this host, with arpd's profile."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("FASTDDS_BUILTIN_TRANSPORTS", "UDPv4")
        patch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        prepare_environment()
        yield


class Process:
    """One process of `nodes.py`."""

    def __init__(self, argv, environment, log):
        self._log = log
        with log.open("w") as stderr:
            self._popen = subprocess.Popen(
                [sys.executable, "-u", str(Path(__file__).with_name("nodes.py")), *map(str, argv)],
                env=environment,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=stderr,
                text=True,
                cwd=REPO,
            )
        self.stopped = set()  # topics whose swap is stopped
        self._answers = queue.SimpleQueue()
        threading.Thread(target=self._listen, daemon=True).start()

    def tell(self, do, **arguments):
        """Send a command, and wait for its answer."""
        print(json.dumps({"do": do, **arguments}), file=self._popen.stdin, flush=True)
        return self._answers.get(timeout=PATIENCE_S)

    def stop(self, topics):
        """Stop the next swap of each topic in the topic's state; ``stopped`` has the topics where it did."""
        self.stopped.clear()
        self.tell("stop", at={topic: where for where, topic in topics.items()})

    def kill(self):
        """Kill -9."""
        self._popen.send_signal(signal.SIGKILL)
        self._popen.wait()

    def log(self):
        """Return its stderr so far."""
        return self._log.read_text()

    def _listen(self):
        for line in self._popen.stdout:
            if line.startswith("{"):
                answer = json.loads(line)
                if "stopped" in answer:
                    self.stopped.add(answer["stopped"])
                else:
                    self._answers.put(answer["answer"])


class World:
    """The processes of a scenario in a network of its own, and an observer."""

    def __init__(self, workdir):
        self._workdir = workdir
        self._stack = ExitStack()
        self._announcements = defaultdict(list)  # topic → all states announced
        self._generations = itertools.count(1)
        self._starts = 0

    def __enter__(self):
        self._node = self.node("observer")
        self._heard = Announced(self._node, self._on_news)
        self._plans = Plans(self._node)
        return self

    def __exit__(self, *failure):
        self._stack.close()

    def node(self, name):
        """Return a node in its own participant, as in its own process."""
        context = rclpy.Context()
        rclpy.init(context=context, domain_id=DOMAIN)
        self._stack.callback(rclpy.try_shutdown, context=context)
        node = rclpy.create_node(name, context=context)
        self._stack.callback(node.destroy_node)
        executor = SingleThreadedExecutor(context=context)
        executor.add_node(node)
        self._stack.enter_context(spinning(executor))
        return node

    def start(self, *argv, has_short_lease=False):
        """Start a process of `nodes.py`.

        Parameters
        ----------
        has_short_lease : DDS removes it 3 s after its end, and not 20 s
        """
        profile = self._workdir / "short_lease.xml"
        profile.write_text(FASTDDS_PROFILE.read_text().replace("<profiles>", "<profiles>" + SHORT_LEASE))
        environment = {
            **os.environ,
            "PYTHONPATH": str(REPO),
            "ROS_DOMAIN_ID": str(DOMAIN),
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
            "FASTDDS_BUILTIN_TRANSPORTS": "UDPv4",
            "FASTRTPS_DEFAULT_PROFILES_FILE": str(profile if has_short_lease else FASTDDS_PROFILE),
        }
        self._starts += 1
        process = Process(argv, environment, self._workdir / f"{self._starts}-{argv[0]}.log")
        self._stack.callback(process.kill)
        return process

    def talker(self, *topics, readers=1, number=0, stops=None, **options):
        """Start the talker, and let it publish from ``number`` on once every topic has its readers.

        Parameters
        ----------
        stops : topic by the state in which its next swap stops
        """
        talker = self.start("talker", "talker", *(topics or TOPICS.values()), **options)
        talker.stop(stops or {})
        eventually(
            "readers match the talker", lambda: all(count >= readers for count in talker.tell("matched").values())
        )
        talker.tell("publish", is_on=True, number=number)
        return talker

    def daemon(self, **config):
        """Start `arpd run`; it plans ``depth`` and a finite deadline for every topic."""
        depth = config.pop("depth", DEPTH)
        config = {
            "link": {"interface": "lo", "capacity": "10gbit"},
            "http": {"port": free_port()},
            "governor": {"hold": "1h"},  # one plan only: the test's jitter must not cause another
            "defaults": {"min_depth": depth, "max_depth": depth, "latency_budget": "none"},
            **config,
        }
        path = self._workdir / f"{self._starts}.yaml"
        path.write_text(json.dumps(config))  # JSON is YAML
        daemon = self.start("daemon", path)
        daemon.url, daemon.config = f"http://127.0.0.1:{config['http']['port']}", path
        return daemon

    # -- the view and the actions of any process

    def announced(self, topic):
        """Return all announcements of a topic's publisher, oldest first."""
        return tuple(self._announcements[topic])

    def last(self, topic):
        """Return the last announcement, None before the first."""
        return self._announcements[topic][-1] if self._announcements[topic] else None

    def has_settled(self, topics, *, swaps, **values):
        """Return whether each topic announces these values after so many swaps, with one writer of its deadline."""
        return all(
            self.shows(topic, **values)
            and ended(self.last(topic)) >= swaps
            and self.writers(topic) == [self.last(topic).deadline_ns]
            for topic in topics
        )

    def rests(self, topic):
        """Return whether no sample was offered or published between the last two announcements."""
        last = self.announced(topic)[-2:]
        return len(last) == 2 and len({(state.offered, state.published) for state in last}) == 1

    def shows(self, topic, **values):
        """Return whether the publisher's last announcement has these values."""
        last = self.last(topic)
        return last is not None and all(getattr(last, key) == value for key, value in values.items())

    def writers(self, topic):
        """Return the deadlines of all writers of a topic in the graph (ns)."""
        return [deadline_ns_of(info.qos_profile) for info in self._node.get_publishers_info_by_topic(topic)]

    def picture(self):
        """Return the last announcement and the graph's writers, by topic."""
        return {
            topic: SimpleNamespace(last=self.last(topic), writers=self.writers(topic))
            for topic in tuple(self._announcements)
        }

    def ask(self, node, topics, *, depth, deadline_ns):
        """Send a node a newer plan of all these publishers, as a daemon does, and wait until it is taken."""
        row = TopicPlan(rate_hz=math.inf, min_rate_hz=0.0, deadline_ns=deadline_ns, depth=depth)
        generation = next(self._generations)
        self._plans(generation, dict.fromkeys(topics, row))
        eventually(f"{node} takes the plan", lambda: self._heard.answers.get(node) == PlanAnswer(generation))

    def _on_news(self, states):
        for state in states:
            self._announcements[state.topic].append(state)


class Log:
    """Numbers that arrive on each topic, in order, in a separate participant."""

    def __init__(self, world, name, topics=()):
        self.numbers = {topic: [] for topic in (topics or TOPICS.values())}
        node = world.node(name)
        for topic, numbers in self.numbers.items():
            node.create_subscription(
                String, topic, lambda s, n=numbers: n.append(number_of(s)), QoSProfile(depth=5000), raw=True
            )


def settle(world, talker, *logs, first=0):
    """Stop publishing, and wait until the logs have every sample; return the number of samples, from 0 on."""
    sent = talker.tell("publish", is_on=False)
    eventually(
        "the queues are empty", lambda: all(world.shows(t, offered=sent - first, queued=0) for t in TOPICS.values())
    )
    eventually(
        "every log has the last sample",
        lambda: all(log.numbers[t][-1:] == [sent - 1] for log in logs for t in TOPICS.values()),
    )
    return sent


def status(daemon):
    """Return the daemon's status document, empty while it does not answer."""
    try:
        with urllib.request.urlopen(f"{daemon.url}/api/v1/status", timeout=3.0) as answer:
            return json.load(answer)
    except OSError:
        return {}


def ended(state):
    """Count the swaps that ended; ``undelivered`` comes beside a swap's own result."""
    return sum(count for result, count in state.swaps_by_result.items() if result != "undelivered")


def is_gapless(numbers):
    """Return whether these are consecutive numbers, each once and in order."""
    return bool(numbers) and numbers == list(range(numbers[0], numbers[0] + len(numbers)))


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]
