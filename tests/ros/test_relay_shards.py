"""The process of a relay with more topics than one DDS participant should carry."""

import json
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from std_msgs.msg import String

from arpd.adapters.ros.relay import Relay, _run_one_end
from arpd.adapters.systemd import notify
from arpd.model.settings import RelaySettings
from tests.ros.domain import DOMAIN

pytestmark = pytest.mark.ros

TOPICS = tuple(f"/t{k}" for k in range(250))
NODES = ("/big_relay", "/big_relay_2", "/big_relay_3")


@pytest.fixture
def notices():
    """Return a socket that receives what the relay tells systemd."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as heard:
        heard.bind(f"\0arpd-test-{os.getpid()}-shards")
        heard.settimeout(30.0)
        yield heard


@pytest.fixture
def relay(ros, notices, tmp_path):
    """Start a relay of all topics."""
    config = tmp_path / "arpd.yaml"
    config.write_text(json.dumps({"relay": {"topics": [{"name": topic} for topic in TOPICS]}}))
    environment = {
        "ROS_DOMAIN_ID": str(DOMAIN),
        "NOTIFY_SOCKET": "@" + notices.getsockname()[1:].decode(),
        "WATCHDOG_USEC": "20000000",
    }
    with (
        (tmp_path / "log").open("w") as log,
        subprocess.Popen(
            [sys.executable, "-m", "arpd.cli", "relay", "--config", str(config), "--node-name", "big_relay"],
            env={**os.environ, **environment},
            stderr=log,
        ) as process,
    ):
        yield process
        process.kill()


def until(notices, text):
    """Return the notices to systemd up to this one."""
    said = []
    while not said or said[-1] != text:
        said.append(notices.recv(1 << 20).decode())
    return said


def test_shards_carry_all_topics_as_one_relay(ros, relay, notices, tmp_path, eventually):
    """Three nodes carry 250 topics; status, watchdog and stop are those of one process, and none carries twice."""
    until(notices, "READY=1")
    source, far, received = ros.node("source"), ros.node("far"), dict.fromkeys(TOPICS, 0)

    def listen(topic):
        def count(_message):
            received[topic] += 1

        far.create_subscription(String, f"/link{topic}", count, 10)

    for topic in TOPICS:
        listen(topic)
    publishers = [source.create_publisher(String, topic, 10) for topic in TOPICS]
    until(notices, "STATUS=relaying 250 of 250 topics")
    eventually(lambda: all(far.count_publishers(f"/link{topic}") == 1 for topic in TOPICS))
    eventually(lambda: all(each.get_subscription_count() == 1 for each in publishers))
    carriers = [far.get_publishers_info_by_topic(f"/link{topic}") for topic in TOPICS]
    assert [len(each) for each in carriers] == [1] * len(TOPICS)
    assert {f"/{each[0].node_name}" for each in carriers} == set(NODES)

    def all_arrive():
        for publisher in publishers:
            publisher.publish(String(data="x"))
        time.sleep(0.2)
        return all(received.values())

    eventually(all_arrive)
    announced = [far.get_publishers_info_by_topic("/arpd/publishers")]
    assert {f"/{each.node_name}" for each in announced[0]} == set(NODES)
    assert len(until(notices, "WATCHDOG=1")) >= 1
    relay.send_signal(signal.SIGTERM)
    assert "STOPPING=1" in until(notices, "STOPPING=1")
    assert relay.wait(20) == 0
    log = (tmp_path / "log").read_text()
    assert not re.search("Traceback|Error|failed", log), log


class CountingNotifier:
    """Takes what a service tells systemd."""

    watchdog_period_s = 20.0

    def __init__(self):
        self.beats = 0
        self.is_ready = threading.Event()
        self.ready = self.is_ready.set
        self.status = self.stopping = lambda *_: None

    def watchdog(self):
        self.beats += 1


def test_a_shard_that_hangs_starves_the_watchdog(ros, monkeypatch, background, eventually):
    """While the thread of one shard hangs, systemd gets no watchdog notice, although the other threads go on."""
    monkeypatch.setenv("ROS_DOMAIN_ID", str(DOMAIN))
    monkeypatch.setattr(notify, "_STALE_S", 1.0)
    monkeypatch.setattr(notify, "_BEAT_S", 0.1)
    hang, go_on = threading.Event(), threading.Event()
    discover = Relay._discover

    def discover_or_hang(relay):
        if hang.is_set() and relay._node.get_name() == "slow_2":
            go_on.wait(30)
        discover(relay)

    monkeypatch.setattr(Relay, "_discover", discover_or_hang)
    notifier, addresses = CountingNotifier(), SimpleNamespace(are_outdated=lambda: False)
    settings = RelaySettings(topics=TOPICS)
    background(lambda stopping: _run_one_end(settings, "slow", notifier, stopping, addresses))
    assert notifier.is_ready.wait(20)
    eventually(lambda: notifier.beats > 10)
    hang.set()
    time.sleep(2.5)
    before = notifier.beats
    time.sleep(1.0)
    assert notifier.beats == before
    hang.clear()
    go_on.set()
    eventually(lambda: notifier.beats > before + 5)
