"""The results of `pi.py` for docs/results.md and for the table of sizes in README.md, and its targets."""

from __future__ import annotations

from statistics import median
from typing import TYPE_CHECKING, Any

from scripts.bench.overhead_targets import cpu, met, spans_of, spread
from scripts.bench.pi_boards import THIS
from scripts.bench.record import described
from scripts.bench.report import markdown_table, percent

if TYPE_CHECKING:
    from collections.abc import Sequence

    from scripts.bench.overhead_targets import Run

MOST_LATE_SHARE, MOST_PRICE_S = 0.01, 0.5
MOST_MORE_LOST_SHARE = 0.001  # than without a quota
LEAST_PUBLISHED_SHARE = 0.95  # of what the sources should publish
_HEAD = [
    *("topics", "board", "confirmed", "price s", "plan s", "confirmed s", "late ticks %", "lost %"),
    *(
        "latency ms, p50",
        "p99",
        "p99 paced",
        "run CPU %",
        "relay CPU %",
        "run slowed %",
        "relay slowed %",
        "silence s",
        "restarts",
    ),
]


def markdown(document: dict[str, Any]) -> str:
    """Return the block of docs/results.md: how slow the boards are, the figures, and the targets."""
    rounds = max(run["round"] for run in document["runs"]) + 1
    return "\n".join(
        [
            f"`scripts/bench/pi.py` ({described(document)}); median (worst) of {rounds} rounds. {_slowness(document)}",
            "",
            *markdown_table("rlr", _HEAD, [_row(*cell) for cell in _cells(document)]),
            "",
            (
                "Price, plan and confirmed: seconds from the change of the link, 20 → 5 Mbit/s. Latency from the "
                "source to the CEDDP; paced: at 5 Mbit/s. CPU while everything is carried, in percent of one core of "
                "the board. Slowed: periods of that time in which the busiest thread used up its core. Silence: "
                "the longest between two signs for the watchdog, which restarts run after 10 s and the relay after "
                "20 s. A thread may use its quota of a period at once. So work of less than a millisecond is as fast "
                "as on this machine, and latency on a real Pi is some milliseconds longer. Caches and memory are this "
                "machine's."
            ),
            "",
            sizes(document),
            "",
            *(f"- {sentence}" for sentence in verdicts(document)),
        ]
    )


def sizes(document: dict[str, Any]) -> str:
    """Return the table of sizes: what holds with how many topics on which board."""
    numbers = sorted({run["topics"] for run in document["runs"]})
    names = [board["name"] for board in document["boards"]]
    rows = []
    for topics in numbers:
        said = [
            "; ".join(faults(document, topics, name)) or "holds" if _runs(document, topics, name) else ""
            for name in names
        ]
        rows.append([str(topics), *said])
    return "\n".join(markdown_table("rl", ["topics", *names], rows))


def faults(document: dict[str, Any], topics: int, board: str) -> list[str]:
    """Name what does not hold with so many topics on a board."""
    runs = _runs(document, topics, board)
    wrong = [f"failed: {run['failed']}" for run in runs if "failed" in run][:1]
    runs = [run for run in runs if "failed" not in run]
    if not runs:
        return wrong
    if (confirmed := min(run.get("confirmed", 0) for run in runs)) < topics:
        wrong.append(f"{confirmed} of {topics} confirmed")
    if (late := median(map(_late, runs))) > MOST_LATE_SHARE:
        wrong.append(f"{late:.1%} of the ticks late")
    if (more := _more_lost(document, topics, board)) > MOST_MORE_LOST_SHARE:
        wrong.append(f"{more:.2%} more lost")
    if (reached := min(map(_published, runs))) < LEAST_PUBLISHED_SHARE:
        wrong.append(f"sources reach {reached:.0%} of their rates")
    prices = [run["fall"]["price_s"] for run in runs]
    if any(price_s is None or price_s > MOST_PRICE_S for price_s in prices):
        wrong.append(f"price after {spread(prices, '{:.2f} s'.format)}")
    if restarts := sum(each["restarts"] for run in runs for each in run["watchdog"].values()):
        wrong.append(f"{restarts} restarts by the watchdog")
    return wrong


def verdicts(document: dict[str, Any]) -> list[str]:
    """Return whether a Pi 4 with twelve topics meets its targets, and name every run that failed."""
    said = []
    runs = [run for run in _runs(document, 12, "Pi 4") if "failed" not in run]
    if runs:
        late, more = median(map(_late, runs)), _more_lost(document, 12, "Pi 4")
        said.append(f"Pi 4 with 12 topics, late ticks: {late:.2%}; {met(is_met=late <= MOST_LATE_SHARE)}.")
        lost = median(map(_lost, runs))
        others = [run for run in _runs(document, 12, THIS.name) if "failed" not in run]
        if others:
            beside = f"{lost:.2%}, without a quota {median(map(_lost, others)):.2%}"
            said.append(f"Pi 4 with 12 topics, lost: {beside}; {met(is_met=more <= MOST_MORE_LOST_SHARE)}.")
    said += [f"{run['topics']} topics, {run['board']}: failed: {run['failed']}." for run in _failed(document)]
    return list(dict.fromkeys(said))


