"""The journal's native protocol, at a socket of the test."""

from __future__ import annotations

import contextlib
import logging
import os
import socket
import struct
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from arpd.host.journal import JournalHandler, configure_logging, log_event
from arpd.report.conditions import MESSAGE_IDS, Happening
from tests.golden.sample import EVENT

CATALOG = Path(__file__).parents[3] / "systemd/arpd.catalog"
LOST = "lost 1 messages: the journal did not take them"


def fields(data):
    """Return the fields of one entry: `KEY=value`, or `KEY`, a length of 64 bits and the value."""
    found = {}
    while data:
        line, _, rest = data.partition(b"\n")
        if b"=" in line:
            name, _, value = line.partition(b"=")
            data = rest
        else:
            name, (length,) = line, struct.unpack("<Q", rest[:8])
            value, data = rest[8 : 8 + length], rest[9 + length :]
        assert name not in found
        found[name.decode()] = value.decode()
    return found


class Journal:
    """A journald that reads an entry when the test asks."""

    def __init__(self, path):
        self.path = path
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.socket.bind(str(path))
        self.socket.settimeout(60.0)

    def entry(self):
        """Return one entry."""
        return fields(self.socket.recv(1 << 18))

    def waiting(self):
        """Return the messages that wait to be read."""
        self.socket.settimeout(0.0)
        found = []
        with contextlib.suppress(BlockingIOError):
            while True:
                found.append(self.entry()["MESSAGE"])
        return found


@pytest.fixture
def journal(tmp_path):
    journal = Journal(tmp_path / "socket")
    yield journal
    journal.socket.close()


@pytest.fixture
def logger(journal):
    handler = JournalHandler("arpd-test", path=journal.path)
    log = logging.getLogger("arpd.events")
    log.addHandler(handler)
    log.setLevel("DEBUG")
    log.propagate = False
    yield log
    log.removeHandler(handler)
    log.propagate = True
    handler.close()


def test_an_event_is_an_entry_with_its_fields(journal, logger):
    """Kind, severity, number, topic, node and every detail of an event are fields."""
    details = {"cause": "down", "level_bytes_per_second": "540000"}
    log_event(replace(EVENT, topic="/scan", node="/lidar", details=details))
    entry = journal.entry()
    assert {name: text for name, text in entry.items() if name.startswith(("ARPD_", "MESSAGE", "PRIO", "SYSLOG"))} == {
        "MESSAGE": "link fell to 4.8 Mbit/s: /camera/image 30 → 2.1 Hz",
        "PRIORITY": "4",
        "SYSLOG_IDENTIFIER": "arpd-test",
        "SYSLOG_FACILITY": "3",
        "MESSAGE_ID": MESSAGE_IDS[Happening.PLAN],
        "ARPD_EVENT": "plan",
        "ARPD_SEVERITY": "warning",
        "ARPD_NUMBER": "7",
        "ARPD_TOPIC": "/scan",
        "ARPD_NODE": "/lidar",
        "ARPD_CAUSE": "down",
        "ARPD_LEVEL_BYTES_PER_SECOND": "540000",
    }


def test_a_journal_that_comes_back_is_found(journal, logger, tmp_path):
    """A new journal at the same path gets the next line, and learns how many were lost."""
    journal.socket.close()
    journal.path.unlink()
    logger.warning("one")
    again = Journal(journal.path)
    logger.warning("two")
    assert [again.entry()["MESSAGE"] for _ in range(2)] == [LOST, "two"]
    again.socket.close()


def test_a_journal_that_hangs_stops_nobody(journal, logger):
    """While the journal is full, logging does not wait; each line arrives, or is counted as lost."""
    taken = []
    for number in range(3_000):
        logger.warning("line %05d %s", number, "x" * 200)
        if number in {1_000, 2_000}:
            taken.append(journal.entry()["MESSAGE"])  # room for one
    taken += journal.waiting()
    logger.warning("line of the end")
    taken += journal.waiting()
    lines = [message for message in taken if message.startswith("line ")]
    lost = [int(message.split()[1]) for message in taken if message not in lines]
    assert 0 < len(lines) < 3_000
    assert len(lines) + sum(lost) == 3_001


@pytest.fixture
def root():
    """Restore the root logger after the test."""
    logger = logging.getLogger()
    handlers, level = logger.handlers[:], logger.level
    yield logger
    for handler in set(logger.handlers) - set(handlers):
        handler.close()
    logger.handlers[:] = handlers
    logger.setLevel(level)


@pytest.fixture
def say(journal, root, tmp_path, monkeypatch):
    """Say hello, logging as in a unit whose stderr leads to the journal; return what stands on stderr."""

    def say(**environ):
        with (tmp_path / "stderr").open("w+") as stderr:
            status = os.fstat(stderr.fileno())
            for variable, value in {"JOURNAL_STREAM": f"{status.st_dev}:{status.st_ino}", **environ}.items():
                monkeypatch.setenv(variable, value)
            monkeypatch.setattr(sys, "stderr", stderr)
            root.handlers.clear()  # pytest's
            configure_logging("info", name="arpd-relay-far", journal=journal.path)
            logging.getLogger("arpd.relay").warning("hello")
            stderr.seek(0)
            return stderr.read()

    return say


@pytest.mark.parametrize(
    ("environ", "name"),
    [
        ({}, "arpd-relay-far"),
        ({"RUNTIME_DIRECTORY": ""}, "arpd-relay-far"),
        ({"RUNTIME_DIRECTORY": "/run/arpd-relay-far@robot1"}, "arpd-relay-far@robot1"),
    ],
)
def test_entries_go_to_the_journal_by_the_name_of_their_unit(journal, say, environ, name):
    """The journal distinguishes the far ends of several robots, by the folder in /run that systemd names."""
    assert say(**environ) == ""
    entry = journal.entry()
    assert (entry["MESSAGE"], entry["PRIORITY"], entry["SYSLOG_IDENTIFIER"]) == ("hello", "4", name)


@pytest.mark.parametrize("stream", ["1:2", "", "nonsense"])
def test_entries_go_to_the_journal_only_where_stderr_does(say, stream):
    """A JOURNAL_STREAM that names another file than stderr, which was redirected, has no effect."""
    assert say(JOURNAL_STREAM=stream) == "WARNING arpd.relay: hello\n"


def catalog():
    """Return the catalog: message id → headers and text."""
    entries = [entry.split("\n\n", 1) for entry in CATALOG.read_text().split("\n-- ")[1:]]
    return {head.split("\n")[0]: (head, words) for head, words in entries}


def test_the_catalog_explains_every_event():
    """The catalog has a subject and an explanation for every kind of event, which all have ids of their own."""
    assert len({*MESSAGE_IDS.values()}) == len(MESSAGE_IDS)
    assert set(catalog()) == set(MESSAGE_IDS.values())
    for head, words in catalog().values():
        assert "\nSubject: " in head
        assert len(words.strip()) > 20
