"""Logging of arpd's processes: plain on a terminal, with priorities the journal understands under systemd."""

from __future__ import annotations

import logging
import os
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping

_PLAIN = "%(levelname)s %(name)s: %(message)s"


class _JournalFormatter(logging.Formatter):
    """Prefixes ``<n>``, the syslog priority that systemd takes off every line (sd-daemon(3))."""

    def format(self, record: logging.LogRecord) -> str:
        priority = next((n for level, n in _PRIORITIES if record.levelno >= level), 7)
        return "\n".join(f"<{priority}>{line}" for line in super().format(record).splitlines())


_PRIORITIES = ((logging.CRITICAL, 2), (logging.ERROR, 3), (logging.WARNING, 4), (logging.INFO, 6))


def configure_logging(level: str, *, environ: Mapping[str, str] = os.environ) -> None:
    """Log to stderr at ``level`` (a name of the logging module, any case)."""
    handler = logging.StreamHandler()
    # systemd sets JOURNAL_STREAM where stderr goes to the journal (systemd.exec(5)).
    formatter = _JournalFormatter if "JOURNAL_STREAM" in environ else logging.Formatter
    handler.setFormatter(formatter(_PLAIN))
    logging.basicConfig(level=level.upper(), handlers=[handler])
