"""What a status document says in sentences: what is wrong or to be known, then link, plan, program and the rest."""

from __future__ import annotations

from collections import Counter
from typing import Any, NamedTuple

from arpd.cli.client import count, counts, find, number, rows, text, texts
from arpd.model.quantities import format_duration, format_rate, format_share, format_size
from arpd.report.events import Severity
from arpd.report.situation import STALE_AFTER_S, stale
from arpd.report.wording import confirmed, lease


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


def link_now(status: dict[str, Any]) -> dict[str, str]:
    """Return what the history has a course of, as it is now, by name."""
    link = status.get("link")
    loss, back_s = number(link, "loss_ratio"), number(link, "return_delay_seconds")
    queue = [
        format_duration(number(link, "queue_delay_seconds")),
        *([] if loss is None else [f"loss {format_share(loss)}"]),
        *([] if back_s is None else [f"return delay {format_duration(back_s)}"]),
    ]
    carries = format_rate(number(link, "capacity_bytes_per_second"))
    return {
        "link": f"{carries} ({text(link, 'kind')}, {text(link, 'state')})",
        "queue": ", ".join(queue),
        "admitted": f"{format_share(number(status, 'gate'))} above the floors",
    }


def facts(status: dict[str, Any]) -> list[tuple[str, str]]:
    """Return label and sentence of everything else but topics and log; without a label, more of the same."""
    plan = status.get("plan")
    force = f"{count(plan, 'generation')} for {format_rate(number(status, 'level_bytes_per_second'))}"
    why = [text(plan, "reason"), *(f"refused {refusal}" for refusal in texts(plan, "refusals"))]
    lease_s = number(status, "lease", "after_seconds")
    said = [
        ("traffic", _traffic(status)),
        ("evidence", text(status, "link", "evidence")),
        ("plan", f"{force}: {_who_confirmed(plan)}"),
        ("", "; ".join(filter(None, why))),
        ("program", _program(status)),
        ("relay", _relay(status.get("relay"))),
        ("withheld", _withheld(rows(status, "topics"))),
        ("lease", lease(lease_s) if lease_s else ""),
        ("rmw", text(status, "rmw", "refusal")),
        *(("daemons", f"in charge; another one stands by on {host}") for host in texts(status, "daemons", "others")),
    ]
    return [(label, fact) for label, fact in said if fact]


def _traffic(status: dict[str, Any]) -> str:
    link = status.get("link")
    delivered, cross_traffic, left = (
        number(link, f"{name}_bytes_per_second") for name in ("delivery_rate", "foreign", "available")
    )
    budget = format_rate(number(status, "allocation", "capacity_bytes_per_second"))
    of_others = f", {format_rate(cross_traffic)} of cross traffic, {format_rate(left)} left" if cross_traffic else ""
    return f"delivering {format_rate(delivered)}, budget {budget}{of_others}"


def _who_confirmed(plan: Any) -> str:
    """Say who announces the plan in force."""
    return confirmed(
        confirmed=count(plan, "confirmed"),
        publishers=count(plan, "publishers"),
        paced_only=count(plan, "paced_only"),
    )


def _program(status: dict[str, Any]) -> str:
    """Say how the program was solved, and what is left of the memory that its depths take."""
    allocation = status.get("allocation")
    solved = f"{text(allocation, 'status')}, bound by {text(allocation, 'binding').replace('_', ' ')}"
    took = f"{text(allocation, 'backend')}, {format_duration(number(allocation, 'solve_seconds'))}"
    available, total = number(status, "memory", "available_bytes"), number(status, "memory", "total_bytes")
    if available is None or total is None:
        return f"{solved} ({took})"
    return f"{solved} ({took}); {format_size(available)} of {format_size(total)} memory available"


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


def _withheld(topics: list[dict[str, Any]]) -> str:
    """Say why messages of all topics together were withheld."""
    withheld, offered = (sum(count(topic, name) for topic in topics) for name in ("withheld", "offered"))
    if not withheld or not offered:
        return ""
    by_cause: Counter[str] = Counter()
    for topic in topics:
        by_cause.update(counts(topic, "withheld_by_cause"))
    causes = ", ".join(f"{cause} {many}" for cause, many in by_cause.most_common())
    return f"{withheld} of {offered} messages ({format_share(withheld / offered)})" + (f": {causes}" if causes else "")
