"""Progress of long work: on a terminal only, and never mixed into the output."""

from __future__ import annotations

import os
import pty
import subprocess
import sys

import pytest

WORK = """
import sys
from arpd.cli.progress import progress
with progress("working [bold]", total=2) as shown:
    for what in ("one", "two"):
        shown.step(what)
        print("data", what, flush=True)
    shown.reach(2.0)
print("end")
"""


def read_to_end(end):
    told = b""
    while True:
        try:
            told += (part := os.read(end, 65536))
        except OSError:  # how a pty says that nobody writes any more
            break
        if not part:
            break
    os.close(end)
    return told.decode()


@pytest.fixture
def on_a_terminal():
    """Run work whose stderr, and perhaps stdout, is a terminal; returns what was written to each."""

    def run(script, *, stdout_too):
        master, slave = pty.openpty()
        process = subprocess.Popen(
            [sys.executable, "-c", script],
            stdout=slave if stdout_too else subprocess.PIPE,
            stderr=slave,
            env={**os.environ, "TERM": "xterm"},
        )
        os.close(slave)
        shown = read_to_end(master)
        written = "" if stdout_too else process.communicate()[0].decode()
        assert process.wait() == 0, shown
        return shown, written

    return run


def test_a_pipe_gets_the_data_and_nothing_else():
    """Neither stream contains progress."""
    done = subprocess.run([sys.executable, "-c", WORK], capture_output=True, text=True, check=True)
    assert (done.stdout, done.stderr) == ("data one\ndata two\nend\n", "")


def test_progress_shows_beside_data_in_a_pipe(on_a_terminal):
    """Stdout stays unchanged while stderr is a terminal."""
    shown, written = on_a_terminal(WORK, stdout_too=False)
    assert written == "data one\ndata two\nend\n"
    assert "working [bold]" in shown
    assert "data" not in shown


def test_data_on_the_same_terminal_is_not_overwritten(on_a_terminal):
    """Printed lines stay above the progress, which vanishes at the end."""
    shown, _ = on_a_terminal(WORK, stdout_too=True)
    assert "data one\r\n" in shown
    assert shown.index("working") < shown.index("data two")
    assert "working" not in shown[shown.rindex("\x1b[2K") :]
    assert shown.endswith("end\r\n")
