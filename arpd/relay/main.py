"""`arpd relay`: carries topics of nodes whose code is not yours, under a prefix or between two ends."""

from __future__ import annotations

import logging
import platform
import re
import threading
from typing import TYPE_CHECKING

from arpd.host.addresses import Addresses
from arpd.host.config.load import load_settings, local_domain
from arpd.host.interface import likeliest_interface
from arpd.host.journal import configure_logging
from arpd.host.notify import Notifier, Watchdog
from arpd.model.settings import AUTO
from arpd.relay.ends.prefix import run_prefix
from arpd.relay.ends.run import run_end
from arpd.ros.runtime import serve_until, stop_on_signals

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from arpd.relay.ends.participants import Parts

log = logging.getLogger(__name__)


def default_node_name(host: str, *, is_far: bool = False) -> str:
    """Return a node name with this host's name: two relays of one name would receive each other's plans."""
    return f"arpd_relay_{'far_' if is_far else ''}" + re.sub(r"[^A-Za-z0-9_]", "_", host)


def run_relay(*, config_path: Path, node_name: str | None, log_level: str, is_far: bool = False) -> int:
    """Run the relay until SIGINT or SIGTERM: one end with the prefix, or one of two ends.

    Parameters
    ----------
    config_path : YAML configuration
    node_name : name of the ROS node; `default_node_name` of this host when None
    is_far : whether this is the base computer's end

    Raises
    ------
    LinkError
        If only a new process can use the link's address.
    """
    configure_logging(log_level, name="arpd-relay-far" if is_far else "arpd-relay")
    settings = load_settings(config_path, interfaces=None, local_domain=local_domain())
    stopping = threading.Event()
    stop_on_signals(stopping)
    notifier = Notifier()
    link = AUTO if is_far else settings.link.interface  # the file names the robot's
    addresses = Addresses(lambda: link if link != AUTO else likeliest_interface() or "")

    def serve(step: Callable[[], None], every_s: float, parts: Parts) -> None:
        heartbeat = Watchdog(notifier, parts=parts)
        notifier.ready()
        try:
            serve_until(stopping, heartbeat=heartbeat, addresses=addresses, step=step, every_s=every_s)
        finally:
            notifier.stopping()

    host, on_change = platform.node(), notifier.status
    name = node_name or default_node_name(host, is_far=is_far)
    if settings.relay.link_domain is not None:
        run_end(settings.relay, serve, is_far=is_far, node_name=name, host=host, on_change=on_change)
    elif is_far:
        _idle(f"nothing to do: relay.link_domain is not set in {config_path}", notifier, stopping)
    else:
        run_prefix(settings.relay, serve, node_name=name, on_change=on_change)
    return 0


def _idle(reason: str, notifier: Notifier, stopping: threading.Event) -> None:
    """Wait for the end with a status that says why, as a relay without topics does."""
    log.info("%s", reason)
    notifier.status(reason)
    notifier.ready()
    heartbeat = Watchdog(notifier)
    while not stopping.wait(1.0):
        heartbeat.beat()
    notifier.stopping()
