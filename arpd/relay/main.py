"""`arpd relay`: carries topics of nodes whose code is not yours, under a prefix or between two ends."""

from __future__ import annotations

import ctypes
import logging
import math
import platform
import re
import resource
import secrets
import sys
import time
from contextlib import closing
from functools import partial
from typing import TYPE_CHECKING

from std_msgs.msg import UInt8MultiArray

from arpd.host.addresses import Addresses, own_address
from arpd.host.config.load import load_settings, local_domain
from arpd.host.journal import configure_logging
from arpd.host.kernel import link_interface
from arpd.host.notify import Notifier
from arpd.model.errors import RosUnavailableError
from arpd.model.settings import AUTO
from arpd.relay.ends.end import End
from arpd.relay.ends.prefix import Prefixed
from arpd.ros.rmw import Rmw, current_rmw
from arpd.ros.runtime import (
    PROFILE_VARIABLE,
    TWO_ENDED_PROFILE,
    prepare_environment,
    prepare_for_this_host,
    ros_node,
    serve_until,
    stop_on_signals,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from rclpy.node import Node

    from arpd.endpoint.writing_thread import WritingThread
    from arpd.ros.raw_reader import ReadingThread

log = logging.getLogger(__name__)
_TICK_S, _LOOK_S, _IDLE_S = 0.1, 0.5, 1.0  # between two steps: of an end, under a prefix, and of neither
_SWITCH_S = 0.0005  # most that a sample waits for a thread that computes; Python's 5 ms suit a program that computes
_M_MMAP_THRESHOLD, _LARGE_BYTES = -3, 128 * 1024


def default_node_name(host: str, *, is_far: bool = False) -> str:
    """Return a node name with this host's name: two relays of one name would receive each other's plans."""
    return f"arpd_relay_{'far_' if is_far else ''}" + re.sub(r"[^A-Za-z0-9_]", "_", host)


def run_relay(*, config_path: Path, node_name: str | None, log_level: str, is_far: bool = False) -> int:
    """Run the relay until SIGINT or SIGTERM: one end with the prefix, or one of two ends.

    Parameters
    ----------
    node_name : name of the ROS node; `default_node_name` of this host when None
    is_far : whether this is the base computer's end

    Raises
    ------
    ConfigError
        If the configuration cannot be used, or this is the computer of the other end.
    LinkError
        If only a new process can use the link's address.
    RosUnavailableError
        If ROS 2 does not start here, or its middleware or profile lets an end hear itself.
    """
    configure_logging(log_level, name="arpd-relay-far" if is_far else "arpd-relay")
    sys.setswitchinterval(_SWITCH_S)
    allow_many_files()
    settings = load_settings(config_path, interfaces=None, local_domain=local_domain())
    stopping = stop_on_signals()
    notifier = Notifier()
    interface = AUTO if is_far else settings.link.interface  # the file names the robot's
    relay, link = settings.relay, settings.relay.link(is_far=is_far)
    own = own_address(config_path, link, is_far=is_far)
    addresses = Addresses(partial(link_interface, interface, relay.robot, relay.base), own=own)

    def serve(step: Callable[[], None], every_s: float, threads: Sequence[ReadingThread | WritingThread] = ()) -> None:
        parts = [lambda: min((each.finished_s for each in threads), default=math.inf)]  # there may be more later
        serve_until(stopping, notifier=notifier, parts=parts, addresses=addresses, step=step, every_s=every_s)

    name = node_name or default_node_name(platform.node(), is_far=is_far)
    if link is not None:
        prepare_environment(TWO_ENDED_PROFILE)
        return_large_blocks()
        with ros_node(name, link, address=own()) as link_node:
            prepare_for_this_host()
            with ros_node(name) as node:
                check_middleware(current_rmw())
                check_deaf_to_itself(node)
                with closing(End(node, link_node, relay, is_far=is_far, on_change=notifier.status)) as end:
                    serve(end.tick, _TICK_S, end.threads)
    elif is_far or not relay.topics:
        lacking = "relay.link_domain is not" if is_far else "neither relay.link_domain nor relay.topics is"
        log.info(reason := f"nothing to do: {lacking} set in {config_path}")
        notifier.status(reason)
        serve(lambda: None, _IDLE_S)
    else:
        with ros_node(name) as node, closing(Prefixed(node, relay, tell=notifier.status)) as prefixed:
            serve(prefixed.look, _LOOK_S, prefixed.threads)
    return 0


def allow_many_files() -> None:
    """Let this process open as many files as the system may let it: each topic and service takes one.

    By default systemd and shells let it have 1024, of half a million.
    """
    _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))


def return_large_blocks() -> None:
    """Let the C library return large blocks to the system when they are free, as glibc's mallopt(3) says.

    By default its threshold grows with the blocks it frees, up to 32 MB: maps that came and went stay in its heaps.
    """
    ctypes.CDLL(None).mallopt(_M_MMAP_THRESHOLD, _LARGE_BYTES)


def check_middleware(rmw: Rmw) -> None:
    """Raise RosUnavailableError where no profile keeps the middleware from hearing itself: it is not Fast DDS."""
    if not rmw.is_fast_dds:
        raise RosUnavailableError(
            f"two ends need rmw_fastrtps_cpp; this process has {rmw.name}; set RMW_IMPLEMENTATION=rmw_fastrtps_cpp for "
            "it, or remove relay.link_domain"
        )


def check_deaf_to_itself(node: Node) -> None:
    """Raise RosUnavailableError where endpoints of one participant match each other.

    With such a Fast DDS profile of the user's own an end would hear its own samples, and send them back.
    """
    topic = f"~/check_{secrets.token_hex(4)}"  # ends of several robots on one host have one name, and start at once
    publisher = node.create_publisher(UInt8MultiArray, topic, 1)
    subscription = node.create_subscription(UInt8MultiArray, topic, lambda _sample: None, 1)
    time.sleep(0.1)
    hears_itself = publisher.get_subscription_count() > 0
    node.destroy_subscription(subscription)
    node.destroy_publisher(publisher)
    if hears_itself:
        raise RosUnavailableError(
            "the Fast DDS profile of this process lets it hear its own samples, which would circle; add "
            f"fastdds.ignore_local_endpoints=true to it, as in {TWO_ENDED_PROFILE}, or unset {PROFILE_VARIABLE}"
        )
