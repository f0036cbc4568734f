"""`arpd run`: the supervisor loop, which ticks the daemon, and what stands around it."""

from __future__ import annotations

import logging
import signal
import threading
import time
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from arpd.config import load_settings
from arpd.daemon import TICK_S, Daemon
from arpd.host.counters import choose_interface, list_interfaces
from arpd.logs import configure_logging
from arpd.settings import OnStop
from arpd.systemd import Notifier
from arpd.version import VERSION

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from arpd.settings import Settings

log = logging.getLogger(__name__)

_LEAST_PAUSE_S = 0.02  # however many reports arrive


@dataclass(slots=True)
class Signals:
    """Signals only set flags; the loop reads them."""

    stop: bool = False
    reload: bool = False
    wakeup: threading.Event = field(default_factory=threading.Event)

    def install(self) -> None:
        """Handle SIGTERM and SIGINT (stop) and SIGHUP (reload)."""
        signal.signal(signal.SIGTERM, self._on_stop)
        signal.signal(signal.SIGINT, self._on_stop)
        signal.signal(signal.SIGHUP, self._on_reload)

    def _on_stop(self, _signum: int, _frame: Any) -> None:
        self.stop = True  # and nothing else: Event.set() here could meet the lock that wait() holds

    def _on_reload(self, _signum: int, _frame: Any) -> None:
        self.reload = True


def supervise(daemon: Daemon, signals: Signals, notifier: Notifier, *, load: Callable[[], Settings]) -> None:
    """Tick until told to stop, when a report wakes the loop or a period has passed, whichever comes first.

    A tick that raises is logged, counted and not repeated in haste.
    """
    next_s = time.monotonic()
    status = ""
    is_ready = False
    while not signals.stop:
        if signals.reload:
            signals.reload = False
            notifier.reloading()
            daemon.reload(load)
            notifier.ready()
        now_s = time.monotonic()
        if now_s - next_s > TICK_S / 2:
            daemon.note_late_tick()
        try:
            daemon.tick(now_s)
        except Exception:
            log.exception("a tick failed; the publishers keep the plan they have")
            daemon.note_failed_tick()
        else:
            if not is_ready:
                is_ready = True
                notifier.ready()  # only now: whoever waited for the start finds a daemon that has seen its world
            notifier.watchdog()
            if (line := daemon.status_line()) != status:
                status = line
                notifier.status(line)
        next_s = now_s + TICK_S
        time.sleep(_LEAST_PAUSE_S)
        signals.wakeup.wait(max(0.0, next_s - time.monotonic()))
        signals.wakeup.clear()


def run_daemon(*, config_path: Path, log_level: str) -> int:
    """Run the daemon until SIGTERM or SIGINT.

    Parameters
    ----------
    config_path : YAML configuration
    log_level : name of a logging level

    Raises
    ------
    ArpdError
        If the configuration, the interface, the HTTP address or ROS cannot be used.
    """
    configure_logging(log_level)

    def load() -> Settings:
        return load_settings(config_path, interfaces=list_interfaces)

    settings = load()
    interface = choose_interface(settings.link.interface)
    signals = Signals()
    signals.install()
    notifier = Notifier()
    from arpd.ros.runtime import control_node, spinning  # noqa: PLC0415 - the config is checked before ROS is needed

    with control_node("arpd") as node:
        from rclpy.executors import MultiThreadedExecutor  # noqa: PLC0415

        from arpd.ros.control import RosControl  # noqa: PLC0415
        from arpd.web.service import serving  # noqa: PLC0415

        world = RosControl(node, interface=interface, graph=settings.graph, on_report=signals.wakeup.set)
        daemon = Daemon(world, settings, interface=interface, config_path=str(config_path))
        executor = MultiThreadedExecutor(num_threads=2)
        executor.add_node(node)
        with serving(settings.http, lambda: daemon.snapshot) as url, spinning(executor):
            log.info("arpd %s on %s, metrics at %s/metrics", VERSION, interface, url)
            supervise(daemon, signals, notifier, load=load)
            notifier.stopping()
            _stop(daemon)
    return 0


def _stop(daemon: Daemon) -> None:
    if daemon.settings.on_stop is not OnStop.RESTORE:
        log.info("stopping; the publishers keep their plan (on_stop: keep)")
        return
    missing = daemon.restore(wait=time.sleep)
    if missing:
        log.warning("stopping; %d publishers or readers did not confirm their original QoS in time", missing)
    else:
        log.info("stopping; every publisher has its original QoS back")