def _cells(document: dict[str, Any]) -> list[tuple[int, dict[str, Any], list[Run]]]:
    """Return topics, board and runs of every cell."""
    sizes = sorted({run["topics"] for run in document["runs"]})
    cells = [
        (topics, board, _runs(document, topics, board["name"])) for topics in sizes for board in document["boards"]
    ]
    return [cell for cell in cells if cell[2]]


def _row(topics: int, board: dict[str, Any], runs: Sequence[Run]) -> list[str]:
    whole = [run for run in runs if "failed" not in run]
    if not whole:
        return [str(topics), board["name"], "failed", *[""] * (len(_HEAD) - 3)]
    core = board["share"] or 1.0
    load, paced = spans_of(whole, "load"), spans_of(whole, "paced")
    watched = [each for run in whole for each in run["watchdog"].values()]
    return [
        str(topics),
        board["name"],
        str(min(run.get("confirmed", 0) for run in whole)),
        *(
            spread([run["fall"][key] for run in whole], form.format)
            for key, form in (("price_s", "{:.2f}"), ("plan_s", "{:.1f}"), ("confirmed_s", "{:.1f}"))
        ),
        spread([_late(run) for run in whole], lambda share: f"{100 * share:.2f}"),
        spread([_lost(run) for run in whole], lambda share: f"{100 * share:.2f}"),
        *(spread([span["latency_s"][p] for span in load], _milli) for p in ("p50", "p99")),
        spread([span["latency_s"]["p99"] for span in paced], _milli),
        *(spread([cpu(span, name) / core for span in load], percent) for name in ("run", "relay")),
        *(
            spread([span["throttled_share"][name] for span in load], percent) if board["share"] else ""
            for name in ("run", "relay0")
        ),
        f"{max(each['longest_s'] for each in watched):.1f}",
        str(sum(each["restarts"] for each in watched)),
    ]


def _slowness(document: dict[str, Any]) -> str:
    """Say how slow the boards are, and by which figures."""
    limited = [board for board in document["boards"] if board["share"] is not None]
    shares = ", ".join(
        f"{board['name']} {board['share']:.2f} ({board['quota_us'][0]} of {board['quota_us'][1]} us)"
        for board in limited
    )
    sources = document["sources"]
    pi_4 = sources["Raspberry Pi 4, pure Python (s)"]
    mips = [sources[f"Raspberry Pi {number}, 7-Zip, one thread (MIPS)"]["value"] for number in (4, 5)]
    return (
        f"Each thread of the robot's side has a quota that makes a core of this machine as slow as one of the board "
        f"({shares}), all threads have {document['cores']} such cores, and {document['memory_bytes'] / 2**20:.0f} MiB. "
        f"A benchmark in pure Python takes {pi_4['value']:.1f} s on a Pi 4 ({pi_4['source']}) and "
        f"{min(document['reference_s'].values()):.1f} s here. A Pi 5 is to a Pi 4 as {mips[1]} to {mips[0]} MIPS "
        "(7-Zip, one thread, sbc-bench)."
    )


def _runs(document: dict[str, Any], topics: int, board: str) -> list[Run]:
    return [run for run in document["runs"] if (run["topics"], run["board"]) == (topics, board)]


def _failed(document: dict[str, Any]) -> list[Run]:
    return [run for run in document["runs"] if "failed" in run]


def _late(run: Run) -> float:
    return float(run["ticks"]["ticks_late"] / max(1, run["ticks"]["ticks"]))


def _lost(run: Run) -> float:
    """Return the share of the samples that neither arrived nor were withheld."""
    samples = run["samples"]
    kept: float = (samples["received"] + samples["withheld"]) / max(1, samples["sent"])
    return max(0.0, 1.0 - kept)


def _published(run: Run) -> float:
    return float(run["samples"]["sent"] / max(1.0, run["samples"]["expected"]))


def _more_lost(document: dict[str, Any], topics: int, board: str) -> float:
    """Return the share that a board loses more than this machine without a quota; its whole loss without such a run."""
    lost = [[_lost(run) for run in _runs(document, topics, name) if "failed" not in run] for name in (board, THIS.name)]
    return median(lost[0]) - (median(lost[1]) if lost[1] else 0.0)


def _milli(seconds: float) -> str:
    return f"{1e3 * seconds:.{0 if seconds >= 0.01 else 1}f}"
