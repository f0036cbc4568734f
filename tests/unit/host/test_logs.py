"""The destination of a process's log: terminal, journal or a redirected stderr."""

from __future__ import annotations

import logging
import os
import socket

import pytest

from arpd.host.journal import JournalHandler, configure_logging


@pytest.fixture(autouse=True)
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
def stderr(tmp_path):
    with (tmp_path / "stderr").open("w+") as stream:
        yield stream


def stream_of(file):
    """Return the JOURNAL_STREAM that names a file."""
    status = os.fstat(file.fileno())
    return {"JOURNAL_STREAM": f"{status.st_dev}:{status.st_ino}"}


def configure(**options):
    """Configure logging as in a new process, without pytest's handlers."""
    logging.getLogger().handlers.clear()
    configure_logging("info", **options)


def logged(stderr, text):
    logging.getLogger("arpd.daemon.tick").warning(text)
    stderr.seek(0)
    return stderr.read()


def test_under_systemd_entries_go_to_the_journal(stderr, tmp_path, root):
    """If stderr leads to the journal, records go to its socket under the process's name, and none to stderr."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as journal:
        journal.bind(str(tmp_path / "socket"))
        configure(name="arpd-relay", environ=stream_of(stderr), stderr=stderr, journal=tmp_path / "socket")
        assert isinstance(root.handlers[0], JournalHandler)
        assert logged(stderr, "hello") == ""
        entry = journal.recv(10_000)
    assert entry.startswith(b"MESSAGE=hello\nPRIORITY=4\nSYSLOG_IDENTIFIER=arpd-relay\n")


@pytest.mark.parametrize("stream", ["1:2", "", "nonsense"])
def test_a_stderr_that_was_redirected_is_written_to(stderr, tmp_path, stream):
    """A JOURNAL_STREAM that names another file than stderr has no effect."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as journal:
        journal.bind(str(tmp_path / "socket"))
        configure(environ={"JOURNAL_STREAM": stream}, stderr=stderr, journal=tmp_path / "socket")
        assert logged(stderr, "hello") == "WARNING arpd.daemon.tick: hello\n"
