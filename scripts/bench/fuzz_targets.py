"""Every reader of foreign input that `fuzz.py` feeds."""

from __future__ import annotations

from scripts.bench.fuzz_files import config, status_file, trace, web_config
from scripts.bench.fuzz_http import http
from scripts.bench.fuzz_messages import claim, parameters, probe, publisher, reader, report, wire
from scripts.bench.fuzz_target import Target

TARGETS = {
    "config": Target(what="configuration file", load=config),
    "status-file": Target(what="saved status", load=status_file, most_bytes=2**14),
    "trace": Target(what="link trace", load=trace, most_bytes=2**14),
    "report": Target(what="peer report", load=report),
    "probe": Target(what="probe packet", load=probe, most_bytes=256),
    "publisher": Target(what="publisher's announcement", load=publisher),
    "reader": Target(what="reader's announcement", load=reader),
    "wire": Target(what="announcements, serialized", load=wire),
    "claim": Target(what="daemon's claim", load=claim, most_bytes=1024),
    "http": Target(what="HTTP connection", load=http),
    "web-config": Target(what="web-config file", load=web_config),
    "parameters": Target(what="QoS parameters", load=parameters, most_bytes=256),
}
