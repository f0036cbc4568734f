"""Fuzz all of arpd's readers of outside input, guided by coverage.

Usage: .venv/bin/python scripts/bench/fuzz.py [--seconds S | --quick] [--target NAME] [--corpus FOLDER] [--json FILE]
       .venv/bin/python scripts/bench/fuzz.py --target NAME --input FILE

Needs atheris, which is among the development tools on x86-64 (no part of arpd needs it).

Each target of `fuzz_targets.py` runs in a process of its own for so many seconds, and goes on after a crash. For each
different crash, the run keeps one input beside the results and prints the command that repeats it. Edges are those of
arpd's Python and of its parsers; native code in pydantic or rclpy runs without coverage.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import re
import subprocess
import sys
import tempfile
import time
import traceback
from pathlib import Path
from typing import TYPE_CHECKING, Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from arpd.cli.progress import progress
from scripts.bench.fuzz_targets import TARGETS
from scripts.bench.record import RESULTS, conditions, keep, options_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from scripts.bench.fuzz_target import Fuzzable

INSTRUMENTED = ["arpd", "yaml", "json", "tornado"]
_PROGRESS = re.compile(r"^#(\d+)\s.*cov: (\d+) ft: (\d+) corp: (\d+)", re.MULTILINE)
_RSS_MIB = 2048  # libFuzzer ends a target with more memory than this,
_TIMEOUT_S = 30  # or with an input that takes longer than this
_QUICK_S = 2.0


class Notes:
    """The findings of a target's process, in a file, because libFuzzer ends the process without notice to Python."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._found: dict[str, Any] = {"executions": 0, "slowest_s": 0.0, "slowest_bytes": 0, "crashes": {}}
        self._started_rss = _rss_bytes()
        self._crashes = 0

    def feed(self, code: Fuzzable, data: bytes) -> None:
        """Run one input; note its exception, and its time if that is the longest so far."""
        self._found["executions"] += 1
        started_s = time.thread_time()
        try:
            code.feed(data)
        except Exception as error:  # noqa: BLE001 - the fuzzer looks for any exception
            self._note_crash(error, data)
        took_s = time.thread_time() - started_s
        if took_s > self._found["slowest_s"]:
            self._found |= {"slowest_s": took_s, "slowest_bytes": len(data)}
            self._path.with_name("slowest").write_bytes(data)
            self._write()

    def _note_crash(self, error: Exception, data: bytes) -> None:
        frames = traceback.extract_tb(error.__traceback__)
        ours = [frame for frame in frames if "/arpd/" in frame.filename] or list(frames)
        where = f"{Path(ours[-1].filename).name}:{ours[-1].lineno}"
        crash = self._found["crashes"].setdefault(f"{type(error).__name__} at {where}", {"count": 0})
        crash["count"] += 1
        if "input" not in crash or len(data) < crash["bytes"]:
            name = f"crash-{hashlib.sha256(where.encode()).hexdigest()[:12]}"
            crash |= {"input": name, "bytes": len(data), "message": str(error)[:500]}
            self._path.with_name(name).write_bytes(data)
            self._write()

    def _write(self) -> None:
        self._found["rss_at_start_bytes"] = self._started_rss
        self._path.write_text(json.dumps(self._found))


