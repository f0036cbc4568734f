"""The supervisor loop: ticks the daemon, follows signals and reloads, and reports to systemd."""

from __future__ import annotations

import logging
import signal
import threading
import time
from concurrent.futures import Future
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, TypeVar

from arpd.host.notify import Notifier, Watchdog
from arpd.report.situation import status_line
from arpd.ros.rate_limits import OncePerMinute

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from arpd.daemon.tick import Daemon
    from arpd.model.settings import Settings

log = logging.getLogger(__name__)
T = TypeVar("T")

LEAST_PAUSE_S = 0.02  # between two ticks, also when many reports arrive


@dataclass(slots=True)
class Signals:
    """Signals only set flags; the loop reads them.

    A repeated signal sets the same flag: ten SIGHUPs are one reload of the last file, and a second SIGTERM does not cut
    a restore short. Before the loop runs, a stop ends the process at once: nothing has changed yet, and importing ROS
    on a Raspberry Pi takes longer than systemd waits.

    Parameters
    ----------
    is_looping : whether the loop reads the flags
    """

    stop: bool = False
    reload: bool = False
    is_looping: bool = False
    wakeup: threading.Event = field(default_factory=threading.Event)

    def install(self) -> None:
        """Handle SIGTERM and SIGINT (stop) and SIGHUP (reload)."""
        signal.signal(signal.SIGTERM, self._on_stop)
        signal.signal(signal.SIGINT, self._on_stop)
        signal.signal(signal.SIGHUP, self._on_reload)

    def _on_stop(self, _signum: int, _frame: Any) -> None:
        self.stop = True  # no Event.set() here: wait() may hold its lock
        if not self.is_looping:
            raise SystemExit(0)

    def _on_reload(self, _signum: int, _frame: Any) -> None:
        self.reload = True


def in_thread(work: Callable[[], T], name: str) -> Future[T]:
    """Do what takes longer than a tick may wait, such as to read a faulty configuration of a megabyte.

    In a daemon thread and no executor's, so that the process can end before the thread does.
    """
    future: Future[T] = Future()

    def do() -> None:
        try:
            future.set_result(work())
        except Exception as error:  # noqa: BLE001 - raised by the future's result
            future.set_exception(error)

    threading.Thread(target=do, name=name, daemon=True).start()
    return future


class Supervisor:
    """Ticks a daemon until a signal stops it, reloads its configuration, and reports to systemd.

    Only a finished tick feeds the watchdog, while the thread that hears messages finishes its turns. A tick that raises
    leaves the plan in force. When every tick raises, publishers keep the last price, and systemd restarts the daemon
    after ten seconds.

    Parameters
    ----------
    load : reads and checks the configuration
    fault : describes a fault outside the daemon, empty when there is none
    is_cut_off : whether a new process would reach hosts that this one does not
    resting : set while no tick runs, so that other threads can avoid delaying one
    after_tick : called after every tick, also one that failed
    parts : as in `Watchdog`
    """

    def __init__(
        self,
        daemon: Daemon,
        signals: Signals,
        notifier: Notifier,
        *,
        load: Callable[[], Settings],
        fault: Callable[[], str] = lambda: "",
        is_cut_off: Callable[[], bool] = lambda: False,
        resting: threading.Event | None = None,
        after_tick: Sequence[Callable[[], None]] = (),
        parts: Sequence[Callable[[], float]] = (),
    ) -> None:
        self._daemon = daemon
        self._signals = signals
        self._notifier = notifier
        self._load = load
        self._fault = fault
        self._is_cut_off = is_cut_off
        self._resting = resting or threading.Event()
        self._resting.set()
        self._after_tick = after_tick
        self._heartbeat = Watchdog(notifier, parts=parts)
        self._reading: Future[Settings] | None = None
        self._is_ready = False
        self._logged = OncePerMinute()
        self._is_failing = False  # as the log says
        self._said_counted = 0  # as in `Record`, when the status was last made

    def run(self) -> None:
        """Tick when a report wakes the loop or a period has passed."""
        next_s = time.monotonic()
        while not self._signals.stop and not self._is_cut_off():
            self._follow_reloads()
            now_s = time.monotonic()
            late_s = max(0.0, now_s - next_s)
            self._daemon.record.note_lateness(late_s)
            self._resting.clear()
            try:
                self._daemon.tick(now_s)
            except Exception as error:  # noqa: BLE001 - _note_failure logs it, but not ten times a second
                self._note_failure(error)
            else:
                self._note_success()
            for call in self._after_tick:
                call()
            self._resting.set()
            next_s = now_s + self._daemon.pause_s
            self._signals.wakeup.wait(max(0.0, next_s - time.monotonic()))
            self._signals.wakeup.clear()
            if (early_s := now_s + LEAST_PAUSE_S - time.monotonic()) > 0.0:
                time.sleep(early_s)

    def _follow_reloads(self) -> None:
        """Begin or finish a reload; a request during a reload begins another one, so the last file wins."""
        if self._reading is not None and self._reading.done():
            try:
                self._daemon.reload(self._reading.result)
            except Exception as error:
                log.exception("reload failed; the configuration in force stays")
                self._daemon.configuration.error = f"{type(error).__name__}: {error}"
            self._reading = None
            if self._is_ready:  # READY=1 must not come before the first finished tick
                self._notifier.ready()
        if self._signals.reload and self._reading is None:
            self._signals.reload = False
            if self._is_ready:
                self._notifier.reloading()
            self._reading = in_thread(self._load, "arpd-config")

    def _note_failure(self, error: Exception) -> None:
        self._daemon.record.note_failed_tick()
        failure = type(error).__name__
        if self._logged.take(failure, time.monotonic()):
            self._is_failing = True
            log.error("a tick failed; the publishers keep their plan (logged once a minute)", exc_info=error)
        self._said_counted = -1
        self._notifier.status(f"ticks fail ({failure}: {error}); the publishers keep their plan")

    def _note_success(self) -> None:
        if self._is_failing:
            log.info("ticks succeed again")
            self._is_failing = False
        if not self._is_ready:
            self._is_ready = True
            self._notifier.ready()  # units that wait for the start find a daemon that has observed its world
        self._heartbeat.beat()
        if (counted := self._daemon.record.counted) != self._said_counted:
            self._said_counted = counted
            self._notifier.status(
                "; ".join(part for part in (status_line(self._daemon.snapshot), self._fault()) if part)
            )
