"""Logging of arpd's processes: plain on a terminal, into the journal with fields of its own under systemd."""

from __future__ import annotations

import logging
import os
import sys
from typing import TYPE_CHECKING, TextIO

from arpd.adapters.systemd.journal import SOCKET, JournalHandler, prefixed, takes_stderr
from arpd.report.events import Severity

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from arpd.report.events import Event

log = logging.getLogger("arpd.events")

_PLAIN = "%(levelname)s %(name)s: %(message)s"
_LEVELS = {Severity.INFO: logging.INFO, Severity.WARNING: logging.WARNING, Severity.ERROR: logging.ERROR}


class _PrefixFormatter(logging.Formatter):
    """Prefixes every line with its syslog priority."""

    def format(self, record: logging.LogRecord) -> str:
        return prefixed(record.levelno, super().format(record))


def configure_logging(
    level: str,
    *,
    name: str = "arpd",
    environ: Mapping[str, str] = os.environ,
    stderr: TextIO | None = None,
    journal: Path = SOCKET,
) -> None:
    """Log at ``level`` (a name of the logging module, any case): to the journal where stderr goes there anyway.

    Parameters
    ----------
    name : of the process, as the journal shows it
    stderr : the process's own when None
    journal : socket of the journal
    """
    logging.basicConfig(level=level.upper(), handlers=[_handler(name, environ, stderr or sys.stderr, journal)])


def _handler(name: str, environ: Mapping[str, str], stderr: TextIO, journal: Path) -> logging.Handler:
    goes_to_journal = takes_stderr(environ, stderr)
    if goes_to_journal and journal.is_socket():
        handler: logging.Handler = JournalHandler(name, stderr=stderr, path=journal)
        handler.setFormatter(logging.Formatter("%(message)s"))
        return handler
    handler = logging.StreamHandler(stderr)
    handler.setFormatter(_PrefixFormatter(_PLAIN) if goes_to_journal else logging.Formatter(_PLAIN))
    return handler


def log_event(event: Event) -> None:
    """Log one line of the decision log; in the journal it has fields of its own (`arpd.adapters.systemd.journal`)."""
    log.log(_LEVELS[event.severity], "%s", event.text, extra={"event": event})
