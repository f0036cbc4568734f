"""`arpd top`: the terminal that it draws on, and the connection that it keeps."""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import pty
import select
import signal
import struct
import subprocess
import sys
import termios

import pytest

from tests.unit.fake_daemon import HISTORY, busy, serving
from tests.waiting import eventually

ENTER, LEAVE = "\x1b[?1049h", "\x1b[?1049l"


@pytest.fixture
def daemon():
    """Serve a document and a history."""
    with serving(json.dumps(busy()), history=json.dumps(HISTORY)) as url:
        yield url


@pytest.mark.parametrize(("is_terminal", "kind"), [(False, "xterm"), (True, "dumb")])
def test_live_needs_a_terminal_that_can_be_drawn_on(run, monkeypatch, is_terminal, kind):
    """For a pipe or a dumb terminal the error names the other command."""
    monkeypatch.setattr(sys.stdout, "isatty", lambda: is_terminal)
    monkeypatch.setenv("TERM", kind)
    code, _, err = run("top")
    assert (code, "arpd status" in err) == (2, True)


class Screen:
    """A terminal with ``arpd`` on it."""

    def __init__(self, *arguments, stdin):
        self._master, slave = pty.openpty()
        fcntl.ioctl(self._master, termios.TIOCSWINSZ, struct.pack("HHHH", 30, 100, 0, 0))
        self.before = termios.tcgetattr(slave)
        self._slave = slave
        self.process = subprocess.Popen(
            [sys.executable, "-m", "arpd.cli", *arguments],
            stdin=stdin or slave,
            stdout=slave,
            stderr=slave,
            env={**os.environ, "TERM": "xterm-256color"},
            start_new_session=True,
        )
        self.written = ""

    def await_text(self, text):
        """Read until the text is written; returns what was written so far."""
        eventually(f"{text!r} on the screen", lambda: text in self._read())
        return self.written

    def _read(self):
        with contextlib.suppress(OSError):  # nobody writes any more
            while select.select([self._master], [], [], 0)[0]:
                self.written += os.read(self._master, 65536).decode(errors="replace")
        return self.written

    def press(self, keys):
        os.write(self._master, keys)

    def modes(self):
        return termios.tcgetattr(self._slave)

    def close(self):
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait()
        os.close(self._master)
        os.close(self._slave)


@pytest.fixture
def top():
    """Start ``arpd top`` on a terminal."""
    with contextlib.ExitStack() as screens:

        def top(url, *options, stdin=None):
            screen = Screen("top", "--url", url, *options, stdin=stdin)
            screens.callback(screen.close)
            return screen

        yield top


@pytest.mark.parametrize("end", ["q", signal.SIGINT, signal.SIGTERM])
def test_top_gives_the_terminal_back(top, daemon, end):
    """A key or a signal ends it: the screen from before, the cursor, the keyboard, exit 0."""
    screen = top(daemon)
    screen.await_text("event 29")
    assert screen.written.index(ENTER) < screen.written.index("arpd 1.2.3")
    assert screen.modes() != screen.before
    if end == "q":
        screen.press(b"q")
    else:
        screen.process.send_signal(end)
    written = screen.await_text(LEAVE)
    assert screen.process.wait(60) == 0
    assert written.rindex("\x1b[?25h") > written.rindex("\x1b[?25l")
    assert screen.modes() == screen.before
    assert "Traceback" not in written


def test_top_exits_as_status_does_where_no_daemon_answers(top):
    """The reason stands on the terminal as it was."""
    with serving("{}") as url:
        pass
    screen = top(url)
    assert "no daemon answers" in screen.await_text("systemctl status arpd")
    assert screen.process.wait(60) == 3
    assert ENTER not in screen.written


def test_top_waits_for_a_daemon_that_goes_away(top):
    """It says so, goes on, also without a keyboard, and shows the daemon that comes back."""
    answers = {"body": json.dumps(busy())}
    with serving(lambda: answers["body"], history=json.dumps(HISTORY)) as url:
        screen = top(url, stdin=subprocess.DEVNULL)
        screen.await_text("event 29")
        answers["body"] = "<html>"
        screen.await_text("no answer for ")
        assert screen.process.poll() is None
        again = busy()
        again["verdict"]["text"] = "Back again"
        answers["body"] = json.dumps(again)
        written = screen.await_text("Back again")
        assert "no answer" not in written[written.rindex("\x1b[H") :]
