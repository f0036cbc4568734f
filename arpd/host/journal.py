"""Logs to the systemd journal with fields of its own, so that `journalctl ARPD_EVENT=plan` finds every plan.

logging-journald speaks the wire protocol in pure Python; systemd-python and cysystemd need libsystemd to build. arpd
does not use its handler, which waits for a full journal and gives every message another MESSAGE_ID.
"""

from __future__ import annotations

import logging
import os
import re
from contextlib import suppress
from pathlib import Path

from logging_journald import Facility, JournaldTransport, check_journal_stream

from arpd.report.conditions import MESSAGE_IDS, Event, Severity

SOCKET = Path("/run/systemd/journal/socket")
_PRIORITIES = ((logging.CRITICAL, 2), (logging.ERROR, 3), (logging.WARNING, 4), (logging.INFO, 6))
_NO_FIELD = re.compile(r"[^A-Z0-9_]")


class JournalHandler(logging.Handler):
    """Sends every record as one entry; never waits, because a tick may log.

    It counts the records that the journal does not take, and says so before the next one.

    Parameters
    ----------
    identifier : SYSLOG_IDENTIFIER, the name that every line and `journalctl -t` show
    path : the journal's socket
    """

    def __init__(self, identifier: str, *, path: Path = SOCKET) -> None:
        super().__init__()
        self._frame: dict[str, str | int] = {"SYSLOG_IDENTIFIER": identifier, "SYSLOG_FACILITY": Facility.DAEMON.value}
        self._transport = JournaldTransport(path, connected=False)  # unconnected, it finds a restarted journal
        self._transport.socket.settimeout(0.0)
        self._lost = 0

    def emit(self, record: logging.LogRecord) -> None:
        """Send one record."""
        try:
            fields: dict[str, str | int] = {
                "MESSAGE": self.format(record),
                "PRIORITY": next((priority for least, priority in _PRIORITIES if record.levelno >= least), 7),
                "LOGGER": record.name,
            }
            event = getattr(record, "event", None)
            if isinstance(event, Event):
                fields |= _fields_of(event)
            if self._lost:
                self._send({"MESSAGE": f"lost {self._lost} messages: the journal did not take them", "PRIORITY": 4})
                self._lost = 0
            self._send(fields)
        except OSError:
            self._lost += 1
        except Exception:  # noqa: BLE001 - logging must not raise for any record
            self.handleError(record)

    def close(self) -> None:
        """Close the socket."""
        self._transport.socket.close()
        super().close()

    def _send(self, fields: dict[str, str | int]) -> None:
        # File names and ROS names may hold bytes that are no UTF-8.
        texts = {name: str(value).encode("utf-8", "replace").decode() for name, value in (self._frame | fields).items()}
        self._transport.send(texts.items())


def _fields_of(event: Event) -> dict[str, str | int]:
    named = {"EVENT": event.kind, "SEVERITY": event.severity, "TOPIC": event.topic, "NODE": event.node, **event.details}
    details = {f"ARPD_{_NO_FIELD.sub('_', name.upper())}": text for name, text in named.items() if text}
    return {"MESSAGE_ID": MESSAGE_IDS[event.kind], "ARPD_NUMBER": event.number, **details}


log = logging.getLogger("arpd.events")
_PLAIN = "%(levelname)s %(name)s: %(message)s"
_LEVELS = {Severity.INFO: logging.INFO, Severity.WARNING: logging.WARNING, Severity.ERROR: logging.ERROR}


def configure_logging(level: str, *, name: str = "arpd", journal: Path = SOCKET) -> None:
    """Log at ``level`` (a name of the logging module, any case): to the journal if stderr leads there, else to stderr.

    Parameters
    ----------
    name : of the process in the journal; a unit of arpd goes by its own, which has the robot's name in it
    journal : socket of the journal
    """
    has_stderr = False
    with suppress(OSError, ValueError):  # stderr is closed, or JOURNAL_STREAM no file
        has_stderr = check_journal_stream()
    if has_stderr and journal.is_socket():
        unit = Path(os.environ.get("RUNTIME_DIRECTORY") or name).name  # systemd.exec(5); arpd's units name theirs so
        handler: logging.Handler = JournalHandler(unit, path=journal)
        handler.setFormatter(logging.Formatter("%(message)s"))
    else:
        handler = logging.StreamHandler()
        handler.setFormatter(logging.Formatter(_PLAIN))
    logging.basicConfig(level=level.upper(), handlers=[handler])


def log_event(event: Event) -> None:
    """Log one line of the decision log; in the journal it has fields of its own."""
    log.log(_LEVELS[event.severity], "%s", event.text, extra={"event": event})
