"""`arpd top`: one frame at any size, and the terminal it is drawn on."""

from __future__ import annotations

import contextlib
import copy
import fcntl
import io
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
from hypothesis import given, settings
from hypothesis import strategies as st
from rich.console import Console

from arpd.cli import main as cli
from arpd.cli.frame import BLOCKS, View, frame, sparkline
from tests.unit.cli.test_status import HOSTILE, broken_documents
from tests.unit.fake_daemon import calm, demo_robot, document, event, serving

ENTER, LEAVE = "\x1b[?1049h", "\x1b[?1049l"
HISTORY = {
    "api_version": "v1",
    "link": {
        "capacity_bytes_per_second": [None] * 100 + [2.5e6] * 250 + [6e5] * 250,
        "queue_delay_seconds": [0.0] * 349 + [0.35] + [0.0] * 250,
    },
    "gate": [1.0] * 350 + [0.5] + [1.0] * 249,
}


def drawn(status, history=HISTORY, **view):
    """Draw a frame; returns its lines."""
    view = {"width": 110, "height": 40} | view
    written = io.StringIO()
    Console(width=view["width"], height=view["height"], file=written).print(frame(status, history, View(**view)))
    return written.getvalue().split("\n")[:-1]


def busy():
    """Return the demo's robot behind a slow link: the camera is slowed most, one topic refuses, three are late."""
    answered = calm(publishers=demo_robot())
    by_name = {topic["topic"]: topic for topic in answered["topics"]}
    for name, ratio in (("/link/camera/image/compressed", 0.08), ("/link/points", 0.4)):
        topic = by_name[name]
        topic |= {"binding": "link", "share": 0.3, "kept_ratio": ratio}
        topic["planned"] = {"rate_hz": topic["source_rate_hz"] * ratio, "depth": 10, "deadline_ns": None}
    by_name["/link/odom"] |= {"refusal": "depth 16: no match", "refusal_lasts": False}
    by_name["/link/imu"]["deadlines_missed"] = 3
    answered["verdict"] = {"severity": "warning", "text": "The link is the limit: so", "wrong": False}
    answered["events"] = [event(number, f"event {number}") for number in range(30)]
    return answered


def test_a_frame_answers_the_four_questions():
    """It has the verdict, the link's ten minutes, the plan and its reason, the topics, and the last decisions."""
    lines = drawn(busy(), url="http://robot:9464")
    text = "\n".join(lines)
    assert lines[0].startswith(" arpd 1.2.3 on wlan0, http://robot:9464")
    assert lines[1] == "The link is the limit: so"
    assert re.search(r"^link +5 Mbit/s  peer, congested +[▁▂▃▄▅▆▇█ ]{20,} ≤ 20 Mbit/s$", text, re.MULTILINE)
    assert re.search(r"^queue .*█.* ≤ 350 ms$", text, re.MULTILINE)
    assert re.search(r"^admitted .*▅.* ≥ 50 %$", text, re.MULTILINE)
    assert "plan     3 for 4.25 Mbit/s: 0 of 0 publishers confirmed" in lines
    assert "         held: dwell; refused up: dwell" in lines
    topics = [line.split()[0] for line in lines if line.startswith("/")]
    assert topics[:3] == ["/link/odom", "/link/camera/image/compressed", "/link/points"]
    assert len(topics) == 12
    assert lines[-1].endswith("event 29")


@pytest.mark.parametrize("width", [60, 80, 132, 250])
@pytest.mark.parametrize("height", [10, 24, 60])
def test_a_frame_fits_its_terminal(width, height):
    """No line is too many or too long, and the verdict is always there."""
    lines = drawn(busy(), width=width, height=height)
    assert len(lines) <= height
    assert max(map(len, lines)) <= width
    assert "The link is the limit" in lines[1]


def test_topics_that_do_not_fit_are_summed_up():
    """The last line has their number, and the number of those that the link slows."""
    lines = drawn(busy(), width=80, height=18)
    shown = [line for line in lines if line.startswith(("/", "…")) and "more" not in line]
    assert f"… and {12 - len(shown)} more" in "\n".join(lines)
    everything = calm(publishers=demo_robot() * 1)
    for topic in everything["topics"]:
        topic["kept_ratio"] = 0.01
    assert "of them slowed" in "\n".join(drawn(everything, width=80, height=18))


def test_a_daemon_without_history_has_no_sparklines():
    """An older daemon without history has numbers only."""
    text = "\n".join(drawn(busy(), None))
    assert not set(BLOCKS) & set(text)
    assert "queue    120 ms" in text


def test_a_silent_daemon_is_said_to_be_silent():
    """The frame says for how long, and from when its contents are."""
    lines = drawn(busy(), why_silent="no daemon answers", silent_s=12.4)
    at = time.strftime("%H:%M:%S", time.localtime(1e9))
    assert lines[1] == f"no answer for 12 s, this is from {at}: no daemon answers"


