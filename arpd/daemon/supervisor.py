"""The supervisor loop: ticks the daemon, follows signals and reloads, and reports to systemd."""

from __future__ import annotations

import logging
import signal
import threading
import time
from concurrent.futures import Future
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from arpd.adapters.systemd.notify import Notifier, Watchdog
from arpd.daemon.tick import TICK_S, Daemon

if TYPE_CHECKING:
    from collections.abc import Callable

    from arpd.model.settings import Settings

log = logging.getLogger(__name__)

_LEAST_PAUSE_S = 0.02  # however many reports arrive


@dataclass(slots=True)
class Signals:
    """Signals only set flags; the loop reads them.

    However often the same one comes, it is one flag: ten SIGHUPs are one reload of the last file, and a second SIGTERM
    does not cut a restore short, which ends by itself. Before there is a loop nothing has been changed yet, and
    importing ROS takes a Raspberry Pi longer than systemd waits: a stop then ends the process at once.

    Parameters
    ----------
    is_looping : whether somebody reads the flags
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
        self.stop = True  # no Event.set() here: it could meet the lock that wait() holds
        if not self.is_looping:
            raise SystemExit(0)

    def _on_reload(self, _signum: int, _frame: Any) -> None:
        self.reload = True


def _reading(load: Callable[[], Settings]) -> Future[Settings]:
    """Read the configuration in a thread: a wrong file of a megabyte takes longer than ticks may wait.

    No executor's thread, because the process must be able to end before it does.
    """
    future: Future[Settings] = Future()

    def read() -> None:
        try:
            future.set_result(load())
        except Exception as error:  # noqa: BLE001 - raised by the future's result
            future.set_exception(error)

    threading.Thread(target=read, name="arpd-config", daemon=True).start()
    return future


class Supervisor:
    """Ticks a daemon until told to stop, reloads it when asked to, and tells systemd how it is.

    Only a finished tick feeds the watchdog. One that raises leaves the plan in force; when all of them raise, whatever
    the reason, publishers open their gate after five seconds, and systemd starts the daemon anew after ten.

    Parameters
    ----------
    load : reads and checks the configuration
    fault : says what is wrong around the daemon, empty when nothing is
    is_cut_off : whether a new process would reach somebody whom this one does not
    resting : set while no tick runs, so that others may know when they are in nobody's way
    tidy : called after every tick, for what had better not begin in the middle of one
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
        tidy: Callable[[], None] = lambda: None,
    ) -> None:
        self._daemon = daemon
        self._signals = signals
        self._notifier = notifier
        self._load = load
        self._fault = fault
        self._is_cut_off = is_cut_off
        self._resting = resting or threading.Event()
        self._resting.set()
        self._tidy = tidy
        self._heartbeat = Watchdog(notifier)
        self._reading: Future[Settings] | None = None
        self._is_ready = False
        self._status = ""
        self._failure = ""

    def run(self) -> None:
        """Tick when a report wakes the loop or a period has passed, whichever comes first."""
        next_s = time.monotonic()
        while not self._signals.stop and not self._is_cut_off():
            self._follow_reloads()
            now_s = time.monotonic()
            late_s = max(0.0, now_s - next_s)
            self._daemon.record.note_lateness(late_s, is_late=late_s > TICK_S / 2)
            self._resting.clear()
            try:
                self._daemon.tick(now_s)
            except Exception as error:  # noqa: BLE001 - logged there, though not ten times a second
                self._note_failure(error)
            else:
                self._note_success()
            self._tidy()
            self._resting.set()
            next_s = now_s + TICK_S
            time.sleep(_LEAST_PAUSE_S)
            self._signals.wakeup.wait(max(0.0, next_s - time.monotonic()))
            self._signals.wakeup.clear()

    def _follow_reloads(self) -> None:
        """Begin or finish a reload; one that is asked for while a file is read follows, so that the last file wins."""
        if self._reading is not None and self._reading.done():
            try:
                self._daemon.reload(self._reading.result)
            except Exception as error:
                log.exception("reload failed; the configuration in force stays")
                self._daemon.configuration.note_failed_reload(f"{type(error).__name__}: {error}")
            self._reading = None
            if self._is_ready:  # else READY=1 would end the start before a tick has finished
                self._notifier.ready()
        if self._signals.reload and self._reading is None:
            self._signals.reload = False
            if self._is_ready:
                self._notifier.reloading()
            self._reading = _reading(self._load)

    def _note_failure(self, error: Exception) -> None:
        self._daemon.record.note_failed_tick()
        if (failure := type(error).__name__) != self._failure:
            self._failure = failure
            log.error("a tick failed; the publishers keep the plan they have", exc_info=error)
            self._say(f"ticks fail ({failure}: {error}); the publishers keep the plan they have")

    def _note_success(self) -> None:
        if self._failure:
            log.info("ticks finish again")
            self._failure = ""
        if not self._is_ready:
            self._is_ready = True
            self._notifier.ready()  # only now: whoever waited for the start finds a daemon that has seen its world
        self._heartbeat.beat()
        self._say("; ".join(said for said in (self._daemon.status_line(), self._fault()) if said))

    def _say(self, status: str) -> None:
        if status != self._status:
            self._status = status
            self._notifier.status(status)
