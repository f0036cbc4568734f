"""Load the HTTP server of a daemon with many topics, and read how late its ticks begin.

Usage: .venv/bin/python scripts/bench/http_load.py [--quick] [--json FILE]

A daemon in a process of its own ticks ten times a second. Another process is its clients, by turns none, those that it
is made for, and those that mean harm. Beside each load one scraper asks for `/metrics` four times a second, or as often
as it is answered; Prometheus asks every 15 s. The lateness is the daemon's own: `arpd_tick_lateness_seconds` before and
after.
"""

from __future__ import annotations

import json
import math
import os
import ssl
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import ExitStack, contextmanager
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Any
from urllib.request import urlopen

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from prometheus_client.parser import text_string_to_metric_families

from arpd.cli.progress import progress
from scripts.bench.http_clients import LOADS, Load
from scripts.bench.record import REPO, conditions, keep, options_of
from scripts.bench.report import Target, about, milli, paragraphs, table, targets

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

TOPICS, ROUNDS, ROUND_S = 1000, 2, 10.0
QUICK_TOPICS, QUICK_ROUNDS, QUICK_ROUND_S = 100, 1, 3.0  # the daemon counts ticks in turns of up to 2 s
SETTLED_S = 3.0  # until the plan is confirmed
NO_LOAD = "nothing, and no scraper"
RENEWED = "TLS, a new certificate each second"
TARGET_SCRAPE_S = 1.0
ON_TIME_S = 0.05  # above it a tick counts as late


@contextmanager
def daemon(topics: int, folder: Path, *, has_tls: bool) -> Iterator[str]:
    """Run a daemon while the block lasts; yields its URL."""
    arguments = [str(topics)]
    if has_tls:
        renew(folder)
        config = folder / "web-config.yaml"
        config.write_text("tls_server_config: {cert_file: robot.crt, key_file: robot.key}\n", encoding="utf-8")
        arguments.append(str(config))
    process = subprocess.Popen(
        [sys.executable, "-m", "scripts.bench.crowded_daemon", *arguments],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        cwd=REPO,
        env={**os.environ, "PYTHONPATH": str(REPO)},
    )
    with process:
        assert process.stdout is not None
        assert process.stdin is not None
        yield process.stdout.readline().strip()
        process.stdin.close()


def renew(folder: Path) -> None:
    """Put a new certificate and its key in the place of the old."""
    command = ["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes"]
    command += ["-subj", "/CN=robot", "-keyout", "new.key", "-out", "new.crt"]
    subprocess.run(command, cwd=folder, check=True, capture_output=True)
    for name in ("key", "crt"):
        (folder / f"new.{name}").replace(folder / f"robot.{name}")


@contextmanager
def renewing(folder: Path) -> Iterator[None]:
    """Renew the certificate every second while the block lasts."""
    end = threading.Event()

    def run() -> None:
        while not end.wait(1.0):
            renew(folder)

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield
    finally:
        end.set()
        thread.join()


def counts(url: str) -> dict[str, float]:
    """Return what the daemon counts: ticks by lateness and duration, connections refused, answers."""
    trusting = ssl.create_default_context()
    trusting.check_hostname, trusting.verify_mode = False, ssl.CERT_NONE
    with urlopen(f"{url}/metrics", context=trusting, timeout=60.0) as answer:
        text = answer.read().decode()
    names = ("arpd_tick_lateness_seconds", "arpd_tick_duration_seconds", "arpd_http_connections_refused")
    return {
        f"{sample.name} {' '.join(sample.labels.values())}".strip(): sample.value
        for family in text_string_to_metric_families(text)
        if family.name in names
        for sample in family.samples
    }


def under(url: str, load: Load | None, for_s: float) -> dict[str, Any]:
    """Let the daemon tick for a while under a load."""
    before = counts(url)
    spent: dict[str, Any] = {"scrape_s": [], "failed": 0}
    if load is None:
        time.sleep(for_s)
    else:
        command = [sys.executable, "-m", "scripts.bench.http_clients", url, load.name, str(for_s)]
        spent = json.loads(subprocess.run(command, cwd=REPO, check=True, capture_output=True, text=True).stdout)
    after = counts(url)
    return {**spent, "counted": {name: after[name] - before.get(name, 0.0) for name in after}}


