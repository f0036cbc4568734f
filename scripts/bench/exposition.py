"""Time `/metrics` with many topics, beside prometheus_client alone, and the lateness of ticks under scrapes.

Usage: .venv/bin/python scripts/bench/exposition.py [--quick] [--json FILE]

First, the time to write the text, by turns: arpd's from a snapshot, and the same samples from prometheus_client's own
gauges and counters, by its own encoder. Second, a daemon in a process of its own that ticks ten times a second and
serves HTTP, by turns without scrapers, with one and with four. A scraper asks again a quarter of a second after its
last request, or at once if the answer took longer: sixty times as often as Prometheus.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path
from statistics import mean, median
from typing import TYPE_CHECKING, Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from prometheus_client import CollectorRegistry, Counter, Gauge, disable_created_metrics
from prometheus_client.exposition import choose_encoder as library_encoder

from arpd.adapters.http.exposition import choose_encoder
from arpd.adapters.http.metrics import SnapshotCollector
from arpd.cli.progress import progress
from arpd.daemon.tick import TICK_S
from scripts.bench.exposition_daemon import crowded_daemon
from scripts.bench.record import REPO, conditions, keep, options_of

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

FORMATS = {"text": "text/plain;version=0.0.4", "OpenMetrics": "application/openmetrics-text;version=1.0.0"}
ARPD, LIBRARY = "arpd", "prometheus_client"
#: topics → turns
TURNS = {12: 30, 100: 30, 1000: 21}
QUICK_TURNS = {12: 5, 100: 5}
SCRAPERS = (0, 1, 4)
ROUNDS, ROUND_S = 8, 10.0
QUICK_ROUNDS, QUICK_ROUND_S = 1, 3.0
EVERY_S = 0.25
CROWD, QUICK_CROWD = 1000, 100
#: Runs in a process of its own with few imports; sends Prometheus's request.
SCRAPER = """
import http.client, json, sys, time
url, accept, every_s, for_s = sys.argv[1], sys.argv[2], float(sys.argv[3]), float(sys.argv[4])
print(flush=True)
sys.stdin.readline()
end_s, spent = time.monotonic() + for_s, []
while (began_s := time.monotonic()) < end_s:
    connection = http.client.HTTPConnection(url.removeprefix("http://"), timeout=30.0)
    connection.request("GET", "/metrics", headers={"Accept": accept, "Accept-Encoding": "gzip"})
    connection.getresponse().read()
    connection.close()
    spent.append(time.monotonic() - began_s)
    time.sleep(max(0.0, began_s + every_s - time.monotonic()))
print(json.dumps(spent))
"""


def as_many(registry: CollectorRegistry) -> CollectorRegistry:
    """Return a registry of prometheus_client's own metrics with the same samples, names and labels."""
    disable_created_metrics()  # arpd has none either
    bare = CollectorRegistry()
    for family in registry.collect():
        samples = [sample for sample in family.samples if not sample.name.endswith(("_bucket", "_sum", "_count"))]
        if not samples:
            continue
        labels = tuple(samples[0].labels)
        kind = Counter if family.type == "counter" else Gauge
        metric = kind(family.name, family.documentation, labels, registry=bare)
        for sample in samples:
            child = metric.labels(**sample.labels) if labels else metric
            child.inc(sample.value) if isinstance(child, Counter) else child.set(sample.value)
    return bare


def race(topics: int, turns: int) -> dict[str, Any]:
    """Time both sides in both formats, by turns in rotating order."""
    snapshot = crowded_daemon(topics).snapshot
    registry = CollectorRegistry()
    registry.register(SnapshotCollector(lambda: snapshot))
    bare = as_many(registry)
    sides: dict[tuple[str, str], Callable[[], bytes]] = {}
    for form, accept in FORMATS.items():
        ours, theirs = choose_encoder(accept)[0], library_encoder(accept)[0]
        sides[form, ARPD] = lambda encode=ours: encode(registry)  # type: ignore[misc]
        sides[form, LIBRARY] = lambda encode=theirs: encode(bare)  # type: ignore[misc]
    seconds: dict[tuple[str, str], list[float]] = {side: [] for side in sides}
    cpu_seconds: dict[tuple[str, str], list[float]] = {side: [] for side in sides}
    order = list(sides)
    for turn in range(turns + 1):
        order = order[1:] + order[:1]
        for side in order:
            started, cpu_started = time.perf_counter(), time.process_time()
            sides[side]()
            if turn:
                seconds[side].append(time.perf_counter() - started)
                cpu_seconds[side].append(time.process_time() - cpu_started)
    return {
        "topics": topics,
        "turns": turns,
        "samples": sum(len(family.samples) for family in registry.collect()),
        "library_samples": sum(len(family.samples) for family in bare.collect()),
        "bytes": len(sides["text", ARPD]()),
        "median_s": {form: {side: median(seconds[form, side]) for side in (ARPD, LIBRARY)} for form in FORMATS},
        "median_cpu_s": {form: {side: median(cpu_seconds[form, side]) for side in (ARPD, LIBRARY)} for form in FORMATS},
        "median_ratio": {
            form: median(a / b for a, b in zip(seconds[form, ARPD], seconds[form, LIBRARY], strict=True))
            for form in FORMATS
        },
    }


class DaemonProcess:
    """A daemon with many topics, in a process of its own."""

    def __init__(self, topics: int) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-u", "-m", "scripts.bench.exposition_daemon", str(topics)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            cwd=REPO,
            env={**os.environ, "PYTHONPATH": str(REPO)},
        )
        self.url: str = self._answer()["url"]

    def since_last(self) -> dict[str, Any]:
        """Return lateness and duration of the ticks since the last call (s)."""
        assert self._process.stdin is not None
        print(file=self._process.stdin, flush=True)
        return self._answer()

    def stop(self) -> None:
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._process.wait(10.0)

    def _answer(self) -> dict[str, Any]:
        assert self._process.stdout is not None
        answer: dict[str, Any] = json.loads(self._process.stdout.readline())
        return answer


