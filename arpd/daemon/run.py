"""`arpd run`: puts the daemon together, runs it until a signal, and restores the publishers."""

from __future__ import annotations

import gc
import logging
import threading
import time
from contextlib import ExitStack
from functools import cache, partial
from importlib import import_module
from typing import TYPE_CHECKING, Any

from prometheus_client import Histogram, disable_created_metrics

from arpd.daemon.supervisor import Signals, Supervisor, in_thread
from arpd.daemon.tick import Daemon
from arpd.host.addresses import Addresses, own_address
from arpd.host.config.load import load_settings, local_domain
from arpd.host.journal import configure_logging, log_event
from arpd.host.kernel import interface_of_link
from arpd.host.notify import Notifier
from arpd.model.settings import OnStop, Settings
from arpd.web.web_config import load_protection

if TYPE_CHECKING:
    from collections.abc import Callable
    from concurrent.futures import Future
    from pathlib import Path

    from arpd.sim.oracle import Oracle

log = logging.getLogger(__name__)

# A tick has 0.1 s, and one that begins 0.05 s late counts as late: both are bounds.
_TICK_S = (0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5)
# A dozen topics take a millisecond, a thousand some ten (scripts/bench/solve.py).
_SOLVE_S = (0.0001, 0.00025, 0.0005, 0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25)
_DURATIONS = {
    "tick_duration": ("Duration of finished ticks.", _TICK_S),
    "tick_lateness": ("Delay after the planned time at which ticks began; above 0.05 counts as late.", _TICK_S),
    "solve_duration": ("Duration of solves of the whole program, one for each tick that plans.", _SOLVE_S),
}
_COLLECT_S = 30.0
_MOST_NEW = 200_000  # objects that may wait to be collected: some tens of megabytes, if all were garbage


class _Garbage:
    """Collects garbage between ticks; what exists at first, mostly modules, never.

    Python collects where most is allocated, in the middle of a tick or a scrape, and stops all threads until it ends.
    Measured with a thousand topics: 20 to 70 ms, twice a second during scrapes, and one tick in ten was late. Only
    cycles need a collection.
    """

    def __init__(self) -> None:
        gc.collect()
        gc.freeze()
        gc.disable()
        self._collected_s = time.monotonic()

    def collect_if_due(self) -> None:
        """Collect every 30 s, or when many objects are new; call it where a delay costs least."""
        if time.monotonic() - self._collected_s >= _COLLECT_S or gc.get_count()[0] >= _MOST_NEW:
            gc.collect()
            self._collected_s = time.monotonic()


def loaded(module: str) -> Any:
    """Return a module, None while a thread imports it: a solver takes 0.2 s, on a Raspberry Pi a second."""
    loading = _loading(module)
    return loading.result() if loading.done() else None


@cache
def _loading(module: str) -> Future[Any]:
    return in_thread(partial(import_module, module), "arpd-solver")


def new_durations() -> dict[str, Histogram]:
    """Return empty histograms, in no registry yet."""
    disable_created_metrics()  # type: ignore[no-untyped-call]
    return {
        name: Histogram(f"arpd_{name}_seconds", text, registry=None, buckets=bounds_s)
        for name, (text, bounds_s) in _DURATIONS.items()
    }


def load(config_path: Path) -> tuple[Settings, Callable[[], str | None]]:
    """Read and check a configuration as a start does, so that no reload takes one that the next start refuses.

    The link interface may come later. Raises ConfigError.

    Returns
    -------
    The settings, and what finds this computer's address on the link (`own_address`).
    """
    settings = load_settings(config_path, interfaces=None, local_domain=local_domain())
    load_protection(settings.http, directory=config_path.parent)
    return settings, own_address(config_path, settings.relay.link(is_far=False), is_far=False)


def run_daemon(*, config_path: Path, log_level: str, estimator: Oracle | None = None) -> int:
    """Run the daemon until SIGTERM or SIGINT.

    Parameters
    ----------
    config_path : YAML configuration
    log_level : name of a logging level
    estimator : estimates the capacity; arpd's own by default

    Raises
    ------
    ArpdError
        If the configuration or ROS cannot be used, or only a new process can use the link's address; the publishers
        then keep their plan.
    """
    signals = Signals()
    signals.install()
    configure_logging(log_level)
    notifier = Notifier()

    settings, own = load(config_path)  # before ROS is imported, so that a fault in the file shows at once
    from arpd.ros import runtime  # noqa: PLC0415 - as above

    link_domain = settings.relay.link(is_far=False)
    addresses = Addresses(lambda: daemon.interface, own=own)
    if link_domain is not None:
        runtime.prepare_environment(runtime.DAEMON_PROFILE)
    runtime.send_without_waiting()
    with ExitStack() as stack:
        node = own_node = stack.enter_context(runtime.ros_node("arpd", link_domain, address=own()))
        if link_domain is not None:
            runtime.prepare_for_this_host()
            own_node = stack.enter_context(runtime.ros_node("arpd"))  # in the robot's own domain, for its diagnostics
        from arpd.ros.diagnostics import Diagnostics  # noqa: PLC0415
        from arpd.ros.world import RosControl  # noqa: PLC0415
        from arpd.web.server import HttpServer  # noqa: PLC0415

        resting, durations = threading.Event(), new_durations()
        world = RosControl(
            node,
            interface=settings.link.interface,
            route=partial(interface_of_link, settings.relay.base, settings.relay.robot),
            on_report=signals.wakeup.set,
            has_two_ends=link_domain is not None,
        )
        daemon = Daemon(
            world,
            settings,
            config_path=str(config_path),
            estimator=estimator,
            tell=log_event,
            timed=lambda name, took_s: durations[name].observe(took_s),
            load=loaded,
        )
        diagnostics = Diagnostics(own_node, lambda: daemon.snapshot)
        web = HttpServer(
            settings.http,
            snapshot=lambda: daemon.snapshot,
            directory=config_path.parent,
            history=daemon.record.history,
            durations=durations.values(),
            resting=resting,
        )
        supervisor = Supervisor(
            daemon,
            signals,
            notifier,
            load=lambda: load(config_path)[0],
            fault=lambda: web.fault,
            is_cut_off=addresses.are_outdated,
            resting=resting,
            after_tick=(diagnostics.look, _Garbage().collect_if_due),
            parts=(lambda: world.thread.finished_s,),
        )
        signals.is_looping = True
        with web.up():
            supervisor.run()
        if not signals.stop:
            raise addresses.error()
        notifier.stopping()
        stop(daemon)  # without metrics: as no tick finishes, they would raise an alert
    return 0


def stop(daemon: Daemon) -> None:
    """Restore the publishers or leave them their plan, as configured; a failure is logged, and the process ends."""
    if daemon.settings.on_stop is not OnStop.RESTORE:
        log.info("stopping; the publishers keep their plan (on_stop: keep)")
        return
    try:
        missing = daemon.restore(wait=time.sleep)
    except Exception:
        log.exception("stopping; restoring failed, and publishers may keep their plan")
        return
    if missing is None:
        log.info("stopping; another daemon drives the publishers, which keep its plan")
    elif missing:
        log.warning("stopping; %d publishers did not confirm their original QoS in time", missing)
    else:
        log.info("stopping; every publisher has its original QoS back")
