"""`arpd status`: one screen of what the daemon sees and does, read from its HTTP status."""

from __future__ import annotations

import argparse
import base64
import json
import os
import ssl
import sys
import urllib.error
import urllib.request
from dataclasses import dataclass, field
from http import HTTPStatus
from http.client import HTTPException
from pathlib import Path
from typing import Any

from arpd.config_source import printable
from arpd.errors import ArpdError, DaemonUnreachableError, UsageError
from arpd.quantities import format_duration, format_rate, format_size
from arpd.settings import HttpSettings
from arpd.web.status import LASTING, confirmed, interface_fault, lease

_TIMEOUT_S = 3.0
_MAX_BYTES = 16 * 2**20
_LONGEST_LINE = 400
_DEFAULT = HttpSettings()
_PASSWORD = "ARPD_PASSWORD"  # noqa: S105 - the variable's name


@dataclass(frozen=True, kw_only=True, slots=True)
class Login:
    """What a protected daemon asks for.

    Parameters
    ----------
    cacert : CA the daemon's certificate is verified with, None = the system's
    user, password : basic authentication, no user = none
    """

    cacert: Path | None = None
    user: str = ""
    password: str = field(default="", repr=False)

    def authorization(self) -> str:
        """Return the Authorization header, empty without a user."""
        return f"Basic {base64.b64encode(f'{self.user}:{self.password}'.encode()).decode()}" if self.user else ""

    def context(self) -> ssl.SSLContext:
        """Return how to verify the daemon.

        Raises
        ------
        UsageError
            If the CA cannot be used.
        """
        try:
            return ssl.create_default_context(cafile=self.cacert)
        except (OSError, ValueError) as error:
            why = getattr(error, "strerror", None) or error
            raise UsageError(f"--cacert {str(self.cacert)!r} cannot be used ({why}); name a PEM file") from None


_ANONYMOUS = Login()


