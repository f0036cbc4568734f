"""The whole of arpd on a real link; compares rates and times, so no other test may run beside it."""

import json
import signal
import statistics
import subprocess
import sys
import time
import urllib.request

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from arpd.adapters.sim.demo import COMMAND_TOPIC
from scripts.netns.simlink import available
from scripts.robot.run import REPO
from tests.link.live_robot import HEAVY, SLOW, SOURCES, is_confirmed, live_robot, topics
from tests.waiting import eventually

CAN, WHY = available()
pytestmark = [pytest.mark.alone, pytest.mark.link, pytest.mark.ros, pytest.mark.skipif(not CAN, reason=WHY)]

UPLOAD = 2e6 / 8
# An application without ROS: full datagrams at a constant rate of wire bytes.
SENDER = """
import socket, sys, time
address, rate, duration_s = sys.argv[1], float(sys.argv[2]), float(sys.argv[3])
sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
started_s, sent = time.monotonic(), 0
while (elapsed_s := time.monotonic() - started_s) < duration_s:
    while sent * 1514 < elapsed_s * rate:
        sender.sendto(bytes(1472), (address, 9))
        sent += 1
    time.sleep(0.005)
"""


@pytest.fixture
def side(tmp_path):
    with live_robot(tmp_path) as side:
        yield side


def test_a_drop_changes_the_qos_of_live_publishers_without_losing_a_command(side):
    """At a drop from 20 to 5 Mbit/s rates fall without a plan, then longer deadlines follow; no command is lost."""
    eventually(lambda: is_confirmed(side))
    before = topics(side)
    pids = {name: process.pid for name, process in side.processes.items()}
    for topic in before.values():
        assert topic["confirmed"]["depth"] != topic["baseline"]["depth"] or topic["confirmed"]["deadline_ns"], topic
        assert sum(topic["swaps"].values()) >= 1, topic

    side.link.set_rate(SLOW)
    paced = []  # the rates and generations of the heavy topics once all of them are slowed

    def are_slowed():
        now = topics(side)
        paced[:] = [now[name]["confirmed"] for name in HEAVY if name in now]
        return len(paced) == len(HEAVY) and all(
            now[name]["confirmed"]["paced_rate_hz"] < 0.8 * before[name]["confirmed"]["paced_rate_hz"] for name in HEAVY
        )

    eventually(are_slowed)
    assert {each["generation"] for each in paced} == {before[name]["confirmed"]["generation"] for name in HEAVY}

    def has_settled():
        now = topics(side)
        return is_confirmed(side) and all(
            now[name]["confirmed"]["deadline_ns"] > before[name]["confirmed"]["deadline_ns"] for name in HEAVY
        )

    eventually(has_settled)
    after = topics(side)
    for name in HEAVY:
        assert after[name]["confirmed"]["generation"] > before[name]["confirmed"]["generation"], name
        assert after[name]["swaps"] != before[name]["swaps"], name
    estimates = []
    for _ in range(5):
        estimates.append(side.status()["link"]["capacity_bytes_per_second"])
        time.sleep(0.4)
    assert 0.75 * SLOW < statistics.median(estimates) < 1.25 * SLOW
    # The application continued: same processes, counters without a restart.
    assert all(process.poll() is None and process.pid == pids[name] for name, process in side.processes.items())
    assert all(after[name]["offered"] > before[name]["offered"] for name in HEAVY)

    time.sleep(2.0)
    side.signal(signal.SIGUSR2, *SOURCES)
    time.sleep(3.0)
    published = topics(side)[COMMAND_TOPIC]["published"]
    side.stop("base_driver")
    commands = side.result("base_driver")["received"][COMMAND_TOPIC]
    assert commands["received"] == published
    assert commands["doubled"] == 0


def metric(side, name):
    with urllib.request.urlopen(f"{side.url}/metrics", timeout=5) as answer:
        samples = dict(line.rsplit(" ", 1) for line in answer.read().decode().splitlines() if line[0] != "#")
    return float(samples[name])


def test_foreign_traffic_gets_room_and_gives_it_back(side):
    """Budget and plan yield to an upload beside ROS, and both return when the upload ends."""
    side.link.set_rate(SLOW)
    eventually(lambda: 0.75 * SLOW < metric(side, "arpd_link_capacity_bytes_per_second") < 1.25 * SLOW)

    def is_whole(what):
        return 0.75 * SLOW < metric(side, what) < 1.25 * SLOW

    # The discovery of the first swaps counts as foreign for a moment, so the first plan may be for less than the link.
    eventually(lambda: is_confirmed(side) and is_whole("arpd_level_bytes_per_second"), timeout_s=100.0)
    eventually(lambda: metric(side, "arpd_link_foreign_bytes_per_second") < 0.1 * UPLOAD)

    argv = [sys.executable, "-c", SENDER, side.link.ceddp.address, str(UPLOAD), "120"]
    upload = side.link.popen("robot", argv)

    def has_yielded(what):
        seen, usable = metric(side, "arpd_link_foreign_bytes_per_second"), metric(side, what)
        return 0.6 * UPLOAD < seen < 1.4 * UPLOAD and usable + UPLOAD < 1.05 * SLOW

    eventually(lambda: has_yielded("arpd_link_budget_bytes_per_second"))
    eventually(lambda: has_yielded("arpd_level_bytes_per_second"), timeout_s=100.0)  # the plan is for what lasts
    assert upload.poll() is None, "the upload had ended by then"
    upload.terminate()
    eventually(lambda: metric(side, "arpd_link_foreign_bytes_per_second") < 0.1 * UPLOAD)
    eventually(lambda: is_whole("arpd_link_budget_bytes_per_second"))
    eventually(lambda: is_confirmed(side) and is_whole("arpd_level_bytes_per_second"), timeout_s=100.0)


def test_the_demo_keeps_its_promise():
    """In `scripts/demo --quick` arpd is better on every topic that the link cannot carry, and commands do not wait."""
    demo = subprocess.run(
        [REPO / "scripts/demo", "--quick", "--json"], capture_output=True, text=True, check=False, timeout=240
    )
    assert demo.returncode == 0, demo.stderr
    document = json.loads(demo.stdout)
    rows = {topic["topic"]: topic for topic in document["topics"]}
    overloaded = [topic for topic in rows.values() if topic["is_overloaded"]]
    assert len(overloaded) >= 4
    # With fewer than 300 samples, the p99 is one or two samples at the drop, which is luck.
    often = [topic for topic in overloaded if topic["with"]["offered"] >= 300]
    assert all(topic["is_better"] for topic in often), document
    worst = max(topic["without"]["latency_p99_s"] for topic in overloaded)
    assert all(topic["with"]["latency_p99_s"] < worst and topic["with"]["lost"] == 0 for topic in overloaded), document
    camera, command = rows["/camera/image/compressed"], rows[COMMAND_TOPIC]
    assert camera["with"]["loss_ratio"] < camera["without"]["loss_ratio"]
    assert camera["with"]["age_p99_s"] < camera["without"]["age_p99_s"] / 5
    # A command that waited behind an image would be as late as the image.
    assert command["with"]["latency_p99_s"] < camera["with"]["latency_p99_s"] / 2
    assert command["with"]["loss_ratio"] == 0