def test_a_daemon_before_its_first_tick_has_a_frame():
    """The frame says that it is not ready."""
    assert "Not ready" in drawn({"api_version": "v1", "ready": False})[1]


def test_a_terminal_with_ascii_only_gets_nothing_else():
    """Sparklines, ellipses and arrows have a plain form."""
    assert "".join(drawn(busy(), width=60, is_ascii=True)).isascii()


@settings(max_examples=40)
@given(broken_documents(), st.sampled_from([None, HISTORY, {"link": 3}, {"gate": [HOSTILE[0], None, 1e999]}]))
def test_whatever_answers_neither_breaks_a_frame_nor_steers_the_terminal(answered, history):
    """Keys that are missing or hold something else leave a gap; control characters are shown, not sent."""
    lines = drawn(answered, history, width=70, height=20, url=HOSTILE[0], why_silent=HOSTILE[1])
    assert len(lines) <= 20
    assert all(character.isprintable() for line in lines for character in line)


@pytest.mark.parametrize(
    ("samples", "columns", "shown"),
    [
        ([0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0], 8, "▁▂▃▄▅▆▇█"),
        ([1.0, 9.0, 1.0, 1.0], 2, "█▁"),
        ([None, None, 4.0, 8.0], 2, " █"),
        ([2.0], 40, "█"),
        ([0.0, 0.0], 2, "▁▁"),
        ([None], 3, " "),
        ([], 5, ""),
    ],
)
def test_a_sparkline_keeps_the_worst_of_what_shares_a_column(samples, columns, shown):
    """A queue of one second in ten minutes is visible."""
    assert sparkline(samples, columns, pick=max) == shown


# -- the command


@pytest.fixture
def daemon():
    """Serve a document that a test may change, and a history."""
    answers = {"status": busy()}
    with serving(lambda: json.dumps(answers["status"]), history=json.dumps(HISTORY)) as url:
        yield url, answers


def test_once_prints_a_frame_into_a_pipe(daemon):
    """The frame has all topics and no control codes."""
    environment = {name: value for name, value in os.environ.items() if name not in {"COLUMNS", "LINES", "FORCE_COLOR"}}
    done = subprocess.run(
        [sys.executable, "-m", "arpd.cli", "top", "--once", "--url", daemon[0]],
        capture_output=True,
        text=True,
        check=False,
        env={**environment, "TERM": "xterm"},
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert "\x1b" not in done.stdout
    assert done.stdout.count("\n/") == 12


def test_a_daemon_that_keeps_no_history_is_watched_too(capsys):
    """It answers 404 to what it does not know."""
    with serving(json.dumps(document())) as url:
        assert cli.main(["top", "--once", "--url", url]) == 0
    assert "queue    120 ms" in capsys.readouterr().out


def test_top_exits_69_when_nothing_answers_at_the_start(capsys, top):
    """The error is that of status, and the terminal stays as it was."""
    with serving("{}") as url:
        pass
    screen = top(url)
    assert screen.process.wait(60) == 69
    assert ENTER not in screen.await_text("no daemon answers")
    assert cli.main(["top", "--once", "--url", url]) == 69
    assert capsys.readouterr().err.startswith(f"arpd: no daemon answers at {url} (")


@pytest.mark.parametrize("interval", ["0", "nan", "1e9"])
def test_an_interval_out_of_range_exits_2(capsys, interval):
    """The error has the least and the highest value."""
    assert cli.main(["top", "--interval", interval]) == 2
    assert f"--interval {float(interval):g} is out of range; write 0.2 to 3600" in capsys.readouterr().err


@pytest.mark.parametrize(("is_terminal", "kind"), [(False, "xterm"), (True, "dumb")])
def test_live_needs_a_terminal_that_can_be_drawn_on(capsys, monkeypatch, is_terminal, kind):
    """For a pipe or a dumb terminal the error names --once."""
    monkeypatch.setattr(sys.stdout, "isatty", lambda: is_terminal)
    monkeypatch.setenv("TERM", kind)
    assert cli.main(["top"]) == 2
    assert "top needs a terminal; --once" in capsys.readouterr().err


class Screen:
    """A terminal with ``arpd`` on it."""

    def __init__(self, *arguments, columns=100, lines=30):
        self._master, slave = pty.openpty()
        self.resize(columns, lines)
        self.before = termios.tcgetattr(slave)
        self._slave = slave
        self.process = subprocess.Popen(
            [sys.executable, "-m", "arpd.cli", *arguments],
            stdin=slave,
            stdout=slave,
            stderr=slave,
            env={**os.environ, "TERM": "xterm-256color"},
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
def top():
    """Start ``arpd top`` on a terminal."""
    screens = []

    def top(url, *options):
        screens.append(Screen("top", "--url", url, *options))
        return screens[-1]

    yield top
    for screen in screens:
        screen.close()


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
