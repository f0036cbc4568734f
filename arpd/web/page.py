"""The page at ``/``: the status document as plain HTML, without scripts and without anything fetched."""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING, Any

from arpd.web.status import LASTING, confirmed, interface_fault, lease

if TYPE_CHECKING:
    from collections.abc import Iterable

# Only colours the browser knows for both schemes, so that dark and light need no second stylesheet.
_STYLE = """
:root { color-scheme: light dark; }
body { font: 15px/1.45 system-ui, sans-serif; margin: 1.5rem; max-width: 80rem; }
h1 { font-size: 1.3rem; } h2 { font-size: 1.05rem; margin-top: 1.6rem; }
table { border-collapse: collapse; } th, td { padding: .25rem .7rem; text-align: right; white-space: nowrap; }
th:first-child, td:first-child { text-align: left; } tr { border-bottom: 1px solid GrayText; }
td { font-variant-numeric: tabular-nums; } div { overflow-x: auto; } .bad { color: #d33; font-weight: 600; }
"""
_COLUMNS = ("topic", "node", "direction", "source Hz", "planned Hz", "confirmed Hz", "depth", "deadline ms", "Rmax Hz",
            "link share", "bound by", "queued", "withheld", "readers", "refusal")  # fmt: skip
_READER_COLUMNS = ("topic", "node", "planned depth", "depth", "planned deadline ms", "deadline ms", "refusal")


def render_page(status: dict[str, Any] | None) -> str:
    """Return the page for a status document (`arpd.web.status.status_document`); None before the first tick."""
    body = "<p>No tick has finished yet.</p>" if status is None else _body(status)
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8"><meta http-equiv="refresh" content="2">'
        '<meta name="viewport" content="width=device-width"><link rel="icon" href="data:,">'
        f"<title>arpd</title><style>{_STYLE}</style></head><body><h1>arpd</h1>{body}"
        '<p><a href="/metrics">metrics</a> · <a href="/api/v1/status">status as JSON</a> · '
        '<a href="/-/ready">ready</a> · <a href="/-/healthy">healthy</a></p></body></html>\n'
    )


def _body(status: dict[str, Any]) -> str:
    link, plan, allocation, config = status["link"], status["plan"], status["allocation"], status["config"]
    foreign = link["foreign_bytes_per_second"]
    facts = (
        ("link", f"{status['interface']}, {link['state']}"),
        ("capacity", f"{_mbits(link['capacity_bytes_per_second'])} ({link['kind']}: {link['evidence']})"),
        ("foreign traffic", f"{_mbits(foreign)}, which leaves {_mbits(link['available_bytes_per_second'])}"),
        ("delivered", _mbits(link["delivery_rate_bytes_per_second"])),
        ("queue delay", f"{_number(link['queue_delay_seconds'], scale=1e3)} ms"),
        ("gate", _number(status["gate"])),
        ("plan", f"{plan['generation']}, made for {_mbits(status['level_bytes_per_second'])}"),
        ("confirmed", confirmed(plan)),
        ("lease", lease(status)),
        ("program", f"{allocation['status']}, bound by {allocation['binding']} {allocation['degradation']}"),
        ("configuration", config["path"]),
        ("version", status["version"]),
    )
    rows = "".join(f"<tr><th>{escape(name)}</th><td>{escape(str(value))}</td></tr>" for name, value in facts)
    fault = f'<p class="bad">The last reload was refused: {escape(config["error"])}</p>' if config["error"] else ""
    if superior := status["daemons"]["standing_by_for"]:
        fault += f'<p class="bad">Standing by: another arpd daemon, on {escape(superior)}, drives this robot.</p>'
    if reason := interface_fault(status):
        fault += f'<p class="bad">The link interface {escape(status["interface"])} {escape(reason)}.</p>'
    topics, readers = _topics(status["topics"]), _readers(status["readers"])
    return f"{fault}<table>{rows}</table><h2>Topics</h2>{topics}{readers}"


def _topics(topics: list[dict[str, Any]]) -> str:
    if not topics:
        return "<p>No publisher has announced itself.</p>"
    return _table(_COLUMNS, (_cells(topic) for topic in topics))


def _readers(readers: list[dict[str, Any]]) -> str:
    if not readers:
        return ""
    return f"<h2>Readers</h2>{_table(_READER_COLUMNS, (_reader_cells(reader) for reader in readers))}"


def _table(columns: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    head = "".join(f"<th>{column}</th>" for column in columns)
    body = "".join(f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in row)}</tr>" for row in rows)
    return f"<div><table><tr>{head}</tr>{body}</table></div>"


def _cells(topic: dict[str, Any]) -> tuple[str, ...]:
    planned, now = topic["planned"], topic["confirmed"]
    return (
        topic["topic"],
        topic["node"],
        topic["direction"],
        _number(topic["source_rate_hz"]),
        "unmanaged" if planned is None else _number(planned["rate_hz"], missing="unpaced"),
        _number(now["rate_hz"], missing="unpaced"),
        str(now["depth"]),
        _number(now["deadline_ns"], scale=1e-6, missing="none"),
        _number(topic["max_rate_hz"]),
        _number(topic["share"]),
        topic["binding"] or "–",
        str(topic["queued"]),
        str(topic["withheld"]),
        str(topic["remote_readers"]),
        f"{LASTING}{topic['refusal']}" if topic["refusal_lasts"] else topic["refusal"],
    )


def _reader_cells(reader: dict[str, Any]) -> tuple[str, ...]:
    planned, now = reader["planned"], reader["confirmed"]
    return (
        reader["topic"],
        reader["node"],
        "unmanaged" if planned is None else str(planned["depth"]),
        str(now["depth"]),
        "–" if planned is None else _number(planned["deadline_ns"], scale=1e-6, missing="none"),
        _number(now["deadline_ns"], scale=1e-6, missing="none"),
        reader["refusal"],
    )


def _number(value: float | None, *, scale: float = 1.0, missing: str = "–") -> str:
    return missing if value is None else f"{value * scale:.4g}"


def _mbits(bytes_per_second: float | None) -> str:
    return "–" if bytes_per_second is None else f"{bytes_per_second * 8e-6:.2f} Mbit/s"