def digest(rounds: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return the figures over all rounds with one load."""
    counted = {name: sum(each["counted"].get(name, 0.0) for each in rounds) for name in rounds[0]["counted"]}
    scrape_s = sorted(second for each in rounds for second in each["scrape_s"])
    ticks = counted["arpd_tick_lateness_seconds_count"]
    refused = "arpd_http_connections_refused_total "
    return {
        "ticks": int(ticks),
        "late": int(ticks - counted[f"arpd_tick_lateness_seconds_bucket {ON_TIME_S}"]),
        "lateness_mean_s": counted["arpd_tick_lateness_seconds_sum"] / ticks,
        "tick_mean_s": counted["arpd_tick_duration_seconds_sum"] / counted["arpd_tick_duration_seconds_count"],
        "refused": {name.removeprefix(refused): int(n) for name, n in counted.items() if name.startswith(refused) if n},
        "scrapes": len(scrape_s),
        "scrapes_failed": sum(each["failed"] for each in rounds),
        "scrape_median_s": median(scrape_s) if scrape_s else None,
        "scrape_p99_s": scrape_s[int(0.99 * len(scrape_s))] if scrape_s else None,
    }


def measured(topics: int, rounds: int, for_s: float) -> dict[str, dict[str, Any]]:
    """Measure every load, by turns in rotating order, then those over TLS."""
    found: dict[str, list[dict[str, Any]]] = {}
    plain: list[Load | None] = [None, *(load for load in LOADS if not load.has_tls)]
    sealed: list[Load | None] = [load for load in LOADS if load.has_tls]
    with progress("loads", total=rounds * (len(plain) + len(sealed))) as shown:
        for loads in (plain, sealed):
            with tempfile.TemporaryDirectory() as name, daemon(topics, Path(name), has_tls=loads is sealed) as url:
                time.sleep(SETTLED_S)
                for turn in range(rounds):
                    for load in loads[turn:] + loads[:turn]:
                        name_of = NO_LOAD if load is None else load.name
                        shown.step(name_of)
                        with ExitStack() as stack:
                            if name_of == RENEWED:
                                stack.enter_context(renewing(Path(name)))
                            found.setdefault(name_of, []).append(under(url, load, for_s))
    return {name: digest(each) for name, each in found.items()}


def report(document: dict[str, Any]) -> str:
    loads = {name: {"load": name, **each} for name, each in document["loads"].items()}
    late = max(loads.values(), key=lambda each: each["late"])
    scraped = [each for each in loads.values() if each["scrapes"] + each["scrapes_failed"]]
    # A load under which every scrape fails has no time.
    slowest = max(scraped, key=lambda each: each["scrape_p99_s"] or math.inf)
    alone = loads[LOADS[0].name]
    return paragraphs(
        about(document, f"A daemon with {document['topics']:,} topics"),
        targets(
            [
                Target(f"ticks that begin more than {ON_TIME_S * 1e3:.0f} ms late, one scraper", alone["late"], 0),
                Target("the same under any load", late["late"], 0),
                Target("`/metrics`, one scraper, p99", alone["scrape_p99_s"], TARGET_SCRAPE_S, "{:.2f} s"),
                Target("the same under any load", slowest["scrape_p99_s"], TARGET_SCRAPE_S, "{:.2f} s"),
                Target("scrapes that failed, one scraper", alone["scrapes_failed"], 0),
            ]
        ),
        table(
            loads.values(),
            ("load", "load"),
            ("ticks", "ticks"),
            ("late", "late"),
            ("lateness ms, mean", "lateness_mean_s", milli),
            ("tick ms, mean", "tick_mean_s", milli),
            ("scrapes", "scrapes"),
            ("failed", "scrapes_failed"),
            ("ms, median", "scrape_median_s", milli),
            ("p99", "scrape_p99_s", milli),
        ),
    )


def main() -> None:
    options = options_of(__doc__, "http_load", quick="a hundred topics, three seconds for each load").parse_args()
    noted = conditions()
    topics, rounds, for_s = (QUICK_TOPICS, QUICK_ROUNDS, QUICK_ROUND_S) if options.quick else (TOPICS, ROUNDS, ROUND_S)
    document = {"conditions": noted, "topics": topics, "loads": measured(topics, rounds, for_s)}
    keep(document, options, "http_load", is_partial=options.quick)
    print(report(document))


if __name__ == "__main__":
    main()
