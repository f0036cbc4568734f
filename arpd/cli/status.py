"""`arpd status`: one screen of what the daemon sees and does, read from its HTTP status."""

from __future__ import annotations

import argparse
import json
import sys
from typing import Any

from arpd.cli.client import add_address, address, count, counts, number, rows, text, texts
from arpd.cli.columns import cut, duration, last_events, rate, wrapped
from arpd.cli.topics import reader_table, topic_table
from arpd.cli.verdict import faults, verdict, who_confirmed
from arpd.model.errors import ArpdError, DaemonUnreachableError
from arpd.model.quantities import format_duration, format_size
from arpd.report.status import API_VERSION, lease

_NOT_RUNNING = 3  # as systemctl status and every init script since LSB say it
_WITHOUT_END = 10_000
_LABEL = 9


def add_status(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the subcommand."""
    parser = commands.add_parser(
        "status",
        help="show what the daemon sees and does",
        description="""\
Ask a running daemon for its last tick: whether all is well, what it believes of the link, how far the gate is open,
which plan is in force, for every publisher the rate, DEPTH and DEADLINE that it announces (`now→planned` where the two
differ) and what became of its messages, and the last lines of the decision log. `arpd top` shows it live.""",
        epilog="""\
examples:
  arpd status
  arpd status --url http://robot.local:9464
  ARPD_PASSWORD=… arpd status --url https://robot.local:9464 --cacert ca.crt --user robot
  arpd status --json | jq '.topics[] | {topic, planned, confirmed}'
  arpd status >/dev/null || echo "look at the robot"

exit codes:
  0   the daemon governs, and all is well; a link that is too slow, and is coped with, is well
  1   the daemon answers, and something is wrong, which a line says: it is not ready or its ticks do not finish, it
      stands by for another daemon, the interface or the link carries nothing, the last reload was refused, not even
      the floors and reserves fit, or a plan is not confirmed after 15 s
  2   wrong usage
  3   no daemon answers there, or none that lets you in""",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_address(parser)
    parser.add_argument("--json", action="store_true", help="print the daemon's JSON")
    parser.set_defaults(handler=_status)


def _status(options: argparse.Namespace) -> int:
    try:
        status = address(options).status()
    except DaemonUnreachableError as error:
        print(f"arpd: {error}", file=sys.stderr)
        return _NOT_RUNNING
    found = faults(status)
    if "link" in status and not options.json:
        if status["api_version"] != API_VERSION:
            raise ArpdError(f"the daemon at {options.url} speaks another version of arpd; use --json")
        import shutil

        # A pipe has no width, unless COLUMNS gives it one.
        width, height = shutil.get_terminal_size((_WITHOUT_END, _WITHOUT_END))
        print(encodable(screen(status, width=width, height=height)))
        return 1 if found else 0
    if options.json:
        print(json.dumps(status, indent=2))
    for fault in found:
        print(f"arpd: {fault}", file=sys.stderr)
    return 1 if found else 0


def encodable(shown: str) -> str:
    """Replace what this terminal's character set lacks, such as an arrow."""
    encoding = sys.stdout.encoding or "utf-8"
    return shown.encode(encoding, "replace").decode(encoding)


def screen(status: dict[str, Any], *, width: int = _WITHOUT_END, height: int = _WITHOUT_END) -> str:
    """Lay a status document out for a terminal.

    Parameters
    ----------
    width : no line is longer (columns)
    height : what matters less is left out to stay below it, as far as the topics allow (lines)
    """
    for is_airy, events in ((True, 5), (True, 3), (False, 3), (False, 2), (False, 1)):
        lines = _lines(status, width, is_airy=is_airy, events=events)
        if len(lines) < height:  # the shell's prompt wants one, too
            break
    return "\n".join(lines)


def _lines(status: dict[str, Any], width: int, *, is_airy: bool, events: int) -> list[str]:
    gap = [""] if is_airy else []
    log = last_events(status, events, width=width)
    readers = reader_table(status, width=width)
    return [
        cut(_title(status), width),
        *_verdict(status, width),
        *gap,
        *(line for fact in _facts(status, is_airy=is_airy) for line in wrapped(fact, width, indent=_LABEL)),
        *gap,
        *_topics(status, width),
        *(gap + readers if readers else []),
        *(gap + log if log else []),
    ]


def _title(status: dict[str, Any]) -> str:
    age_s = number(status, "age_seconds")
    age = "age unknown" if age_s is None else f"{format_duration(age_s)} ago"
    title = f"arpd {text(status, 'version')} on {text(status, 'interface')}, {age}"
    available, total = number(status, "memory", "available_bytes"), number(status, "memory", "total_bytes")
    if available is None or total is None:
        return title
    return f"{title}; memory {format_size(available)} of {format_size(total)} available"


def _verdict(status: dict[str, Any], width: int) -> list[str]:
    wrong, said = faults(status), verdict(status)
    sentences = [said] * (bool(said) and said not in wrong) + [f"wrong: {fault}" for fault in wrong]
    return [line for sentence in sentences for line in wrapped(sentence, width, indent=2, most=4)]


def _facts(status: dict[str, Any], *, is_airy: bool) -> list[str]:
    plan, allocation = status.get("plan"), status.get("allocation")
    solved = f"{text(allocation, 'status')}, bound by {text(allocation, 'binding').replace('_', ' ')}"
    backend = f"solved by {text(allocation, 'backend')} in {duration(number(allocation, 'solve_seconds'))}"
    force = f"plan {count(plan, 'generation')} for {rate(number(status, 'level_bytes_per_second'))}"
    facts = [
        *_link(status),
        ("gate", f"{_number(number(status, 'gate'))}, {force}: {who_confirmed(status)}"),
        ("", text(plan, "reason")),
        *(("", f"refused: {refusal}") for refusal in texts(plan, "refusals")),
        ("program", f"{solved}, {backend}"),
        ("dropped", _dropped(status)),
        ("lease", lease(status) if is_airy and number(status, "lease", "after_seconds") else ""),
        ("rmw", "" if status.get("rmw") is None else text(status, "rmw", "refusal")),
        *(("daemons", f"in charge; another one stands by on {host}") for host in texts(status, "daemons", "others")),
    ]
    return [f"{label:{_LABEL}}{fact}" for label, fact in facts if fact]


def _link(status: dict[str, Any]) -> list[tuple[str, str]]:
    link = status.get("link")
    capacity, delivered, foreign, available = (
        number(link, f"{name}_bytes_per_second") for name in ("capacity", "delivery_rate", "foreign", "available")
    )
    loss, back_s = number(link, "loss_ratio"), number(link, "return_delay_seconds")
    now = [
        f"queueing {duration(number(link, 'queue_delay_seconds'))}",
        *([] if loss is None else [f"loss {loss:.1%}"]),
        *([] if back_s is None else [f"return delay {format_duration(back_s)}"]),
    ]
    return [
        ("link", f"{rate(capacity)} ({text(link, 'kind')}, {text(link, 'state')}), delivering {rate(delivered)}"),
        ("", ", ".join(now)),
        ("", text(link, "evidence")),
        (
            "",
            f"{rate(foreign)} of it is traffic that is not arpd's, which leaves {rate(available)}" if foreign else "",
        ),
    ]


def _dropped(status: dict[str, Any]) -> str:
    """Say what became of the messages that were not sent, all topics together."""
    topics = rows(status, "topics")
    withheld, offered = (sum(count(topic, name) for topic in topics) for name in ("withheld", "offered"))
    if not withheld or not offered:
        return ""
    by_cause: dict[str, int] = {}
    for topic in topics:
        for cause, many in counts(topic, "withheld_by_cause").items():
            by_cause[cause] = by_cause.get(cause, 0) + many
    causes = ", ".join(f"{cause} {many}" for cause, many in sorted(by_cause.items(), key=lambda item: -item[1]))
    return f"{withheld} of {offered} messages ({withheld / offered:.0%})" + (f": {causes}" if causes else "")


def _topics(status: dict[str, Any], width: int) -> list[str]:
    topics = rows(status, "topics")
    if not topics:
        return ["no publisher announces itself; use arpd.AdaptivePublisher, or name topics under relay.topics"]
    return topic_table(topics, width=width)


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"
