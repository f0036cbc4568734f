"""`arpd status`: one screen of what the daemon sees and does, read from its HTTP status."""

from __future__ import annotations

import argparse
import json
import sys
from typing import Any, NamedTuple

from arpd.cli.client import add_address, address, count, counts, find, number, rows, text, texts
from arpd.cli.columns import WITHOUT_END, cut, last_events, wrapped
from arpd.cli.no_daemon import tell_no_daemon
from arpd.cli.status_tables import reader_table, topic_table
from arpd.model.errors import ArpdError, DaemonUnreachableError
from arpd.model.quantities import format_duration, format_rate, format_share, format_size
from arpd.report.events import Severity
from arpd.report.situation import STALE_AFTER_S, stale
from arpd.report.status import API_VERSION
from arpd.report.wording import confirmed, lease

_NOT_RUNNING = 3  # as systemctl status and every init script since LSB say it
_LABEL = 9


def add_status(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the subcommand."""
    parser = commands.add_parser(
        "status",
        help="show what the daemon sees and does",
        description="""\
Ask a running daemon for its last tick: whether all is well, the link, the budget of the topics, the plan in force, the
rate that each publisher is allowed, the DEPTH and DEADLINE that it announces (`now→planned` where the two differ), its
dropped messages, and the last lines of the decision log. `arpd top` shows the same live.""",
        epilog="""\
examples:
  arpd status
  arpd status --url http://robot.local:9464
  ARPD_PASSWORD=… arpd status --url https://robot.local:9464 --cacert ca.crt --user robot
  arpd status --json | jq '.topics[] | {topic, planned, confirmed}'
  arpd status >/dev/null || echo "look at the robot"

exit codes:
  0   the daemon governs, and all is well; a slow link that arpd copes with is well
  1   the daemon answers, and a line says what is wrong: it is not ready, no tick finishes, it stands by for another
      daemon, the interface or the link carries nothing, it refused the last reload, not even the floors and reserves
      fit, or a plan is not confirmed after 15 s
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
        tell_no_daemon(error, options.url)
        return _NOT_RUNNING
    wrong = [finding.text for finding in findings(status) if finding.is_wrong]
    if "link" in status and not options.json:
        if status["api_version"] != API_VERSION:
            raise ArpdError(f"the daemon at {options.url} speaks another version of arpd; use --json")
        import shutil

        # A pipe has no width, unless COLUMNS gives it one.
        width, height = shutil.get_terminal_size((WITHOUT_END, WITHOUT_END))
        sys.stdout.reconfigure(errors="replace")  # type: ignore[union-attr] # a terminal may lack an arrow
        print(screen(status, width=width, height=height))
        return 1 if wrong else 0
    if options.json:
        print(json.dumps(status, indent=2))
    for fault in wrong:
        print(f"arpd: {fault}", file=sys.stderr)
    return 1 if wrong else 0


def screen(status: dict[str, Any], *, width: int = WITHOUT_END, height: int = WITHOUT_END) -> str:
    """Lay a status document out for a terminal.

    Parameters
    ----------
    width : no line is longer (columns)
    height : the screen leaves out what matters less to stay below it, but never a topic (lines)
    """
    for is_airy, events in ((True, 5), (True, 3), (False, 3), (False, 2), (False, 1)):
        lines = _lines(status, width, is_airy=is_airy, events=events)
        if len(lines) < height:  # the shell's prompt wants one, too
            break
    return "\n".join(lines)


def _lines(status: dict[str, Any], width: int, *, is_airy: bool, events: int) -> list[str]:
    gap = [""] if is_airy else []
    log = last_events(status, events, width=width)
    topics, readers = _topics(status, width), reader_table(status, width=width)
    return [
        cut(_title(status), width),
        *_findings(status, width),
        *gap,
        *(line for fact in _facts(status, is_airy=is_airy) for line in wrapped(fact, width, indent=_LABEL)),
        *(gap + topics if topics else []),
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


def _findings(status: dict[str, Any], width: int) -> list[str]:
    sentences = [f"wrong: {finding.text}" if finding.is_wrong else finding.text for finding in findings(status)]
    return [line for sentence in sentences for line in wrapped(sentence, width, indent=2, most=4)]


def _facts(status: dict[str, Any], *, is_airy: bool) -> list[str]:
    plan, allocation = status.get("plan"), status.get("allocation")
    solved = f"{text(allocation, 'status')}, bound by {text(allocation, 'binding').replace('_', ' ')}"
    backend = f"solved by {text(allocation, 'backend')} in {format_duration(number(allocation, 'solve_seconds'))}"
    force = f"{count(plan, 'generation')} for {format_rate(number(status, 'level_bytes_per_second'))}"
    facts = [
        *_link(status),
        ("budget", _budget(status)),
        ("plan", f"{force}: {who_confirmed(status)}"),
        ("", text(plan, "reason")),
        *(("", f"refused: {refusal}") for refusal in texts(plan, "refusals")),
        ("program", f"{solved}, {backend}"),
        ("relay", _relay(status.get("relay"))),
        ("dropped", _dropped(status)),
        ("lease", lease(lease_s) if is_airy and (lease_s := number(status, "lease", "after_seconds")) else ""),
        ("rmw", "" if status.get("rmw") is None else text(status, "rmw", "refusal")),
        *(("daemons", f"in charge; another one stands by on {host}") for host in texts(status, "daemons", "others")),
    ]
    return [f"{label:{_LABEL}}{fact}" for label, fact in facts if fact]


def _link(status: dict[str, Any]) -> list[tuple[str, str]]:
    link = status.get("link")
    delivered, cross_traffic, available = (
        number(link, f"{name}_bytes_per_second") for name in ("delivery_rate", "foreign", "available")
    )
    carries = format_rate(number(link, "capacity_bytes_per_second"))
    of_others = f"{format_rate(cross_traffic)} of it is cross traffic, which leaves {format_rate(available)}"
    loss, back_s = number(link, "loss_ratio"), number(link, "return_delay_seconds")
    now = [
        f"queueing {format_duration(number(link, 'queue_delay_seconds'))}",
        *([] if loss is None else [f"loss {format_share(loss)}"]),
        *([] if back_s is None else [f"return delay {format_duration(back_s)}"]),
    ]
    return [
        ("link", f"{carries} ({text(link, 'kind')}, {text(link, 'state')}), delivering {format_rate(delivered)}"),
        ("", ", ".join(now)),
        ("", text(link, "evidence")),
        ("", of_others if cross_traffic else ""),
    ]


def _relay(relay: Any) -> str:
    """Say what crosses between the two ends of the relay."""
    if relay is None:
        return ""
    to_ceddp, to_robot = (
        f"{count(find(relay, way), 'wanted')} of {count(find(relay, way), 'offered')}"
        for way in ("to_ceddp", "to_robot")
    )
    others = (
        (count(relay, "incomplete"), "samples of incomplete groups dropped"),
        (sum(counts(relay, "calls_failed").values()), "calls failed"),
        (len(differ) if isinstance(differ := find(relay, "types_differ"), dict) else 0, "topics with two types"),
        (len(texts(relay, "strangers")), "nodes in the link domain that are not arpd's"),
    )
    host = f" ({host})" if (host := text(relay, "other_host")) else ""
    now = "cross" if find(relay, "reachable") is True else "wait to cross"
    crosses = f"{to_ceddp} topics {now} to the CEDDP{host}, {to_robot} to the robot"
    return "; ".join([crosses, *(f"{many} {what}" for many, what in others if many)])


def _budget(status: dict[str, Any]) -> str:
    """Say what the topics may use now, and the part of their traffic above the floors that it admits."""
    usable = format_rate(number(status, "allocation", "capacity_bytes_per_second"))
    return f"{usable}, admits {format_share(number(status, 'gate'))} above the floors"


def _dropped(status: dict[str, Any]) -> str:
    """Say why messages of all topics together were not sent."""
    topics = rows(status, "topics")
    withheld, offered = (sum(count(topic, name) for topic in topics) for name in ("withheld", "offered"))
    if not withheld or not offered:
        return ""
    by_cause: dict[str, int] = {}
    for topic in topics:
        for cause, many in counts(topic, "withheld_by_cause").items():
            by_cause[cause] = by_cause.get(cause, 0) + many
    causes = ", ".join(f"{cause} {many}" for cause, many in sorted(by_cause.items(), key=lambda item: -item[1]))
    return f"{withheld} of {offered} messages ({format_share(withheld / offered)})" + (f": {causes}" if causes else "")


def _topics(status: dict[str, Any], width: int) -> list[str]:
    topics = rows(status, "topics")
    return topic_table(topics, width=width) if topics else []


class Finding(NamedTuple):
    """A sentence of the daemon about its situation, and whether somebody should look."""

    text: str
    severity: str
    is_wrong: bool


def findings(status: dict[str, Any]) -> list[Finding]:
    """Return what the daemon says of its situation: its verdict, then faults, the worst first."""
    if not status.get("ready"):
        return [_wrong("Not ready: the daemon has just started or is stuck; if this stays, see journalctl -u arpd.")]
    is_older = "faults" not in status
    found = []
    if said := text(status, "verdict", "text"):
        severity = text(status, "verdict", "severity")
        is_wrong = severity == Severity.ERROR if is_older else find(status, "verdict", "wrong") is True
        found.append(Finding(said, severity, is_wrong))
    if is_older and (age_s := number(status, "age_seconds") or 0.0) > STALE_AFTER_S:
        found.append(_wrong(stale(age_s).text))
    faults = rows(status, "faults")
    return found + [Finding(text(each, "text"), text(each, "severity"), each.get("wrong") is True) for each in faults]


def _wrong(said: str) -> Finding:
    return Finding(said, Severity.ERROR, is_wrong=True)


def who_confirmed(status: dict[str, Any]) -> str:
    """Say who announces the plan in force."""
    plan = status.get("plan")
    return confirmed(
        confirmed=count(plan, "confirmed"),
        publishers=count(plan, "publishers"),
        paced_only=count(plan, "paced_only"),
        readers_confirmed=count(plan, "readers_confirmed"),
        readers=count(plan, "readers"),
    )
