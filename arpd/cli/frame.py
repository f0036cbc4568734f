"""The frame that `arpd status` prints and `arpd top` keeps on the screen, drawn from the daemon's documents."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from rich.console import Group
from rich.segment import Segment
from rich.styled import Styled
from rich.text import Text

from arpd.cli.client import number, rows, series, text
from arpd.cli.columns import clock, wall_clock, wrapped
from arpd.cli.fitted_table import FittedTable
from arpd.cli.status_facts import facts, findings, link_now
from arpd.cli.status_tables import is_slowed, pressing_first, topic_table
from arpd.model.quantities import format_duration, format_rate, format_share, printable

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from rich.console import Console, ConsoleOptions, RenderableType

_LABEL, _FIGURES, _LEGEND = 9, 44, 14
_LEAST_SPARKLINE, _MOST_SPARKLINE = 8, 60
_LEAST_EVENTS, _PRINTED_EVENTS = 3, 5
_VERDICTS = {"info": "bold green", "warning": "bold yellow", "error": "bold red"}
_SEVERITIES = {"warning": "yellow", "error": "red"}
_BLOCKS = "▁▂▃▄▅▆▇█"
_IN_ASCII = str.maketrans("…→≤≥" + _BLOCKS, "~><>_.-:=+*#")


@dataclass(frozen=True, kw_only=True, slots=True)
class Frame:
    """A daemon's documents, for rich to print.

    Printed, it shows every topic. On a screen, which does not scroll, it counts topics that do not fit, and fills what
    is left with events.

    Parameters
    ----------
    status : document of ``/api/v1/status``, of any version of arpd
    history : document of ``/api/v1/history``, None where there is none
    url : address of the daemon
    silent_s, why_silent : time since its last answer (s), and why the last try failed; empty while it answers
    is_on_screen : True for a screen, False for what is printed
    """

    status: dict[str, Any]
    history: dict[str, Any] | None = None
    url: str = ""
    silent_s: float = 0.0
    why_silent: str = ""
    is_on_screen: bool = False

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> Iterable[Segment]:
        """Yield the frame, no line wider than the console."""
        head = [self._title(), *self._findings(options.max_width)]
        body = self._body(options.max_width, options.max_height - len(head)) if "link" in self.status else []
        frame = Group(*head, Styled(Group(*body), "dim" if self.why_silent else ""))
        for shown, style, _ in console.render(frame, options.update(height=None, no_wrap=True, overflow="ellipsis")):
            yield Segment(shown.translate(_IN_ASCII) if options.ascii_only else shown, style)

    def _title(self) -> Text:
        age_s = number(self.status, "age_seconds")
        age = "age unknown" if age_s is None else f"{format_duration(age_s)} ago"
        at = wall_clock(number(self.status, "unix_time_seconds"))
        title = f"arpd {text(self.status, 'version')} on {text(self.status, 'interface') or 'no link'}, {at} ({age})"
        return Text(f"{title}, {printable(self.url, longest=80)}" if self.url else title, style="bold")

    def _findings(self, width: int) -> list[Text]:
        sentences = [
            (f"wrong: {finding.text}", "bold red")
            if finding.is_wrong
            else (finding.text, _VERDICTS.get(finding.severity, "bold"))
            for finding in findings(self.status)
        ]
        if self.why_silent:
            of = wall_clock(number(self.status, "unix_time_seconds"))
            lost = f"no answer for {self.silent_s:.0f} s, this is from {of}: {printable(self.why_silent, longest=200)}"
            sentences.insert(0, (lost, "bold red"))
        return [Text(line, style=style) for said, style in sentences for line in wrapped(said, width, indent=2, most=4)]

    def _body(self, width: int, height: int) -> list[RenderableType]:
        """Return what stands below the findings; a screen has so many lines for it."""
        topics, log, courses = pressing_first(rows(self.status, "topics")), self._log(), self._courses(width)
        sections: list[list[RenderableType]] = [
            [*courses, *self._facts(width)],
            [topic_table(topics)] if topics else [],
        ]
        if not self.is_on_screen:
            return _airy([*sections, [*log[-_PRINTED_EVENTS:]]])
        room = height - 1 - sum(1 + sum(map(_lines, section)) for section in sections if section)
        if room >= _LEAST_EVENTS:
            return _airy([*sections, [*log[-room:]]])
        return _squeezed([*courses, *self._facts(width, most=1)], topics, log, height)

    def _courses(self, width: int) -> list[Text]:
        """Return the values that the history has a course of, now and over the last ten minutes."""
        now = link_now(self.status)
        courses: list[tuple[str, tuple[str, ...], Callable[[Iterable[float]], float], Callable[[float], str]]] = [
            ("link", ("link", "capacity_bytes_per_second"), _mean, format_rate),
            ("queue", ("link", "queue_delay_seconds"), max, format_duration),
            ("admitted", ("gate",), min, format_share),
        ]
        lines = []
        for label, keys, worst, show in courses:
            line = _labelled(f"{label:{_LABEL}}{now[label]}")
            samples = series(self.history, *keys)
            known = [sample for sample in samples if sample is not None]
            columns = min(_MOST_SPARKLINE, width - _LABEL - _FIGURES - _LEGEND)
            if known and columns >= _LEAST_SPARKLINE and len(line) < _LABEL + _FIGURES:
                top, extreme = (1.0, f"≥ {show(min(known))}") if worst is min else (max(known), f"≤ {show(max(known))}")
                line.pad_right(_LABEL + _FIGURES - len(line))
                line.append(sparkline(samples, columns, worst, top)).append(f" {extreme}", style="dim")
            lines.append(line)
        return lines

    def _facts(self, width: int, *, most: int = 2) -> list[Text]:
        """Return every fact in ``most`` lines."""
        return [
            _labelled(line)
            for label, fact in facts(self.status)
            for line in wrapped(f"{label:{_LABEL}}{fact}", width, indent=_LABEL, most=most)
        ]

    def _log(self) -> list[Text]:
        now_s = number(self.status, "unix_time_seconds")
        lines = []
        for event in rows(self.status, "events"):
            when = clock(event, now_s)
            line = Text(f"{when}  {text(event, 'text')}", style=_SEVERITIES.get(text(event, "severity"), ""))
            line.stylize("dim", 0, len(when))
            lines.append(line)
        return lines


def _lines(part: RenderableType) -> int:
    return len(part.rows) if isinstance(part, FittedTable) else 1


def _airy(sections: Sequence[Sequence[RenderableType]]) -> list[RenderableType]:
    return [part for section in sections if section for part in ("", *section)]


def _squeezed(
    above: Sequence[Text], topics: Sequence[dict[str, Any]], log: Sequence[Text], height: int
) -> list[RenderableType]:
    """Return the topics that fit between the other two, and how many do not."""
    room = height - len(above)
    events = min(max(_LEAST_EVENTS, room - len(topics) - 1), room - bool(topics), len(log))
    log = log[len(log) - max(0, events) :]
    room -= len(log)
    shown = topics if len(topics) < room else topics[: max(0, room - 2)]
    slowed = sum(map(is_slowed, rest := topics[len(shown) :]))
    note = f"… and {len(rest)} more topics" + (f", {slowed} of them slowed" if slowed else "")
    return [*above, *([topic_table(shown)] if shown else []), *([Text(note, style="dim")] if rest else []), *log]


def _labelled(line: str) -> Text:
    shown = Text(line)
    shown.stylize("bold", 0, _LABEL)
    return shown


def _mean(values: Iterable[float]) -> float:
    there: Sequence[float] = list(values)
    return sum(there) / len(there)


def sparkline(
    samples: Sequence[float | None], columns: int, worst: Callable[[Iterable[float]], float], top: float
) -> str:
    """Draw the worst of the samples that share a column, from 0 to ``top``; a blank where there is none."""
    columns = min(columns, len(samples))
    drawn = []
    for column in range(columns):
        share = samples[column * len(samples) // columns : (column + 1) * len(samples) // columns]
        there = [sample for sample in share if sample is not None]
        height = int(worst(there) / top * len(_BLOCKS)) if there and top > 0 else 0
        drawn.append(_BLOCKS[max(0, min(len(_BLOCKS) - 1, height))] if there else " ")
    return "".join(drawn)
