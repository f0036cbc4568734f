"""`arpd top`: the terminal that it draws on."""

from __future__ import annotations

import contextlib
import copy
import fcntl
import json
import os
import pty
import re
import select
import signal
import struct
import subprocess
import sys
import termios
import time

import pytest

from arpd.cli import main as cli
from tests.unit.fake_daemon import HISTORY, busy, serving

ENTER, LEAVE = "\x1b[?1049h", "\x1b[?1049l"


@pytest.fixture
def daemon():
    """Serve a document that a test may change, and a history."""
    answers = {"status": busy()}
    with serving(lambda: json.dumps(answers["status"]), history=json.dumps(HISTORY)) as url:
        yield url, answers


def test_once_prints_what_status_prints(capsys, daemon):
    """The option is the other command, with its exit codes."""
    shown = []
    for command in (["status"], ["top", "--once"]):
        assert cli.main([*command, "--url", daemon[0]]) == 0
        shown.append(capsys.readouterr())
    assert shown[0] == shown[1]
    assert "▁█▁" in shown[0].out


@pytest.mark.parametrize(("variable", "is_coloured"), [("LANG", True), ("NO_COLOR", False)])
def test_status_has_colours_on_a_terminal_unless_told_otherwise(start, daemon, variable, is_coloured):
    """NO_COLOR is respected."""
    screen = start("status", "--url", daemon[0], environment={variable: "C.UTF-8"})
    written = screen.await_text("event 29")
    assert ("\x1b[31m/link/odom" in written) == is_coloured
    assert ENTER not in written
    assert max(len(re.sub(r"\x1b\[[0-9;]*m", "", line)) for line in written.split("\r\n")) <= 100


def test_top_exits_69_when_nothing_answers_at_the_start(top):
    """The error is that of status, and the terminal stays as it was."""
    with serving("{}") as url:
        pass
    screen = top(url)
    assert screen.process.wait(60) == 69
    assert ENTER not in screen.await_text("no daemon answers")


@pytest.mark.parametrize("interval", ["0", "nan", "1e9"])
def test_an_interval_out_of_range_exits_2(capsys, interval):
    """The error has the least and the highest value."""
    assert cli.main(["top", "--interval", interval]) == 2
    assert f"--interval {float(interval):g} is out of range; write 0.2 to 3600" in capsys.readouterr().err


@pytest.mark.parametrize(("is_terminal", "kind"), [(False, "xterm"), (True, "dumb")])
def test_live_needs_a_terminal_that_can_be_drawn_on(capsys, monkeypatch, is_terminal, kind):
    """For a pipe or a dumb terminal the error names the other command."""
    monkeypatch.setattr(sys.stdout, "isatty", lambda: is_terminal)
    monkeypatch.setenv("TERM", kind)
    assert cli.main(["top"]) == 2
    assert "top needs a terminal; arpd status" in capsys.readouterr().err


class Screen:
    """A terminal with ``arpd`` on it."""

    def __init__(self, *arguments, columns=100, lines=30, environment=None):
        self._master, slave = pty.openpty()
        self.resize(columns, lines)
        self.before = termios.tcgetattr(slave)
        self._slave = slave
        self.process = subprocess.Popen(
            [sys.executable, "-m", "arpd.cli", *arguments],
            stdin=slave,
            stdout=slave,
            stderr=slave,
            env={**os.environ, "TERM": "xterm-256color", **(environment or {})},
            start_new_session=True,
        )
        self.written = ""

    def resize(self, columns, lines):
        fcntl.ioctl(self._master, termios.TIOCSWINSZ, struct.pack("HHHH", lines, columns, 0, 0))

    def await_text(self, text, *, after=0, timeout_s=60.0):
        """Read until the text is written; returns what was written so far."""
        until_s = time.monotonic() + timeout_s
        while text not in self.written[after:]:
            assert time.monotonic() < until_s, f"{text!r} not in {self.written[after:]!r}"
            if select.select([self._master], [], [], 0.5)[0]:
                with contextlib.suppress(OSError):
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
def start():
    """Start ``arpd`` on a terminal."""
    screens = []

    def start(*arguments, **given):
        screens.append(Screen(*arguments, **given))
        return screens[-1]

    yield start
    for screen in screens:
        screen.close()


@pytest.fixture
def top(start):
    """Start ``arpd top`` on a terminal."""
    return lambda url, *options: start("top", "--url", url, *options)


@pytest.mark.parametrize("end", ["q", signal.SIGINT, signal.SIGTERM])
def test_top_gives_the_terminal_back(top, daemon, end):
    """A key or a signal ends it: the screen from before, the cursor, the keyboard, exit 0."""
    screen = top(daemon[0])
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


def test_top_follows_the_daemon_and_the_size_of_the_terminal(top, daemon):
    """It draws news and a new size by itself."""
    url, answers = daemon
    screen = top(url, "--interval", "0.2")
    screen.await_text("event 29")
    changed = copy.deepcopy(answers["status"])
    changed["verdict"]["text"] = "All is new"
    answers["status"] = changed
    screen.await_text("All is new")
    seen = len(screen.written)
    screen.resize(60, 20)
    screen.process.send_signal(signal.SIGWINCH)
    screen.await_text("… and ", after=seen)
    frames = screen.written[seen:].split("\x1b[H")[1:]
    last = [re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", line) for line in frames[0].split("\r\n")]
    assert max(map(len, last)) <= 60
    assert len(last) == 20


def test_top_waits_for_a_daemon_that_goes_away(top):
    """It says so, goes on, and shows the daemon that comes back."""
    answers = {"body": json.dumps(busy())}
    with serving(lambda: answers["body"], history=json.dumps(HISTORY)) as url:
        screen = top(url, "--interval", "0.2")
        screen.await_text("event 29")
        answers["body"] = "<html>"
        screen.await_text("no answer for ")
        assert screen.process.poll() is None
        again = busy()
        again["verdict"]["text"] = "Back again"
        answers["body"] = json.dumps(again)
        written = screen.await_text("Back again")
        assert "no answer" not in written[written.rindex("\x1b[H") :]
