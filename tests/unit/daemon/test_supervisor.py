"""The loop around the daemon: signals, reloads, failing ticks, and the messages to systemd."""

from __future__ import annotations

import logging
import os
import signal
import threading
import time
from typing import Any

import pytest

from arpd.daemon.run import stop
from arpd.daemon.supervisor import Signals, Supervisor
from arpd.daemon.tick import TICK_S
from arpd.model.settings import OnStop, Settings

NUMBERS = (signal.SIGTERM, signal.SIGINT, signal.SIGHUP)


@pytest.fixture
def signals():
    """Install the handlers for a test; they run in this process."""
    before = [signal.getsignal(number) for number in NUMBERS]
    signals = Signals(is_looping=True)
    signals.install()
    yield signals
    for number, handler in zip(NUMBERS, before, strict=True):
        signal.signal(number, handler)


class Notifier:
    """A notifier that keeps its messages, in order."""

    watchdog_period_s = 10.0

    def __init__(self):
        self.messages = []

    def ready(self):
        self.messages.append("READY")

    def reloading(self):
        self.messages.append("RELOADING")

    def watchdog(self):
        self.messages.append("WATCHDOG")

    def status(self, text):
        self.messages.append(text)

    def count(self, message):
        return self.messages.count(message)


class Daemon:
    """Calls one of the test's functions at each tick, and ends after the last."""

    def __init__(self, signals, *ticks):
        self._signals = signals
        self._ticks = iter(ticks)
        self.then = iter(())
        self.settings = Settings()
        self.loaded = []
        self.refused = []
        self.failed = 0
        self.ticked = 0
        self.late_s = []
        self.record = self.configuration = self
        self.pause_s = TICK_S

    @property
    def turns(self):
        return self.ticked

    def tick(self, _now_s):
        self._signals.wakeup.set()  # the next one at once
        action = next(self._ticks, None) or next(self.then, None)
        if action is None:
            self._signals.stop = True
            return
        action()
        self.ticked += 1

    def reload(self, load):
        self.loaded.append(load())

    def note_failed_reload(self, why):
        self.refused.append(why)

    def note_failed_tick(self):
        self.failed += 1

    def note_lateness(self, late_s, *, is_late):
        self.late_s.append(late_s)

    def status_line(self):
        return "fine"


def nothing():
    pass


def fail():
    raise ValueError("a bug")


def send(number, times=1):
    for _ in range(times):
        os.kill(os.getpid(), number)


def run(daemon, signals, load=Settings, **options):
    notifier: Any = Notifier()
    Supervisor(daemon, signals, notifier, load=load, **options).run()
    return notifier


# -- ticks


def test_others_know_when_no_tick_runs(signals):
    """`resting` is set between two ticks, also after one that failed, and never within one."""
    resting, seen = threading.Event(), []

    def look():
        seen.append(resting.is_set())

    def look_and_fail():
        look()
        fail()

    daemon = Daemon(signals, look, look_and_fail, look)
    run(daemon, signals, resting=resting)
    assert seen == [False] * 3
    assert resting.is_set()


def test_how_late_each_tick_begins_is_told(signals):
    """A tick that follows one of twice the period is at least a period late; an early one is not late."""
    daemon = Daemon(signals, lambda: time.sleep(2 * TICK_S), nothing, nothing)
    run(daemon, signals)
    assert len(daemon.late_s) == 4  # the last ends the loop
    assert daemon.late_s[1] >= TICK_S
    assert min(daemon.late_s) >= 0.0


# -- reload


def test_ten_reloads_in_a_second_are_few_and_the_last_file_wins(signals):
    """Signals during a reload lead to one more reload, of the file as it is by then."""
    file = ["first"]
    reading, go_on = threading.Event(), threading.Event()

    def load():
        found = file[0]
        reading.set()
        assert go_on.wait(10.0)
        return found

    def change():
        assert reading.wait(10.0)
        file[0] = "last"
        send(signal.SIGHUP, 9)
        go_on.set()

    daemon = Daemon(signals, nothing, lambda: send(signal.SIGHUP), nothing, change)
    daemon.then = until(lambda: len(daemon.loaded) == 2)
    notifier = run(daemon, signals, load)
    assert daemon.loaded == ["first", "last"]
    assert [message for message in notifier.messages if message in {"READY", "RELOADING"}] == [
        "READY",
        *2 * ("RELOADING", "READY"),
    ]


def until(condition, timeout_s=10.0):
    """Continue the ticks until a condition holds."""
    until_s = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < until_s, "did not happen in time"
        yield nothing


def test_a_file_that_takes_long_to_read_does_not_stop_the_ticks(signals):
    """Ticks go on during the reading, and the file is in force afterwards."""
    go_on = threading.Event()

    def load():
        assert go_on.wait(10.0)
        return "slow"

    daemon = Daemon(signals, lambda: send(signal.SIGHUP), *5 * [nothing], go_on.set)
    daemon.then = until(lambda: daemon.loaded)
    run(daemon, signals, load)
    assert daemon.loaded == ["slow"]
    assert daemon.ticked >= 7


