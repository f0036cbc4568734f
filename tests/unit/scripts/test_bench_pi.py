"""The maths of the benchmark on a Raspberry Pi's share, from made figures and made folders; a real one needs root."""

import pytest

from arpd.model.errors import ArpdError
from scripts.bench.pi import busiest, report, sizes
from scripts.bench.pi_boards import CORES, MEMORY_BYTES, PI_4_S, SOURCES, THIS, Board, boards
from scripts.bench.pi_cgroup import SlowComputer
from scripts.bench.pi_watchdog import Watchdogs
from scripts.bench.record import conditions

PI_4 = Board(name="Pi 4", share=0.2)


def span(phase):
    return {
        "phase": phase,
        "cpu_share": {"run": 0.05, "relay0": 0.1, "peer": 0.01, "source": 0.05, "sink": 0.02},
        "latency_s": {"p50": 0.002, "p99": 0.030},
        "throttled_share": {"run": 0.1, "relay0": 0.2, "source": 0.0},
    }


def run(board, *, topics=12, late=0, received=9_000, withheld=990, restarts=0, price_s=0.1, **changes):
    return {
        "round": 0,
        "topics": topics,
        "board": board,
        "spans": [span("load"), span("paced")],
        "confirmed": topics,
        "fall": {"price_s": price_s, "plan_s": 3.0, "confirmed_s": 5.0},
        "ticks": {"ticks": 1000, "ticks_late": late},
        "samples": {"expected": 10_000.0, "sent": 10_000, "withheld": withheld, "received": received},
        "watchdog": {"run": {"restarts": restarts, "longest_s": 1.2, "is_ready": True}},
    } | changes


def document(*runs):
    found = [{"name": "Pi 4", "share": 0.2, "quota_us": [1000, 5000]}, {"name": THIS.name, "share": None}]
    return {
        "conditions": conditions(),
        "reference_s": {"python3": 15.8},
        "sources": SOURCES,
        "boards": found,
        "cores": CORES,
        "memory_bytes": MEMORY_BYTES,
        "runs": list(runs),
    }


def test_a_board_is_as_slow_as_its_time_says():
    """A Pi 4 that takes five times as long has a fifth of a core; a slow machine has no quota above one core."""
    found = boards(PI_4_S / 5)
    assert found["pi4"].share == pytest.approx(0.2)
    assert found["pi5"].share == pytest.approx(0.2 * 2967 / 1769)
    assert found["none"].share is None
    assert boards(1000.0)["pi4"].share == 1.0


@pytest.mark.parametrize("share", [0.05, 0.19, 0.2, 0.34, 1.0])
def test_a_quota_is_the_share_of_a_short_period(share):
    """The kernel takes no quota below a millisecond, so a slower core has a longer period."""
    board = Board(name="x", share=share)
    quota_us, period_us = board.quota()
    assert quota_us >= 1000
    assert 5000 <= period_us <= 20_000
    assert quota_us / period_us == pytest.approx(share, rel=1e-3)
    assert board.quota(4)[0] == pytest.approx(4 * quota_us, abs=4)


def host(root, version):
    """Make the folders of a host's control groups, and of a process with two threads."""
    if version == 1:
        for controller in ("cpu", "memory"):
            (root / "groups" / controller).mkdir(parents=True)
            (root / "groups" / controller / "cgroup.procs").touch()
    else:
        (root / "groups").mkdir()
    for thread in (70, 71):
        (root / "proc/70/task" / str(thread)).mkdir(parents=True)
    return {"root": root / "groups", "tasks": root / "proc"}


