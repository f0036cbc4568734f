"""One frame of `arpd top`, from documents to something rich renders."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from rich.console import Group
from rich.text import Text

from arpd.cli.client import count, number, rows, series, text, texts
from arpd.cli.columns import clock, cut, duration, rate, wall_clock, wrapped
from arpd.cli.topics import topic_table
from arpd.cli.verdict import faults, is_held_back, kept_ratio, verdict, who_confirmed
from arpd.model.quantities import format_duration, format_rate, printable

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
    """What a frame is drawn for.

    Parameters
    ----------
    width, height : of the terminal (columns, lines)
    url : where the daemon was asked
    silent_s, why_silent : how long it has not answered (s), and what the last try came to; empty while it answers
    is_ascii : whether the terminal has nothing but ASCII
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
    lines = [_title(status, view.url, width), *_verdict(status, view, width)]
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


def _verdict(status: dict[str, Any], view: View, width: int) -> list[Text]:
    wrong, said = faults(status), verdict(status)
    sentences = [(fault, "bold red") for fault in wrong]
    if said and said not in wrong:
        sentences.insert(0, (said, _VERDICTS.get(text(status, "verdict", "severity"), "bold")))
    if view.why_silent:
        of = wall_clock(number(status, "unix_time_seconds"))
        lost = f"no answer for {view.silent_s:.0f} s, this is of {of}: {printable(view.why_silent, longest=200)}"
        sentences.insert(0, (lost, "bold red"))
    return [Text(line, style=style) for said, style in sentences for line in wrapped(said, width, indent=2, most=4)]


def _link(status: dict[str, Any], history: dict[str, Any] | None, width: int, levels: str) -> list[Text]:
    link = status.get("link")
    loss, back_s = number(link, "loss_ratio"), number(link, "return_delay_seconds")
    foreign = number(link, "foreign_bytes_per_second")
    delay = [
        duration(number(link, "queue_delay_seconds")),
        *([] if loss is None else [f"loss {loss:.1%}"]),
        *([] if back_s is None else [f"back in {format_duration(back_s)}"]),
    ]
    capacity = f"{rate(number(link, 'capacity_bytes_per_second'))}  {text(link, 'kind')}, {text(link, 'state')}"
    courses: list[tuple[str, str, tuple[str, ...], Callable[[Iterable[float]], float], Callable[[float], str]]] = [
        ("link", capacity, ("link", "capacity_bytes_per_second"), _mean, format_rate),
        ("queue", ", ".join(delay), ("link", "queue_delay_seconds"), max, format_duration),
        ("gate", f"{number(status, 'gate') or 0:.2f}", ("gate",), min, "{:.2f}".format),
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
    traffic = f"delivering {rate(number(link, 'delivery_rate_bytes_per_second'))}"
    if foreign:
        traffic += f", {format_rate(foreign)} not arpd's, {rate(number(link, 'available_bytes_per_second'))} left"
    return [*lines, _fact("traffic", traffic, width), *_why(text(link, "evidence"), width)]


def _plan(status: dict[str, Any], width: int) -> list[Text]:
    plan, allocation = status.get("plan"), status.get("allocation")
    force = f"{count(plan, 'generation')} for {rate(number(status, 'level_bytes_per_second'))}: {who_confirmed(status)}"
    solved = f"{text(allocation, 'status')}, bound by {text(allocation, 'binding').replace('_', ' ')}"
    took = f"{text(allocation, 'backend')}, {duration(number(allocation, 'solve_seconds'))}"
    why = "; ".join(said for said in (text(plan, "reason"), *(f"refused {r}" for r in texts(plan, "refusals"))) if said)
    return [
        _fact("plan", force, width),
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
        return [Text(cut("no publisher announces itself; use arpd.AdaptivePublisher, or relay.topics", width))][:room]
    shown = topics if len(topics) < room else topics[: max(0, room - 2)]
    heading, *lines = (Text(line) for line in topic_table(shown, width=width))
    heading.stylize("bold underline")
    for topic, line in zip(shown, lines, strict=True):
        line.stylize(_topic_style(topic))
    if rest := topics[len(shown) :]:
        held = sum(map(is_held_back, rest))
        note = f"… and {len(rest)} more" + (f", {held} of them held back" if held else "")
        lines.append(Text(cut(note, width), style="dim"))
    return [heading, *lines][:room]


def _rank(topic: dict[str, Any]) -> tuple[bool, float, float, str, str]:
    """Order by what an operator looks for: refusals, then who gives up most, then who uses most of the link."""
    return (
        not _is_refused(topic),
        kept_ratio(topic) if is_held_back(topic) else 1.0,
        -(number(topic, "share") or 0.0),
        text(topic, "topic"),
        text(topic, "node"),
    )


def _is_refused(topic: dict[str, Any]) -> bool:
    return bool(text(topic, "refusal")) and not topic.get("refusal_lasts")


def _topic_style(topic: dict[str, Any]) -> str:
    if _is_refused(topic):
        return "red"
    if is_held_back(topic):
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
    """Draw samples in so many columns, from 0 to the highest; a blank where there was nothing.

    Parameters
    ----------
    pick : which of the samples that share a column stands for them: the worst of them, such as ``max`` for a delay
    highest : what reaches the top, None = the highest sample
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
