"""Fuzz all of arpd's readers of outside input, guided by coverage.

Usage: python -m scripts.bench fuzz, or with a choice: python -m scripts.bench.fuzz TARGET [--seconds S] [--input FILE]

Needs atheris, which is among the development tools on x86-64. Each target of `fuzz_targets` runs in a process of its
own for so many seconds, or until its first crash; --input runs one kept input again, without atheris. Edges are those
of arpd's Python and of its parsers; native code in pydantic or rclpy runs without coverage.
"""

from __future__ import annotations

import argparse
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from scripts.bench.fuzz_targets import TARGETS
from scripts.bench.report import REPO, RESULTS, Summary, figure, table

CRASHES = RESULTS / "crashes"
_SECONDS, _QUICK_S = 60.0, 2.0
_INSTRUMENTED = ["arpd", "yaml", "json", "tornado"]
_RSS_MIB = 2048  # libFuzzer ends a target with more memory than this,
_TIMEOUT_S = 30  # or with an input that takes longer than this
#: What libFuzzer prints, by the column that has it; the last of several counts.
_PRINTED = {
    "inputs": re.compile(r"^stat::number_of_executed_units:\s*(\d+)", re.MULTILINE),
    "edges": re.compile(r"^#\d+\s.*cov: (\d+) ", re.MULTILINE),
    "slowest s": re.compile(r"^stat::slowest_unit_time_sec:\s*(\d+)", re.MULTILINE),
    "peak MiB": re.compile(r"^stat::peak_rss_mb:\s*(\d+)", re.MULTILINE),
}


def child(name: str, seconds: float, workdir: Path) -> None:
    """Fuzz one target in this process, which ends with it."""
    import atheris

    target, corpus, words = TARGETS[name], workdir / "corpus", workdir / "words"
    with atheris.instrument_imports(include=_INSTRUMENTED):
        code = target.load()
    corpus.mkdir()
    for number, seed in enumerate(code.seeds):
        (corpus / f"seed-{number}").write_bytes(seed)
    quoted = ("".join(f"\\x{byte:02x}" for byte in word.encode()) for word in code.words)
    words.write_text("".join(f'"{word}"\n' for word in quoted) + "\n", encoding="ascii")
    limits = (f"-max_total_time={seconds:.0f}", f"-max_len={target.most_bytes}", f"-rss_limit_mb={_RSS_MIB}")
    files = (f"-timeout={_TIMEOUT_S}", f"-artifact_prefix={workdir}/found-", f"-dict={words}", "-print_final_stats=1")
    atheris.Setup(["fuzz", *limits, *files, str(corpus)], code.feed)
    atheris.Fuzz()


def fuzz(name: str, seconds: float) -> dict[str, Any]:
    """Fuzz one target for so long; return the findings, and keep the input of a crash, a hang or too much memory."""
    with tempfile.TemporaryDirectory(prefix=f"arpd-fuzz-{name}-") as folder:
        command = [sys.executable, "-m", "scripts.bench.fuzz", name, "--seconds", str(seconds), "--child", folder]
        done = subprocess.run(command, cwd=REPO, capture_output=True, text=True, errors="replace", check=False)
        printed = done.stderr
        artifacts = list(Path(folder).glob("found-*"))
        for artifact in artifacts:
            CRASHES.mkdir(parents=True, exist_ok=True)
            kept = shutil.copy(artifact, CRASHES / f"{name}-{artifact.name}")
            print(f"{done.stdout[-2000:]}\n{name}: repeat it with --input {kept}")
    found = {column: pattern.findall(printed) for column, pattern in _PRINTED.items()}
    if not found["inputs"]:
        raise SystemExit(f"fuzz: {name} did not run\n{printed[-2000:]}")
    numbers = {column: int(values[-1]) if values else None for column, values in found.items()}
    return {"reader": name, **numbers, "crashes": len(artifacts)}


def play(*, is_quick: bool) -> Summary:
    """Fuzz one target after the other."""
    rows = [fuzz(name, _QUICK_S if is_quick else _SECONDS) for name in TARGETS]
    inputs = sum(row["inputs"] for row in rows)
    return Summary(
        about="Each reader of outside input, guided by coverage.",
        figures=[figure("crashes", sum(row["crashes"] for row in rows), f"of {inputs:,} inputs", most=0)],
        tables=[table("", rows)],
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("target", choices=TARGETS)
    parser.add_argument("--seconds", type=float, default=_SECONDS, metavar="S", help="default %(default)g")
    parser.add_argument("--input", type=Path, metavar="FILE", help="run this input once, without atheris")
    parser.add_argument("--child", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.child:
        child(options.target, options.seconds, options.child)
    elif options.input:
        TARGETS[options.target].load().feed(options.input.read_bytes())
        print(f"{options.input} is accepted or refused correctly")
    else:
        print(fuzz(options.target, options.seconds))


if __name__ == "__main__":
    main()