@pytest.mark.parametrize(
    ("version", "written"),
    [
        (
            1,
            {
                "cpu/pi/cpu.cfs_quota_us": "4000",
                "cpu/pi/t71/cpu.cfs_quota_us": "1000",
                "cpu/pi/t71/tasks": "71",
                "memory/pi/memory.limit_in_bytes": str(2**30),
            },
        ),
        (
            2,
            {
                "pi/cpu.max": "4000 5000",
                "pi/t71/cpu.max": "1000 5000",
                "pi/t71/cgroup.type": "threaded",
                "pi/t71/cgroup.threads": "71",
                "pi/memory.max": str(2**30),
            },
        ),
    ],
)
def test_every_thread_has_a_core_of_its_own(tmp_path, monkeypatch, version, written):
    """All threads have four cores, and each has one; a limit of memory holds for all; both versions of groups work."""
    found = host(tmp_path, version)
    monkeypatch.setattr(SlowComputer, "_keep_sweeping", lambda self: None)
    with SlowComputer(PI_4, "pi", **found) as slow:
        slow.place("run", 70)
        slow.sweep()
        assert {path: (found["root"] / path).read_text() for path in written} == written
        assert slow.throttled() == {"run": {70: 0, 71: 0}}
        slow._threads.clear()  # plain folders with files cannot be removed as groups can
        slow._cpu = slow._memory = tmp_path / "gone"


def test_without_a_quota_nothing_is_limited(tmp_path):
    """There are no groups for this machine."""
    found = host(tmp_path, 1)
    with SlowComputer(THIS, "pi", **found) as slow:
        slow.place("run", 70)
        assert not (found["root"] / "cpu/pi").exists()
        assert slow.throttled() == {}


def test_the_busiest_thread_counts():
    """A thread that began meanwhile counts from zero."""
    assert busiest({1: 10, 2: 5}, {1: 12, 2: 9, 3: 3}) == 4
    assert busiest({}, {}) == 0


def test_the_watchdog_restarts_after_its_period(tmp_path):
    """It counts from READY on, each longer silence once, and knows the silence that still lasts."""
    now_s = [0.0]
    watchdogs = Watchdogs(tmp_path, {"run": 10.0}, clock=lambda: now_s[0])
    for at_s, message in [(5.0, "WATCHDOG=1"), (20.0, "READY=1\nSTATUS=x"), (29.0, "WATCHDOG=1"), (41.0, "WATCHDOG=1")]:
        now_s[0] = at_s
        watchdogs.hear("run", message)
    assert watchdogs.report() == {"run": {"restarts": 1, "longest_s": 12.0, "is_ready": True}}
    now_s[0] = 60.0
    assert watchdogs.report()["run"]["longest_s"] == 19.0
    assert watchdogs.environment("peer") == {}
    assert watchdogs.environment("run")["WATCHDOG_USEC"] == "10000000"


@pytest.mark.parametrize(
    ("changes", "fault"),
    [
        ({}, None),
        ({"late": 11}, "late ticks"),
        ({"received": 8_900}, "more lost"),
        ({"restarts": 2}, "restarts"),
        ({"price_s": None}, "price"),
        ({"price_s": 0.6}, "price"),
        ({"confirmed": 11}, "publishers confirmed"),
        ({"samples": {"expected": 20_000.0, "sent": 10_000, "withheld": 0, "received": 10_000}}, "samples published"),
        ({"failed": "gone"}, "failed: gone"),
    ],
)
def test_what_does_not_hold_is_named(changes, fault):
    """Late ticks, more losses than without a quota, restarts, a slow price, and sources that are too slow."""
    found = sizes(document(run("Pi 4", **changes), run(THIS.name)))
    assert ("| 12 | holds | holds |" in found) is (fault is None)
    assert fault is None or f"| 12 | {fault}" in found


def test_figures_are_in_parts_of_the_boards_core():
    """A twentieth of a core of this machine is a quarter of a Pi 4's."""
    row = next(line for line in report(document(run("Pi 4"))).splitlines() if "| 12 | Pi 4 |" in line)
    assert "| 25.0 | 50.0 |" in row


def test_a_host_without_control_groups_is_named(tmp_path):
    """Without a controller of CPU there is nothing to compare."""
    with pytest.raises(ArpdError, match="control groups"), SlowComputer(PI_4, "pi", root=tmp_path / "none"):
        pass