def _rss_bytes() -> int:
    pages = int(Path("/proc/self/statm").read_text(encoding="utf-8").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")


def child(name: str, seconds: float, workdir: Path, corpus: Path) -> None:
    """Fuzz one target in this process, which ends with it."""
    try:
        import atheris
    except ImportError:
        sys.exit("fuzz: atheris is not installed; .venv/bin/pip install '.[dev]', on x86-64")
    target = TARGETS[name]
    with atheris.instrument_imports(include=INSTRUMENTED):
        code = target.load()
    for seed in code.seeds:
        (corpus / f"seed-{hashlib.sha256(seed).hexdigest()[:12]}").write_bytes(seed)
    words = workdir / "words"
    words.write_text("\n".join(_quoted(word) for word in code.words) + "\n", encoding="ascii")
    notes = Notes(workdir / "notes.json")
    arguments = [
        f"-max_total_time={seconds:.0f}",
        f"-max_len={target.most_bytes}",
        f"-rss_limit_mb={_RSS_MIB}",
        f"-timeout={_TIMEOUT_S}",
        f"-artifact_prefix={workdir}/native-",
        f"-dict={words}",
        "-print_final_stats=1",
    ]
    atheris.Setup(["fuzz", *arguments, str(corpus)], lambda data: notes.feed(code, data))
    atheris.Fuzz()


def _quoted(word: str) -> str:
    """Write a word as libFuzzer's dictionaries want it."""
    return '"' + "".join(f"\\x{byte:02x}" for byte in word.encode()) + '"'


def fuzz(name: str, seconds: float, corpus: Path | None, crashes: Path) -> dict[str, Any]:
    """Fuzz one target for so long; return the findings."""
    with tempfile.TemporaryDirectory(prefix=f"arpd-fuzz-{name}-") as folder:
        workdir = Path(folder)
        seeds = (corpus or workdir) / "corpus" / name
        seeds.mkdir(parents=True, exist_ok=True)
        command = [sys.executable, __file__, "--child", "--target", name, "--seconds", str(seconds)]
        started_s = time.monotonic()
        process = subprocess.Popen(
            [*command, "--workdir", folder, "--corpus", str(seeds)], stderr=subprocess.PIPE, stdout=subprocess.DEVNULL
        )
        assert process.stderr is not None
        printed = process.stderr.read().decode(errors="replace")
        _, status, usage = os.wait4(process.pid, 0)
        notes = workdir / "notes.json"
        steps = _PROGRESS.findall(printed)
        if not notes.exists() or not steps:
            raise SystemExit(f"fuzz: {name} did not run\n{printed[-2000:]}")
        executions, edges, features, corpus_size = map(int, steps[-1])
        found: dict[str, Any] = json.loads(notes.read_text())
        found |= {
            "executions": executions,
            "seconds": time.monotonic() - started_s,
            "edges": edges,
            "features": features,
            "corpus": corpus_size,
            "peak_rss_bytes": usage.ru_maxrss * 1024,
        }
        for artifact in workdir.glob("native-*"):  # a segmentation fault, a hang, too much memory
            what = f"native {artifact.name.removeprefix('native-').partition('-')[0]}, wait status {status}"
            found["crashes"][what] = {"count": 1, "input": artifact.name, "message": printed[-500:]}
        for crash in found["crashes"].values():
            kept = crashes / f"{name}-{crash['input']}"
            kept.parent.mkdir(parents=True, exist_ok=True)
            kept.write_bytes((workdir / crash["input"]).read_bytes())
            crash["input"] = str(kept.resolve())
        return found


def row(name: str, found: dict[str, Any]) -> str:
    grown = found["peak_rss_bytes"] - found["rss_at_start_bytes"]
    return (
        f"{name:<14}{found['executions']:>12,}{found['executions'] / found['seconds']:>9,.0f}{found['edges']:>8}"
        f"{found['corpus']:>8}{len(found['crashes']):>9}{found['slowest_s'] * 1e3:>13.1f}{found['slowest_bytes']:>9}"
        f"{found['peak_rss_bytes'] / 2**20:>10.0f}{grown / 2**20:>+8.0f}"
    )


def repeat(name: str, source: Path) -> None:
    """Run one kept input again, with the traceback."""
    TARGETS[name].load().feed(source.read_bytes())
    print(f"{name}: {source} is accepted or refused correctly")


def main(arguments: Sequence[str] | None = None) -> None:
    parser = options_of(__doc__, "fuzz", quick="two seconds for each target")
    each = "for each target (default %(default)g)"
    parser.add_argument("--seconds", type=float, default=60.0, metavar="S", help=each)
    parser.add_argument("--target", choices=TARGETS, action="append", help="may be given again (default: all)")
    parser.add_argument("--corpus", type=Path, metavar="FOLDER", help="keep interesting inputs from run to run")
    parser.add_argument("--input", type=Path, metavar="FILE", help="run this input once, without atheris")
    crashes = "folder for inputs that crash"
    parser.add_argument("--crashes", type=Path, default=RESULTS / "crashes", metavar="FOLDER", help=crashes)
    parser.add_argument("--child", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--workdir", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    names = options.target or list(TARGETS)
    if options.child:
        child(names[0], options.seconds, options.workdir, options.corpus)
    elif options.input:
        repeat(names[0], options.input)
    else:
        report(names, options)


def report(names: Sequence[str], options: argparse.Namespace) -> None:
    """Fuzz one target after the other, print a line for each, and write the JSON."""
    print(
        f"{'':<14}{'executions':>12}{'per s':>9}{'edges':>8}{'corpus':>8}{'crashes':>9}{'slowest ms':>13}{'bytes':>9}"
        f"{'peak MiB':>10}{'grown':>8}"
    )
    noted = conditions()
    seconds = _QUICK_S if options.quick else options.seconds
    targets: dict[str, Any] = {}
    with progress("fuzzing", total=len(names)) as shown:
        for name in names:
            shown.step(name)
            targets[name] = found = fuzz(name, seconds, options.corpus, options.crashes)
            print(row(name, found), flush=True)
            for what, crash in found["crashes"].items():
                print(f"  {what}, {crash['count']}×: {crash['message'].splitlines()[:1]}")
                print(f"  .venv/bin/python scripts/bench/fuzz.py --target {name} --input {crash['input']}")
    is_partial = options.quick or len(names) < len(TARGETS)
    keep({"conditions": noted, "targets": targets}, options, "fuzz", is_partial=is_partial)
    if any(found["crashes"] for found in targets.values()):
        sys.exit(1)


if __name__ == "__main__":
    main()