def add_status(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the subcommand."""
    parser = commands.add_parser(
        "status",
        help="show what the daemon sees and does",
        description="""\
Ask a running daemon for its last tick: what it believes of the link, how far the gate is open, which plan is in force,
and for every publisher the planned and the confirmed rate, DEPTH and DEADLINE.
Exits 69 when no daemon answers, 1 when it answers but is not ready.""",
        epilog="""\
examples:
  arpd status
  arpd status --url http://robot.local:9464
  ARPD_PASSWORD=… arpd status --url https://robot.local:9464 --cacert ca.crt --user robot
  arpd status --json | jq '.topics[] | {topic, planned, confirmed}'
  watch -n 1 arpd status""",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "--url", default=f"http://{_DEFAULT.host}:{_DEFAULT.port}", help="base URL of the daemon (default %(default)s)"
    )
    parser.add_argument(
        "--cacert", type=Path, metavar="FILE", help="CA of the daemon's certificate (default: the system's)"
    )
    parser.add_argument("--user", metavar="NAME", default="", help=f"log in; the password is taken from ${_PASSWORD}")
    parser.add_argument("--json", action="store_true", help="print the daemon's JSON")
    parser.set_defaults(handler=_status)


def _status(options: argparse.Namespace) -> int:
    status = fetch_status(options.url, login=_login(options))
    if options.json:
        print(json.dumps(status, indent=2))
    elif "link" in status:
        try:
            print(screen(status))
        except (KeyError, TypeError) as error:
            raise ArpdError(f"the daemon at {options.url} speaks another version of arpd; use --json") from error
    if not status.get("ready"):
        print("arpd: the daemon is not ready; it has not finished a tick or does not govern yet", file=sys.stderr)
        return 1
    return 0


def _login(options: argparse.Namespace) -> Login:
    if options.user and _PASSWORD not in os.environ:
        raise UsageError(f"--user needs the password in ${_PASSWORD}; it is no option, because ps shows those")
    return Login(cacert=options.cacert, user=options.user, password=os.environ.get(_PASSWORD, ""))


def fetch_status(url: str, *, login: Login = _ANONYMOUS) -> dict[str, Any]:
    """Ask the daemon at a base URL for its status document (`arpd.web.status`).

    Parameters
    ----------
    login : what to trust and who to be

    Raises
    ------
    UsageError
        If the URL is none, or the CA cannot be used.
    DaemonUnreachableError
        If nothing answers there, or something that is not arpd, or arpd refuses.
    """
    if not url.startswith(("http://", "https://")):
        raise UsageError(f"--url {url!r} is not an HTTP address; write it like http://127.0.0.1:9464")
    try:
        code, body = _get(f"{url.rstrip('/')}/api/v1/status", login)
    except (OSError, HTTPException) as error:
        raise DaemonUnreachableError(_no_answer(url, getattr(error, "reason", None) or error)) from None
    except ValueError as error:
        raise UsageError(f"--url {url!r} is not an HTTP address ({error})") from None
    if code == HTTPStatus.UNAUTHORIZED:
        wrong = f"refuses the password of {login.user}" if login.user else "asks for a user; give --user NAME"
        raise DaemonUnreachableError(f"the daemon at {url} {wrong}; the password is taken from ${_PASSWORD}")
    if code == HTTPStatus.TOO_MANY_REQUESTS:
        raise DaemonUnreachableError(f"the daemon at {url} had too many wrong passwords from here; wait a few seconds")
    if code == HTTPStatus.BAD_REQUEST and b"HTTPS" in body[:100]:
        raise DaemonUnreachableError(f"the daemon at {url} speaks HTTPS; write https:// in --url")
    try:
        status = json.loads(body)
    except (ValueError, RecursionError):
        status = None
    if not isinstance(status, dict) or "api_version" not in status:
        raise DaemonUnreachableError(f"what answers at {url} is not arpd; name the daemon's address with --url")
    return status


def _no_answer(url: str, reason: object) -> str:
    if isinstance(reason, ssl.SSLCertVerificationError):
        return f"the certificate of {url} is not trusted ({reason.verify_message}); name its CA with --cacert"
    if isinstance(reason, ssl.SSLError):
        return f"{url} cannot be reached by TLS ({reason.reason or 'the handshake failed'}); does it speak https?"
    return f"no daemon answers at {url} ({reason}); is it running (systemctl status arpd), and is http.port the same?"


def _get(address: str, login: Login) -> tuple[int, bytes]:
    # The daemon is a neighbour: a proxy from the environment would only be in the way.
    handlers: list[urllib.request.BaseHandler] = [urllib.request.ProxyHandler({})]
    if address.startswith("https:"):
        handlers.append(urllib.request.HTTPSHandler(context=login.context()))
    request = urllib.request.Request(address)  # noqa: S310 - the caller admits http and https only
    if header := login.authorization():
        request.add_unredirected_header("Authorization", header)
    try:
        with urllib.request.build_opener(*handlers).open(request, timeout=_TIMEOUT_S) as response:
            return response.status, response.read(_MAX_BYTES)
    except urllib.error.HTTPError as error:
        # A daemon that is not ready says so in the body of its 503.
        return error.code, error.read(_MAX_BYTES)


def screen(status: dict[str, Any]) -> str:
    """Lay a status document out for a terminal."""
    link, plan, allocation, memory = status["link"], status["plan"], status["allocation"], status["memory"]
    estimate = (
        f"{_rate(link['capacity_bytes_per_second'])} ({link['kind']}, {link['state']}), "
        f"delivering {_rate(link['delivery_rate_bytes_per_second'])}, queueing {_duration(link['queue_delay_seconds'])}"
    )
    in_force = f"{plan['generation']} for {_rate(status['level_bytes_per_second'])}: {confirmed(plan)} confirmed"
    solved = f"bound by {allocation['binding']}, solved by {allocation['backend']} in"
    lines = [
        f"arpd {status['version']} on {status['interface']}, {_age(status['age_seconds'])}",
        "",
        f"link     {estimate}",
        f"         {link['evidence']}",
        *([f"         {status['interface']} {fault}"] if (fault := interface_fault(status)) else []),
        *([f"         {_foreign(link)}"] if link["foreign_bytes_per_second"] else []),
        f"gate     {_number(status['gate'])}",
        f"plan     {in_force}",
        *([f"         {plan['reason']}"] if plan["reason"] else []),
        *(f"         refused: {refusal}" for refusal in plan["refusals"]),
        f"program  {allocation['status']}, {solved} {_duration(allocation['solve_seconds'])}",
        *([f"         given up: {allocation['degradation']}"] if allocation["degradation"] else []),
        *([f"lease    {lease(status)}"] if "lease" in status else []),
        *([f"rmw      {status['rmw']['refusal']}"] if status.get("rmw") and not status["rmw"]["swaps"] else []),
        *_daemons(status.get("daemons", {})),
        f"memory   {format_size(memory['available_bytes'])} of {format_size(memory['total_bytes'])} available",
    ]
    if error := status["config"]["error"]:
        lines.append(f"config   the last reload was refused: {error}")
    lines.append("")
    lines += _topics(status["topics"])
    lines += _readers(status.get("readers", []))
    # Names and reasons come from other hosts; none of them may steer the terminal.
    return "\n".join(printable(line, longest=_LONGEST_LINE) for line in lines)


def _daemons(daemons: dict[str, Any]) -> list[str]:
    """Say what only matters where two daemons were started for one robot."""
    if superior := daemons.get("standing_by_for"):
        return [f"daemons  standing by: another arpd daemon, on {superior}, drives this robot"]
    return [f"daemons  in charge; another one stands by on {host}" for host in daemons.get("others", [])]


def _foreign(link: dict[str, Any]) -> str:
    foreign, available = link["foreign_bytes_per_second"], link["available_bytes_per_second"]
    return f"{_rate(foreign)} of it is traffic that is not arpd's, which leaves {_rate(available)}"


def _topics(topics: list[dict[str, Any]]) -> list[str]:
    if not topics:
        return ["no publisher announces itself; use arpd.AdaptivePublisher, or name topics under relay.topics"]
    head = ("TOPIC", "RATE Hz", "planned", "source", "DEPTH", "planned", "DEADLINE", "planned", "WITHHELD", "BOUND BY")
    return _table([head, *(_row(topic) for topic in topics)])


def _readers(readers: list[dict[str, Any]]) -> list[str]:
    if not readers:
        return []
    head = ("READER OF", "DEPTH", "planned", "DEADLINE", "planned", "NODE")
    return ["", *_table([head, *(_reader_row(reader) for reader in readers)])]


def _table(rows: list[tuple[str, ...]]) -> list[str]:
    """Lay rows out under their first; all columns but the first and the last are numbers."""
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    lines = []
    for row in rows:
        numbers = (text.rjust(width) for text, width in zip(row[1:-1], widths[1:-1], strict=True))
        lines.append("  ".join((row[0].ljust(widths[0]), *numbers, row[-1])).rstrip())
    return lines


def _row(topic: dict[str, Any]) -> tuple[str, ...]:
    now, planned = topic["confirmed"], topic["planned"]
    offered = topic["offered"]
    return (
        topic["topic"],
        _paced(now["rate_hz"]),
        _paced(planned["rate_hz"]) if planned else "-",
        _number(topic["source_rate_hz"]),
        str(now["depth"]),
        str(planned["depth"]) if planned else "-",
        _deadline(now["deadline_ns"]),
        _deadline(planned["deadline_ns"]) if planned else "-",
        f"{topic['withheld']} ({topic['withheld'] / offered:.0%})" if offered else str(topic["withheld"]),
        _bound_by(topic),
    )


def _reader_row(reader: dict[str, Any]) -> tuple[str, ...]:
    now, planned = reader["confirmed"], reader["planned"]
    return (
        reader["topic"],
        str(now["depth"]),
        str(planned["depth"]) if planned else "-",
        _deadline(now["deadline_ns"]),
        _deadline(planned["deadline_ns"]) if planned else "-",
        f"{reader['node']}: {reader['refusal']}" if reader["refusal"] else str(reader["node"]),
    )


def _bound_by(topic: dict[str, Any]) -> str:
    if topic["refusal"]:
        return f"{LASTING}{topic['refusal']}" if topic.get("refusal_lasts") else str(topic["refusal"])
    return topic["binding"] or "-"


def _paced(rate_hz: float | None) -> str:
    return "unpaced" if rate_hz is None else _number(rate_hz)


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"


def _rate(bytes_per_second: float | None) -> str:
    return "-" if bytes_per_second is None else format_rate(bytes_per_second)


def _duration(seconds: float | None) -> str:
    return "-" if seconds is None else format_duration(seconds)


def _deadline(period_ns: int | None) -> str:
    return "none" if period_ns is None else format_duration(period_ns * 1e-9)


def _age(seconds: float | None) -> str:
    return "age unknown" if seconds is None else f"{format_duration(seconds)} ago"
