"""The loop around the daemon: signals, reloads, failing ticks, and the messages to systemd."""

from __future__ import annotations

import itertools
import logging
import os
import signal
import threading
from contextlib import contextmanager
from typing import Any

import pytest

from arpd.daemon.run import stop
from arpd.daemon.supervisor import Signals, Supervisor
from arpd.host import notify
from arpd.model.settings import OnStop, Settings
from tests.waiting import PATIENCE_S, eventually

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


class Notifier(notify.Notifier):
    """A notifier that keeps its messages, in order."""

    def __init__(self):
        super().__init__({})
        self.messages = []
        self.count = self.messages.count

    def _send(self, message):
        self.messages.append(message.partition("\n")[0].removeprefix("STATUS=").removesuffix("=1"))


class Daemon:
    """Calls one of the test's functions at each tick, and ends after the last."""

    def __init__(self, signals, *ticks):
        self._signals = signals
        self._ticks = iter(ticks)
        self.then = iter(())
        self.settings = Settings()
        self.loaded = []
        self.error, self.snapshot = "", None
        self.failed = 0
        self.ticked = 0
        self.record = self.configuration = self
        self.pause_s = 0.1

    @property
    def counted(self):
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

    def note_failed_tick(self):
        self.failed += 1

    def note_lateness(self, late_s):
        pass


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


@contextmanager
def running(daemon, signals, load):
    """Let a daemon tick beside the test, which sends it signals; gives the notifier."""
    daemon.then = itertools.repeat(nothing)
    notifier: Any = Notifier()
    thread = threading.Thread(target=Supervisor(daemon, signals, notifier, load=load).run)
    thread.start()
    try:
        eventually("the daemon is ready", lambda: "READY" in notifier.messages)
        yield notifier
    finally:
        signals.stop = True
        thread.join()


def protocol(notifier):
    return [message for message in notifier.messages if message in {"READY", "RELOADING"}]


# -- reload


def test_ten_reloads_in_a_second_are_few_and_the_last_file_wins(signals):
    """Signals during a reload lead to one more reload, of the file as it is by then; ticks go on meanwhile."""
    file = ["first"]
    reading, go_on = threading.Event(), threading.Event()

    def load():
        found = file[0]
        reading.set()
        assert go_on.wait(PATIENCE_S)
        return found

    daemon = Daemon(signals)
    with running(daemon, signals, load) as notifier:
        send(signal.SIGHUP)
        eventually("the file is being read", reading.is_set)
        file[0] = "last"
        send(signal.SIGHUP, 9)
        ticked = daemon.ticked
        eventually("ticks go on during the reading", lambda: daemon.ticked > ticked + 5)
        go_on.set()
        eventually("both reloads are answered", lambda: protocol(notifier) == ["READY", *2 * ("RELOADING", "READY")])
    assert daemon.loaded == ["first", "last"]


def test_whatever_a_reload_raises_is_refused_and_answered(signals, caplog):
    """A bug in reading or taking a configuration ends the reload, not the daemon."""
    daemon = Daemon(signals)
    with running(daemon, signals, fail) as notifier:
        send(signal.SIGHUP)
        eventually("the reload is answered", lambda: protocol(notifier) == ["READY", "RELOADING", "READY"])
    assert daemon.error == "ValueError: a bug"
    assert "the configuration in force stays" in caplog.text


# -- ticks that fail


def test_only_finished_ticks_feed_the_watchdog(signals, caplog):
    """Failing ticks do not feed the watchdog; systemd has the reason once, the recovery, and what is wrong outside."""
    messages_while_failing: list[str] = []
    notifier: Any = Notifier()
    daemon: Any = Daemon(signals, *20 * [fail], lambda: messages_while_failing.extend(notifier.messages), nothing)
    Supervisor(daemon, signals, notifier, load=Settings, fault=lambda: "no metrics: port taken").run()
    assert messages_while_failing == ["ticks fail (ValueError: a bug); the publishers keep their plan"]
    assert daemon.failed == 20
    assert notifier.messages[1:] == ["READY", "WATCHDOG", "starting; no metrics: port taken"]
    assert [record.levelno for record in caplog.records] == [logging.ERROR]
    assert caplog.records[0].exc_info is not None


def test_a_fault_of_every_other_tick_does_not_fill_the_journal(signals, caplog):
    """A fault that comes and goes is logged once a minute, with its end."""
    caplog.set_level("INFO")
    daemon: Any = Daemon(signals, *20 * [fail, nothing])
    run(daemon, signals)
    assert daemon.failed == 20
    assert [record.levelno for record in caplog.records] == [logging.ERROR, logging.INFO]


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


def test_more_of_the_same_signal_does_not_cut_a_restore_short(signals, caplog):
    """Publishers get their QoS back, and the restore ends by itself."""
    restored = []

    class Restoring(Daemon):
        def restore(self, *, wait):
            for _ in range(5):
                send(signal.SIGTERM)
                wait(0.01)
            restored.append(True)
            return 0

    caplog.set_level("INFO")
    daemon: Any = Restoring(signals)
    stop(daemon)
    assert restored == [True]
    assert "every publisher has its original QoS back" in caplog.text


def test_a_daemon_told_to_keep_restores_nothing(signals):
    """`on_stop: keep` leaves the plan in force."""
    daemon: Any = Daemon(signals)
    daemon.settings = Settings(on_stop=OnStop.KEEP)
    stop(daemon)  # it has no restore()


def test_the_loop_ends_when_a_new_process_would_reach_more(signals):
    """The loop ends without a signal."""
    cut_off = iter([False, False, True])
    daemon = Daemon(signals, *9 * [nothing])
    run(daemon, signals, is_cut_off=lambda: next(cut_off))
    assert (daemon.ticked, signals.stop) == (2, False)
