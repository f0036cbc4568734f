"""Fuzz arpd's readers of outside input by coverage: atheris draws the examples of their Hypothesis tests.

Needs atheris, which is among the development tools on x86-64. Each test runs in a process of its own for so many
seconds, or until its first failure, which Hypothesis keeps: pytest repeats it. Edges are those of arpd's Python and of
its parsers; native code in pydantic or rclpy runs without coverage.
"""

from __future__ import annotations

import importlib
import re
import subprocess
import sys
import tempfile
from functools import partial
from typing import Any

from arpd.model.errors import ArpdError
from scripts.bench.report import REPO, Summary, figure, picked, table

#: By reader: module and name of its test, which takes nothing but what Hypothesis draws.
READERS = {
    "config": ("host.config.test_mangled", "test_a_mangled_file_loads_or_says_where_it_is_wrong"),
    "trace": ("sim.test_trace", "test_whatever_a_file_holds_it_is_a_trace_or_refused"),
    "report, probe": ("ros.test_probe_messages", "test_any_other_bytes_are_refused_or_read_as_finite_numbers"),
    "snapshot": ("ros.test_node_snapshot", "test_any_bytes_are_a_snapshot_or_refused"),
    "plan": ("ros.test_plan_message", "test_any_bytes_are_a_plan_or_refused"),
    "price": ("ros.test_inbox", "test_any_bytes_are_refused_or_read"),
    "chunk": ("relay.test_envelope", "test_any_bytes_are_a_chunk_or_refused"),
    "call": ("relay.test_calls", "test_random_bytes_raise_nothing_else"),
    "sign": ("relay.test_flight", "test_a_sign_arrives_as_it_was_sent_or_is_refused"),
    "discovery": ("host.test_discovery", "test_no_packet_raises"),
}
chosen = partial(picked, READERS)
_SECONDS, _QUICK_S = 15.0, 2.0
_INSTRUMENTED = ["arpd", "yaml", "json"]
_LIMITS = ("-max_len=4096", "-rss_limit_mb=2048", "-timeout=30", "-print_final_stats=1")
#: What libFuzzer prints, by the column that has it; the last of several counts.
_PRINTED = {
    "inputs": re.compile(r"^stat::number_of_executed_units:\s*(\d+)", re.MULTILINE),
    "edges": re.compile(r"^#\d+\s.*cov: (\d+) ", re.MULTILINE),
    "slowest s": re.compile(r"^stat::slowest_unit_time_sec:\s*(\d+)", re.MULTILINE),
    "peak MiB": re.compile(r"^stat::peak_rss_mb:\s*(\d+)", re.MULTILINE),
}


def child(reader: str, seconds: str, folder: str) -> None:
    """Fuzz one reader in this process, which ends with it."""
    import atheris

    module, name = READERS[reader]
    with atheris.instrument_imports(include=_INSTRUMENTED):
        test = getattr(importlib.import_module(f"tests.unit.{module}"), name)
    atheris.Setup(
        ["fuzz", f"-max_total_time={seconds}", f"-artifact_prefix={folder}/", *_LIMITS], test.hypothesis.fuzz_one_input
    )
    atheris.Fuzz()


def fuzz(reader: str, seconds: float) -> dict[str, Any]:
    """Fuzz one reader for so long, and return what libFuzzer found."""
    with tempfile.TemporaryDirectory(prefix="arpd-fuzz-") as folder:
        command = [sys.executable, "-m", "scripts.bench.fuzz", reader, f"{seconds:.0f}", folder]
        done = subprocess.run(command, cwd=REPO, capture_output=True, text=True, errors="replace", check=False)
    found = {column: pattern.findall(done.stderr) for column, pattern in _PRINTED.items()}
    if not found["inputs"]:
        raise ArpdError(f"fuzz: {reader} did not run\n{done.stderr[-2000:]}")
    if done.returncode:
        print(f"{done.stdout[-2000:]}\n{reader}: repeat it with pytest tests/unit -k {READERS[reader][1]}")
    numbers = {column: int(values[-1]) if values else None for column, values in found.items()}
    return {"reader": reader, **numbers, "crashes": int(done.returncode != 0)}


def play(*, is_quick: bool, only: str = "", rounds: int = 1) -> Summary:
    """Fuzz one reader after the other."""
    rows = [fuzz(name, _QUICK_S if is_quick else _SECONDS * rounds) for name in chosen(only)]
    inputs = sum(row["inputs"] for row in rows)
    return Summary(
        about="Each reader of outside input, guided by coverage.",
        figures=[figure("crashes", sum(row["crashes"] for row in rows), f"of {inputs:,} inputs", most=0)],
        tables=[table("", rows)],
    )


if __name__ == "__main__":
    child(*sys.argv[1:])
