"""One frame of `arpd top`, drawn from the daemon's documents."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from rich.console import Group
from rich.text import Text

from arpd.cli.client import count, number, rows, series, text, texts
from arpd.cli.columns import clock, cut, wall_clock, wrapped
from arpd.cli.status import findings, who_confirmed
from arpd.cli.status_tables import topic_table
from arpd.model.quantities import format_duration, format_rate, format_share, printable
from arpd.report.situation import SLOWED_BELOW

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

_LABEL, _FIGURES, _LEGEND = 9, 37, 14
_LEAST_SPARKLINE = 8
_LEAST_WIDTH = 30
_MOST_TOPICS_SHARE = 0.7  # of the lines that topics and log share
_VERDICTS = {"info": "bold green", "warning": "bold yellow", "error": "bold red"}
_IN_ASCII = str.maketrans("…→≤≥", "~><>")
_SEVERITIES = {"warning": "yellow", "error": "red"}


@dataclass(frozen=True, kw_only=True, slots=True)
class View:
    """The terminal and the daemon that a frame is for.

    Parameters
    ----------
    width, height : of the terminal (columns, lines)
    url : address of the daemon
    silent_s, why_silent : time since its last answer (s), and why the last try failed; empty while it answers
    is_ascii : True for a terminal with ASCII only
    """

    width: int
    height: int
    url: str = ""
    silent_s: float = 0.0
    why_silent: str = ""
    is_ascii: bool = False


def frame(status: dict[str, Any], history: dict[str, Any] | None, view: View) -> Group:
    """Draw one frame, exactly as high and wide as the view.

    Parameters
    ----------
    status : document of ``/api/v1/status``, of any version of arpd
    history : document of ``/api/v1/history``, None where there is none
    """
    width = max(view.width, _LEAST_WIDTH)
    lines = [_title(status, view.url, width), *_findings(status, view, width)]
    if "link" in status:
        seen = len(lines)
        lines += [*_link(status, history, width, BLOCKS if not view.is_ascii else ASCII), *_plan(status, width)]
        room = max(0, view.height - len(lines))
        topics, log = _share(room, len(rows(status, "topics")), len(rows(status, "events")))
        lines += [*_topics(status, width, topics), *_log(status, width, log)]
        for line in lines[seen:] if view.why_silent else ():
            line.stylize("dim")
    lines = lines[: view.height]
    for line in lines:
        line.no_wrap, line.overflow = True, "crop"
        if view.is_ascii:
            line.plain = line.plain.translate(_IN_ASCII)
    return Group(*lines)


def _title(status: dict[str, Any], url: str, width: int) -> Text:
    left = f" arpd {text(status, 'version')} on {text(status, 'interface') or 'no link'}"
    if url:
        left += f", {printable(url, longest=80)}"
    right = f"{wall_clock(number(status, 'unix_time_seconds'))} "
    return Text(cut(left, width - len(right) - 1).ljust(width - len(right)) + right, style="reverse")


def _findings(status: dict[str, Any], view: View, width: int) -> list[Text]:
    sentences = [
        (finding.text, "bold red" if finding.is_wrong else _VERDICTS.get(finding.severity, "bold"))
        for finding in findings(status)
    ]
    if view.why_silent:
        of = wall_clock(number(status, "unix_time_seconds"))
        lost = f"no answer for {view.silent_s:.0f} s, this is from {of}: {printable(view.why_silent, longest=200)}"
        sentences.insert(0, (lost, "bold red"))
    return [Text(line, style=style) for said, style in sentences for line in wrapped(said, width, indent=2, most=4)]


def _link(status: dict[str, Any], history: dict[str, Any] | None, width: int, levels: str) -> list[Text]:
    link = status.get("link")
    loss, back_s = number(link, "loss_ratio"), number(link, "return_delay_seconds")
    cross_traffic = number(link, "foreign_bytes_per_second")
    delay = [
        format_duration(number(link, "queue_delay_seconds")),
        *([] if loss is None else [f"loss {format_share(loss)}"]),
        *([] if back_s is None else [f"back in {format_duration(back_s)}"]),
    ]
    capacity = f"{format_rate(number(link, 'capacity_bytes_per_second'))}  {text(link, 'kind')}, {text(link, 'state')}"
    courses: list[tuple[str, str, tuple[str, ...], Callable[[Iterable[float]], float], Callable[[float], str]]] = [
        ("link", capacity, ("link", "capacity_bytes_per_second"), _mean, format_rate),
        ("queue", ", ".join(delay), ("link", "queue_delay_seconds"), max, format_duration),
        ("admitted", format_share(number(status, "gate")), ("gate",), min, format_share),
    ]
    lines = []
    for label, now, keys, worst, show in courses:
        line = Text(f"{label:{_LABEL}}{cut(now, width - _LABEL)}")
        line.stylize("bold", 0, _LABEL)
        samples = series(history, *keys)
        known = [sample for sample in samples if sample is not None]
        extreme = min if worst is min else max
        columns = width - _LABEL - _FIGURES - _LEGEND
        if known and columns >= _LEAST_SPARKLINE and len(line) <= _LABEL + _FIGURES:
            line.pad_right(_LABEL + _FIGURES - len(line))
            line.append(sparkline(samples, columns, pick=worst, highest=1.0 if worst is min else None, levels=levels))
            line.append(f" {'≥' if worst is min else '≤'} {show(extreme(known))}", style="dim")
        lines.append(line)
    delivered, usable = number(link, "delivery_rate_bytes_per_second"), ("allocation", "capacity_bytes_per_second")
    traffic = f"delivering {format_rate(delivered)}, budget {format_rate(number(status, *usable))}"
    if cross_traffic:
        left = format_rate(number(link, "available_bytes_per_second"))
        traffic += f", {format_rate(cross_traffic)} of cross traffic, {left} left"
    return [*lines, _fact("traffic", traffic, width), *_why(text(link, "evidence"), width)]


def _plan(status: dict[str, Any], width: int) -> list[Text]:
    plan, allocation = status.get("plan"), status.get("allocation")
    level = format_rate(number(status, "level_bytes_per_second"))
    solved = f"{text(allocation, 'status')}, bound by {text(allocation, 'binding').replace('_', ' ')}"
    took = f"{text(allocation, 'backend')}, {format_duration(number(allocation, 'solve_seconds'))}"
    why = "; ".join(said for said in (text(plan, "reason"), *(f"refused {r}" for r in texts(plan, "refusals"))) if said)
    return [
        _fact("plan", f"{count(plan, 'generation')} for {level}: {who_confirmed(status)}", width),
        *_why(why, width),
        _fact("program", f"{solved} ({took})", width),
    ]


def _fact(label: str, fact: str, width: int) -> Text:
    line = Text(cut(f"{label:{_LABEL}}{fact}", width))
    line.stylize("bold", 0, _LABEL)
    return line


def _why(said: str, width: int) -> list[Text]:
    return [Text(cut(" " * _LABEL + said, width), style="dim")] if said else []


def _share(room: int, topics: int, events: int) -> tuple[int, int]:
    """Divide lines between topics (with a heading and, for what does not fit, a last line) and log (with a blank)."""
    wanted_topics, wanted_log = topics + 1, events + 1 if events else 0
    log = min(wanted_log, max(room - wanted_topics, int(room * (1 - _MOST_TOPICS_SHARE))))
    return min(wanted_topics, max(0, room - log)), max(0, log)


def _topics(status: dict[str, Any], width: int, room: int) -> list[Text]:
    topics = sorted(rows(status, "topics"), key=_rank)
    if not topics:
        return []
    shown = topics if len(topics) < room else topics[: max(0, room - 2)]
    heading, *lines = (Text(line) for line in topic_table(shown, width=width))
    heading.stylize("bold underline")
    for topic, line in zip(shown, lines, strict=True):
        line.stylize(_topic_style(topic))
    if rest := topics[len(shown) :]:
        slowed = sum(map(_is_slowed, rest))
        note = f"… and {len(rest)} more" + (f", {slowed} of them slowed" if slowed else "")
        lines.append(Text(cut(note, width), style="dim"))
    return [heading, *lines][:room]


def _rank(topic: dict[str, Any]) -> tuple[bool, float, float, str, str]:
    """Order by what an operator looks for: refusals, then topics that give up most, then those that use most."""
    return (
        not _is_refused(topic),
        _kept_ratio(topic) if _is_slowed(topic) else 1.0,
        -(number(topic, "share") or 0.0),
        text(topic, "topic"),
        text(topic, "node"),
    )


def _kept_ratio(topic: dict[str, Any]) -> float:
    kept = number(topic, "kept_ratio")
    return 1.0 if kept is None else kept  # an older daemon does not say


def _is_slowed(topic: dict[str, Any]) -> bool:
    return _kept_ratio(topic) < SLOWED_BELOW


def _is_refused(topic: dict[str, Any]) -> bool:
    return bool(text(topic, "refusal")) and not topic.get("refusal_lasts")


def _topic_style(topic: dict[str, Any]) -> str:
    if _is_refused(topic):
        return "red"
    if _is_slowed(topic):
        return "yellow"
    return "" if topic.get("planned") else "dim"


def _log(status: dict[str, Any], width: int, room: int) -> list[Text]:
    if room < 2:
        return []
    now_s = number(status, "unix_time_seconds")
    lines = [Text("")]
    for event in rows(status, "events")[1 - room :]:
        when = clock(event, now_s)
        line = Text(cut(f"{when}  {text(event, 'text')}", width), style=_SEVERITIES.get(text(event, "severity"), ""))
        line.stylize("dim", 0, len(when))
        lines.append(line)
    return lines


def _mean(values: Iterable[float]) -> float:
    there: Sequence[float] = list(values)
    return sum(there) / len(there)


BLOCKS = "▁▂▃▄▅▆▇█"
ASCII = "_.-:=+*#"


def sparkline(
    samples: Sequence[float | None],
    columns: int,
    *,
    pick: Callable[[Iterable[float]], float],
    highest: float | None = None,
    levels: str = BLOCKS,
) -> str:
    """Draw samples in so many columns, from 0 to the highest; a blank where there is none.

    Parameters
    ----------
    pick : chooses one of the samples that share a column, the worst: ``max`` for a delay
    highest : value that reaches the top, None = the highest sample
    levels : characters from the lowest to the highest
    """
    known = [sample for sample in samples if sample is not None]
    top = highest if highest is not None else max(known, default=0.0)
    columns = min(columns, len(samples))
    drawn = []
    for column in range(columns):
        share = samples[column * len(samples) // columns : (column + 1) * len(samples) // columns]
        there = [sample for sample in share if sample is not None]
        drawn.append(_level(pick(there), top, levels) if there else " ")
    return "".join(drawn)


def _level(value: float, top: float, levels: str) -> str:
    if top <= 0:
        return levels[0]
    return levels[max(0, min(len(levels) - 1, int(value / top * len(levels))))]
