"""The short forms of benchmarks with real rclpy over a real link run to their end, and leave sound documents."""

import os
import subprocess
import sys
import time
from statistics import median

import pytest

pytest.importorskip("pyroute2", reason="pyroute2 is not installed")
pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from scripts.bench.pi_boards import Board
from scripts.bench.pi_cgroup import SlowComputer
from scripts.bench.pi_cgroup import available as slow_available
from scripts.bench.relay import cpu_by_thread
from scripts.bench.swap import ADAPTIVE, EVENTS, WAYS
from scripts.bench.swap_soak import TOPICS
from scripts.netns.simlink import available
from tests.bench.quick import played

CAN, WHY = available()
SLOW = slow_available()
pytestmark = [pytest.mark.link, pytest.mark.ros, pytest.mark.skipif(not CAN, reason=WHY)]


def test_adapt_measures_both_sides_of_a_step_down(tmp_path):
    """Two robots meet a step down; every topic arrives, only arpd estimates, withholds and swaps."""
    picture = tmp_path / "adapt.png"
    document, printed = played(tmp_path, "adapt", "--plot", picture)
    plain, managed = (next(run for run in document["runs"] if run["side"] == side) for side in ("defaults", "arpd"))
    for run in (plain, managed):
        assert len(run["topics"]) == 12
        assert all(topic["received"] > 0 for topic in run["topics"].values())
        assert len(run["ages_over_time_s"]) >= 10
    assert plain["cpu"].keys() == {"sources", "machine"}
    assert managed["cpu"].keys() == {"run", "relay", "peer", "sources", "machine"}
    assert plain["all"]["withheld_ratio"] == 0.0 == plain["swaps"]
    assert managed["all"]["withheld_ratio"] > 0.0
    assert plain["estimate"].keys() == {"start_queue_s", "peak_queue_s", "utilisation"}
    assert 0.0 < managed["estimate"]["reaction_s"] < 3.0
    assert managed["estimate"]["probe_share"] > 0.0
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert str(picture) in printed


def test_discovery_sees_every_participant(tmp_path):
    """At rest ten nodes announce themselves with plain ROS 2; with two ends only arpd's own four participants do."""
    document, printed = played(tmp_path, "discovery")
    plain, two_ended = document["cells"]
    for cell, robot, ceddp in ((plain, 10, 1), (two_ended, 2, 2)):
        sources = [each["from"] for each in cell["participants"]]
        assert (sources.count("robot"), sources.count("ceddp")) == (robot, ceddp)
    packets = {(flow["from"], flow["kind"]): flow["packets"] for flow in plain["flows"]}
    # In 18 s all announce themselves six times, by multicast and to the participants on the other host.
    assert packets["robot", "multicast discovery"] == pytest.approx(60, abs=6)
    assert packets["ceddp", "unicast discovery"] == pytest.approx(60, abs=6)
    assert ("robot", "user data") not in packets
    assert "plain ROS 2" in printed


def test_overhead_measures_every_phase_and_a_plan(tmp_path):
    """Twelve topics at rest, carried and paced, with CPU, memory and bytes of run and peer; plans cost discovery."""
    document, _ = played(tmp_path, "overhead")
    (run,) = document["runs"]
    assert "failed" not in run
    assert [run[count] for count in ("found", "planned", "confirmed")] == [12, 12, 12]
    assert [span["phase"] for span in run["spans"]] == ["rest", "load", "paced"]
    for span in run["spans"]:
        assert span["cpu_share"]["run"] > 0 < span["cpu_share"]["peer"]
        assert span["rss_bytes"]["run"] > 30e6
        assert span["control_bytes_per_second"]["probes"] > 0 < span["control_bytes_per_second"]["reports"]
    start, fall = run["plans"]
    assert start["swaps"] > 0
    assert start["discovery_bytes"] > 0 < start["listener_bytes"]
    assert 0 < fall["price_s"] < 5


def test_paper_reaches_its_rates_and_loses_nothing_with_a_deep_history(tmp_path):
    """Eleven sensors keep the DEADLINE rate, more bytes cross than arrive, and a DEPTH above 1 repairs every loss.

    Under arpd they are paced to what the link carries of twelve topics, and have the DEPTH of Eq. (4).
    """
    document, _ = played(tmp_path, "paper", "--plot", tmp_path / "paper.png")
    assert {path.name for path in tmp_path.iterdir()} == {"paper.json", "paper-latency.png", "paper-loss.png"}
    figures, (live,) = ([run for run in document["runs"] if ("uniform" in run) is is_live] for is_live in (False, True))
    assert sorted(run["depth"] > 1 for run in figures) == [False, True, True]
    found, link = live["uniform"], document["links"][0]
    assert found["topics"] == 12
    # The budget is a part of the link; on a busy machine the estimate of a short run may err by half.
    assert 0.7 < found["max_rate_hz"] / (link["rate_bytes_per_second"] / 1200) < 2.0
    assert found["rate_hz"] == pytest.approx(found["max_rate_hz"] / 12 - 1, rel=0.05)
    assert 400 <= found["depth"] <= 415
    assert live["lost"] == 0 < live["withheld_ratio"]
    for run in document["runs"]:
        assert (run["void"], run["reached_ratio"]) == ("", pytest.approx(1.0, abs=0.05))
        assert run["sensors_cpu"] > 0 < run["planner_cpu"]
        assert run["robot_sent_bytes"] > run["sensing"]["count"] * run["payload_bytes"] > 0
        assert run["end_to_end"]["count"] > 0
        assert run["end_to_end"]["p50_s"] > run["sensing"]["p50_s"] > 0
        assert run["depth"] <= 1 or (run["lost"], run["end_to_end"]["lost_ratio"]) == (0, 0.0)