def under(daemon: DaemonProcess, scrapers: int, for_s: float) -> dict[str, Any]:
    """Let the daemon tick for a while under so many scrapers."""
    command = [sys.executable, "-c", SCRAPER, daemon.url, FORMATS["OpenMetrics"], str(EVERY_S), str(for_s)]
    running = [
        subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) for _ in range(scrapers)
    ]
    for each in running:
        assert each.stdout is not None
        each.stdout.readline()  # its imports are done
    daemon.since_last()
    spent: list[float] = []
    if running:
        for each in running:
            assert each.stdin is not None
            print(file=each.stdin, flush=True)
        for each in running:
            spent += json.loads(each.communicate()[0])
    else:
        time.sleep(for_s)
    return {"scrape_s": spent, **daemon.since_last()}


def ticking(topics: int, rounds: int, for_s: float) -> dict[str, Any]:
    """Measure ticks with and without scrapers, by turns in rotating order."""
    daemon = DaemonProcess(topics)
    try:
        time.sleep(5.0)  # until the plan is confirmed
        found: dict[int, list[dict[str, Any]]] = {scrapers: [] for scrapers in SCRAPERS}
        order = list(SCRAPERS)
        for _ in range(rounds):
            order = order[1:] + order[:1]
            for scrapers in order:
                found[scrapers].append(under(daemon, scrapers, for_s))
    finally:
        daemon.stop()
    return {
        "topics": topics,
        "planned": found[0][-1]["planned"],
        "round_s": for_s,
        "by_scrapers": {str(scrapers): digest(each) for scrapers, each in found.items()},
    }


def digest(rounds: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return the figures over all rounds with one number of scrapers."""
    late_s = sorted(late for each in rounds for late in each["late_s"])
    tick_s = sorted(tick for each in rounds for tick in each["tick_s"])
    scrape_s = sorted(second for each in rounds for second in each["scrape_s"])
    return {
        "ticks": len(late_s),
        "late_share": mean(late > TICK_S / 2 for late in late_s),
        "late_share_by_round": [mean(late > TICK_S / 2 for late in each["late_s"]) for each in rounds],
        "lateness_mean_s": mean(late_s),
        "lateness_p99_s": late_s[int(0.99 * len(late_s))],
        "lateness_worst_s": late_s[-1],
        "tick_median_s": median(tick_s),
        "tick_p99_s": tick_s[int(0.99 * len(tick_s))],
        "scrapes": len(scrape_s),
        "scrape_median_s": median(scrape_s) if scrape_s else None,
        "scrape_p99_s": scrape_s[int(0.99 * len(scrape_s))] if scrape_s else None,
    }


def table(races: Sequence[dict[str, Any]], ticks: dict[str, Any]) -> str:
    lines = [
        f"{'topics':>7}{'samples':>9}{'MB':>6}  {'format':<12}{'arpd ms':>9}{'prometheus_client ms':>22}{'ratio':>7}"
    ]
    lines += [
        f"{race['topics']:>7}{race['samples']:>9}{race['bytes'] / 1e6:>6.1f}  {form:<12}"
        f"{spent[ARPD] * 1e3:>9.1f}{spent[LIBRARY] * 1e3:>22.1f}{race['median_ratio'][form]:>7.2f}"
        for race in races
        for form, spent in race["median_s"].items()
    ]
    lines += [
        "",
        f"ticks of a daemon with {ticks['topics']} topics, ten a second",
        (
            f"{'scrapers':>9}{'ticks':>7}{'late %':>8}{'late ms: mean':>15}{'p99':>7}{'worst':>7}"
            f"{'tick ms: median':>17}{'p99':>7}{'scrape ms: median':>19}{'p99':>7}"
        ),
    ]
    for scrapers, found in ticks["by_scrapers"].items():
        scraped = ""
        if found["scrapes"]:
            scraped = f"{found['scrape_median_s'] * 1e3:>19.0f}{found['scrape_p99_s'] * 1e3:>7.0f}"
        lines.append(
            f"{scrapers:>9}{found['ticks']:>7}{found['late_share']:>8.1%}{found['lateness_mean_s'] * 1e3:>15.2f}"
            f"{found['lateness_p99_s'] * 1e3:>7.1f}{found['lateness_worst_s'] * 1e3:>7.1f}"
            f"{found['tick_median_s'] * 1e3:>17.1f}{found['tick_p99_s'] * 1e3:>7.1f}{scraped}"
        )
    return "\n".join(lines)


def main() -> None:
    options = options_of(__doc__, "exposition", quick="up to a hundred topics, half a minute").parse_args()
    noted = conditions()
    races = []
    sizes = QUICK_TURNS if options.quick else TURNS
    with progress("writing /metrics", total=len(sizes)) as shown:
        for topics, turns in sizes.items():
            shown.step(f"{topics} topics")
            races.append(race(topics, turns))
    rounds, round_s, crowd = (QUICK_ROUNDS, QUICK_ROUND_S, QUICK_CROWD) if options.quick else (ROUNDS, ROUND_S, CROWD)
    with progress(f"ticking, {rounds * len(SCRAPERS) * round_s:.0f} s"):
        ticks = ticking(crowd, rounds, round_s)
    print(table(races, ticks))
    document = {"conditions": noted, "races": races, "ticking": ticks}
    keep(document, options, "exposition", is_partial=options.quick)


if __name__ == "__main__":
    main()