def test_whatever_a_reload_raises_is_refused_and_answered(signals, caplog):
    """A bug in reading or taking a configuration ends the reload, not the daemon."""
    daemon = Daemon(signals, nothing, lambda: send(signal.SIGHUP))
    daemon.then = until(lambda: daemon.refused)
    notifier = run(daemon, signals, fail)
    assert daemon.refused == ["ValueError: a bug"]
    assert [message for message in notifier.messages if message in {"READY", "RELOADING"}] == [
        "READY",
        "RELOADING",
        "READY",
    ]
    assert "reload failed; the configuration in force stays" in caplog.text


def test_a_reload_does_not_end_the_start(signals):
    """READY is sent once a tick has finished; a reload before that is not announced."""
    daemon = Daemon(signals, *3 * [fail])
    daemon.then = until(lambda: daemon.loaded)
    send(signal.SIGHUP)
    notifier = run(daemon, signals, lambda: "file")
    before = notifier.messages.index("READY")
    assert "RELOADING" not in notifier.messages[:before]
    assert daemon.failed == 3


# -- ticks that fail


def test_only_finished_ticks_feed_the_watchdog(signals, caplog):
    """Failing ticks do not feed the watchdog; systemd and the log have the reason once, and the recovery."""
    messages_while_failing: list[str] = []
    notifier: Any = Notifier()
    daemon: Any = Daemon(signals, *20 * [fail], lambda: messages_while_failing.extend(notifier.messages), nothing)
    Supervisor(daemon, signals, notifier, load=Settings).run()
    assert messages_while_failing == ["ticks fail (ValueError: a bug); the publishers keep their plan"]
    assert daemon.failed == 20
    assert notifier.messages[1:] == ["READY", "WATCHDOG", "fine"]
    assert [record.levelno for record in caplog.records] == [logging.ERROR]
    assert caplog.records[0].exc_info is not None


# -- stop


def test_a_stop_before_there_is_a_loop_ends_the_process(signals):
    """Nothing has changed yet, and importing ROS would take longer than systemd waits."""
    signals.is_looping = False
    with pytest.raises(SystemExit) as ended:
        send(signal.SIGTERM)
    assert ended.value.code == 0


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_stop_ends_the_loop_after_the_tick_even_if_a_reload_waits(signals, number):
    """A reload that is requested together with a stop does not begin."""
    daemon = Daemon(signals, lambda: (send(signal.SIGHUP), send(number)), nothing)
    notifier = run(daemon, signals)
    assert (daemon.ticked, daemon.loaded, notifier.count("RELOADING")) == (1, [], 0)


@pytest.mark.parametrize("times", [1, 2, 5])
def test_more_of_the_same_signal_does_not_cut_a_restore_short(signals, caplog, times):
    """Publishers get their QoS back, and the restore ends by itself."""
    restored = []

    class Restoring(Daemon):
        def restore(self, *, wait):
            for _ in range(times):
                send(signal.SIGTERM)
                wait(0.01)
            restored.append(True)
            return 0

    caplog.set_level("INFO")
    daemon: Any = Restoring(signals)
    stop(daemon)
    assert restored == [True]
    assert "every publisher has its original QoS back" in caplog.text


def test_a_restore_that_fails_still_is_a_clean_end(signals, caplog):
    """The log says that publishers may keep their plan."""

    class Restoring(Daemon):
        def restore(self, *, wait):
            fail()

    daemon: Any = Restoring(signals)
    stop(daemon)
    assert "publishers may keep their plan" in caplog.text


def test_a_daemon_told_to_keep_restores_nothing(signals):
    """`on_stop: keep` leaves the plan in force."""
    daemon: Any = Daemon(signals)
    daemon.settings = Settings(on_stop=OnStop.KEEP)
    stop(daemon)  # it has no restore()


# -- faults outside the daemon


def test_what_is_wrong_around_the_daemon_shows_in_its_status(signals):
    """`systemctl status` shows that there are no metrics."""
    notifier = run(Daemon(signals, nothing), signals, fault=lambda: "no metrics: port taken")
    assert "fine; no metrics: port taken" in notifier.messages


def test_the_loop_ends_when_a_new_process_would_reach_more(signals):
    """The loop ends without a signal."""
    cut_off = iter([False, False, True])
    daemon = Daemon(signals, *9 * [nothing])
    run(daemon, signals, is_cut_off=lambda: next(cut_off))
    assert (daemon.ticked, signals.stop) == (2, False)


def test_a_thread_that_hangs_starves_the_watchdog(signals):
    """Finished ticks feed it only while every watched thread finishes its rounds."""
    for finished_s, fed in ((time.monotonic, 1), (lambda: time.monotonic() - 60.0, 0)):
        signals.stop = False
        notifier: Any = Notifier()
        fake: Any = Daemon(signals, nothing)
        supervisor = Supervisor(fake, signals, notifier, load=Settings)
        supervisor.watch(finished_s)
        supervisor.run()
        assert notifier.count("WATCHDOG") == fed
