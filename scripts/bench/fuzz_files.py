"""Fuzz targets that are files: configurations, a saved status, link traces."""

from __future__ import annotations

import json
import math
from typing import TYPE_CHECKING

from scripts.bench.fuzz_target import FAULT, Fuzzable, insist, memory_file
from scripts.bench.record import REPO

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path


def config() -> Fuzzable:
    """Feed a configuration: arpd makes settings of it, or names each fault in one clear line."""
    import yaml

    from arpd.adapters.config.load import load_settings
    from arpd.adapters.config.schema import SECTIONS

    keys = {key for section in SECTIONS.values() for key in section.model_fields}
    shipped = yaml.safe_load((REPO / "etc/arpd/arpd.yaml").read_bytes())
    seeds = [
        yaml.safe_dump(shipped).encode(),  # without comments: the fuzzer runs more short inputs than long ones
        b"link: {interface: wlan0, capacity: 8mbit}\nrelay: {topics: [{name: /camera, overflow: queue}]}\n",
        b"relay: {link_domain: 7, robot: a, deny: [/x/**], groups: [{topics: [/a, /b]}], services: ['/*/s']}\n",
        b"a: &a [x, x]\nb: &b [*a, *a]\nc: [*b, *b]\n",
        b"- " * 100,
        b"topics: [" + b"{name: /a}, " * 10 + b"]",
    ]
    words = (
        ": ",
        "- ",
        "\n  ",
        "!!python/object:",
        "&a",
        "*a",
        "<<",
        "20mbit",
        "200ms",
        "1MiB",
        ".inf",
        ".nan",
        "none",
    )
    feed = _feed_config(lambda path: load_settings(path, interfaces=lambda: ("wlan0",)))
    return Fuzzable(feed=feed, seeds=tuple(seeds), words=(*sorted(keys), *words))


def status_file() -> Fuzzable:
    """Feed a saved status: arpd makes publishers of it, or refuses it in one line."""
    from arpd.cli.status_file import read_status
    from arpd.model.errors import ArpdError

    path = memory_file()

    def feed(data: bytes) -> None:
        path.write_bytes(data)
        try:
            publishers = read_status(path).publishers
        except ArpdError as error:
            insist("\n" not in str(error), f"one line: {error}")
            return
        insist(all(math.isfinite(p.payload_bytes + p.source_rate_hz) for p in publishers), "finite numbers")

    row = {
        "node": "/lidar",
        "topic": "/scan",
        "direction": "sensing",
        "payload_bytes": 5828.0,
        "source_rate_hz": 20.0,
        "remote_readers": 1,
        "requested_deadline_ns": None,
    }
    seed = json.dumps({"api_version": 1, "topics": [row]}).encode()
    words = (*row, "api_version", "topics", "1e999", "NaN", "-Infinity", "actuation", "local", "null", "[[[[")
    return Fuzzable(feed=feed, seeds=(seed,), words=words)


def trace() -> Fuzzable:
    """Feed a link trace: arpd makes rates and losses of it, or refuses it in one line."""
    from arpd.adapters.sim.trace import read_trace
    from arpd.model.errors import TraceError

    path = memory_file()

    def feed(data: bytes) -> None:
        path.write_bytes(data)
        try:
            found = read_trace(path)
        except TraceError as error:
            insist("\n" not in str(error), f"one line: {error}")
            return
        rates = [step.rate_bytes_per_second for step in found.rates.steps]
        insist(all(0.0 <= rate < math.inf for rate in rates), f"finite rates: {rates}")
        insist(all(0.0 <= step.loss <= 1.0 for step in found.losses), f"probabilities: {found.losses}")

    seeds = (
        b"time_s,rate_bit_per_s,loss\n0,2e7,0\n10,5000000,0.02\n20,2e7,0\n",
        b"# recorded\ntime_s,rate_bit_per_s\n0,1\n",
        b"0\n1\n1\n5\n20\n400\n",
    )
    return Fuzzable(feed=feed, seeds=seeds, words=("time_s,", "rate_bit_per_s", ",loss", "\n", "#", "1e300", "nan"))


def web_config() -> Fuzzable:
    """Feed a web-config: arpd makes a protection of it, or names each fault in one clear line."""
    from arpd.adapters.http.web_config import load_protection

    seeds = (
        b"tls_server_config: {cert_file: a.pem, key_file: a.key, min_version: TLS12}\n",
        b"basic_auth_users:\n  ops: $2b$12$CwTycUXWue0Thq9StjUM0uJ8vDqYPBlRgYFRQ0qVdCkXo6B6xkz5e\n",
        b"http_server_config: {headers: {X-Frame-Options: deny}}\n",
    )
    words = (
        *("client_ca_file: ", "client_auth_type: ", "RequireAndVerifyClientCert", "client_allowed_sans: ["),
        "max_version",
    )
    return Fuzzable(feed=_feed_config(load_protection), seeds=seeds, words=words)


def _feed_config(load: Callable[[Path], object]) -> Callable[[bytes], None]:
    from arpd.model.errors import ConfigError

    path = memory_file()

    def feed(data: bytes) -> None:
        path.write_bytes(data)
        try:
            load(path)
        except ConfigError as error:
            insist(bool(error.faults) and all(map(FAULT.fullmatch, error.faults)), f"a clear fault: {error.faults}")

    return feed
