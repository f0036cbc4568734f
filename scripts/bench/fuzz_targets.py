"""Every reader of outside input that `fuzz.py` feeds."""

from __future__ import annotations

from scripts.bench.fuzz_files import config, status_file, trace, web_config
from scripts.bench.fuzz_http import http
from scripts.bench.fuzz_messages import plan, probe, report, snapshot
from scripts.bench.fuzz_target import Target

TARGETS = {
    "config": Target(load=config),
    "status-file": Target(load=status_file, most_bytes=2**14),
    "trace": Target(load=trace, most_bytes=2**14),
    "report": Target(load=report),
    "probe": Target(load=probe, most_bytes=256),
    "snapshot": Target(load=snapshot),
    "plan": Target(load=plan),
    "http": Target(load=http),
    "web-config": Target(load=web_config),
}