@pytest.mark.skipif(not SLOW[0], reason=SLOW[1])
def test_pi_slows_the_robot_and_not_its_samples(tmp_path):
    """Twelve topics on a Pi 4 and on this machine: every figure is there, and threads wait for their cores."""
    document, printed = played(tmp_path, "pi")
    assert {run["board"] for run in document["runs"]} == {"Pi 4", "this machine"}
    for run in document["runs"]:
        assert "failed" not in run
        assert run["confirmed"] == 12
        assert run["samples"]["received"] > 0.3 * run["samples"]["sent"] > 0
        assert all(0 < span["latency_s"]["p50"] < span["latency_s"]["p99"] for span in run["spans"])
        assert run["watchdog"]["run"]["is_ready"]
    (slow,) = (run for run in document["runs"] if run["board"] == "Pi 4")
    assert slow["spans"][0]["throttled_share"]["run"] > 0
    assert "| 12 | Pi 4 |" in printed


@pytest.mark.alone
@pytest.mark.skipif(not SLOW[0], reason=SLOW[1])
def test_a_slow_computer_has_slow_cores_and_four_of_them():
    """One thread gets at most the share of one core, and six get at most those of four."""
    for count, cores in ((1, 1), (6, 4)):
        with SlowComputer(Board(name="Pi", share=0.1), f"arpd-test-{os.getpid()}") as slow:
            spinning = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(count)]
            try:
                for number, process in enumerate(spinning):
                    slow.place(str(number), process.pid)
                time.sleep(0.5)
                before = [sum(cpu_by_thread(process.pid).values()) for process in spinning]
                time.sleep(2.0)
                after = [sum(cpu_by_thread(process.pid).values()) for process in spinning]
            finally:
                for process in spinning:
                    process.kill()
                    process.wait()
        # On a busy machine they may get less.
        assert 0.04 * cores < (sum(after) - sum(before)) / 2.0 < 0.13 * cores


def test_relay_measures_one_end_and_two(tmp_path):
    """Both ends carry every message, in two processes; each has CPU, and a second hop takes longer than none."""
    document, printed = played(tmp_path, "relay", "--rounds", "1", "--plot", tmp_path / "relay.png")
    for cell in document["cells"]:
        assert cell["sides"].keys() == {"direct", "bare relay", "one end", "two ends"}
        for name, side in cell["sides"].items():
            # A busy machine may push a sample out of the bare relay's history, which is rclpy's.
            least = 0.9 * side["sent"] if name == "bare relay" else side["sent"]
            assert 0 < least <= side["received"] <= side["sent"], name
        assert [len(side["cpu_s"][0]) for side in cell["sides"].values()] == [0, 1, 1, 2]
        assert all(spent > 0 for side in cell["sides"].values() for turn in side["cpu_s"] for spent in turn)
        direct, two_ends = (median(cell["sides"][side]["latency_s"]) for side in ("direct", "two ends"))
        assert 0 < direct < two_ends
    assert "one end / bare" in printed
    assert (tmp_path / "relay.png").read_bytes().startswith(b"\x89PNG")


def test_swap_loses_no_sample(tmp_path):
    """Each way swaps, and neither a swap nor a soak loses a sample: each comes once and in order."""
    document, _ = played(tmp_path, "swap")
    (cell,) = document["cells"]
    assert set(cell["ways"]) == set(WAYS)
    assert all(way["expected"] > 0 < way["swaps"] for way in cell["ways"].values())
    assert [cell["ways"][ADAPTIVE][event] for event in EVENTS] == [0, 0, 0]
    soaked = document["soak"]
    assert soaked["notes"][-1]["swaps"] >= 100
    assert soaked["received"] == [soaked["sent"]] * len(TOPICS)
    assert sum(soaked["late"]) == 0


def test_two_ends_explain_every_missing_sample(tmp_path):
    """Both ends of a relay die in several states: topics flow again, sets stay whole, and late readers lack nothing."""
    document, printed = played(tmp_path, "two_ends")
    assert document["events"].keys() >= {"kill relay", "kill relay_far", "kill both", "kill run", "outage"}
    assert document["ended_themselves"] == []
    for one in document["topics"].values():
        for writer in one["writers"]:
            # How many go missing beside the deaths is a matter of how long a busy machine takes to start an end again.
            assert writer["received"] > 0.3 * (writer["received"] + writer["missing_otherwise"]) > 0
            assert (writer["doubled"], writer["reordered"], writer["never_again"]) == (0, 0, 0)
            assert writer["writer"] in printed
    assert document["sets"]["received"] > 0
    assert document["sets"]["incomplete"] == document["sets"]["incomplete_beside_a_death"]
    calm = [visit for visit in (*document["demand"], *document["latched"]) if not visit["meanwhile"]]
    assert calm
    assert all(visit["waited_s"] is not None for visit in calm)
    assert not any(visit["lacks"] for visit in document["latched"] if not visit["meanwhile"])
