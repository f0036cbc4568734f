"""Every reader of outside input that `fuzz.py` feeds."""

from __future__ import annotations

from scripts.bench.fuzz_files import config, status_file, trace, web_config
from scripts.bench.fuzz_http import http
from scripts.bench.fuzz_messages import counters, heartbeat, plan, probe, publisher, report, wire
from scripts.bench.fuzz_target import Target

TARGETS = {
    "config": Target(load=config),
    "status-file": Target(load=status_file, most_bytes=2**14),
    "trace": Target(load=trace, most_bytes=2**14),
    "report": Target(load=report),
    "probe": Target(load=probe, most_bytes=256),
    "publisher": Target(load=publisher),
    "counters": Target(load=counters, most_bytes=1024),
    "plan": Target(load=plan),
    "wire": Target(load=wire),
    "claim": Target(load=heartbeat, most_bytes=1024),
    "http": Target(load=http),
    "web-config": Target(load=web_config),
}
