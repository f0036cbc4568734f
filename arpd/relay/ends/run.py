"""`arpd relay` with two ends, as a process in two ROS domains."""

from __future__ import annotations

import ctypes
import os
import secrets
import time
from contextlib import closing
from functools import partial
from typing import TYPE_CHECKING

from std_msgs.msg import Empty

from arpd.model.errors import RosUnavailableError
from arpd.relay.ends.end import End
from arpd.relay.envelope import WRAP
from arpd.ros.rmw import current_rmw
from arpd.ros.runtime import (
    PROFILE_VARIABLES,
    TWO_ENDED_PROFILE,
    prepare_environment,
    ros_node,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from rclpy.node import Node

    from arpd.model.settings import RelaySettings
    from arpd.relay.ends.participants import Serve
    from arpd.ros.rmw import Rmw

_TICK_S = 0.1
_M_MMAP_THRESHOLD, _LARGE_BYTES = -3, 128 * 1024


def run_end(
    settings: RelaySettings,
    serve: Serve,
    *,
    is_far: bool,
    node_name: str,
    host: str,
    on_change: Callable[[str], None],
) -> None:
    """Run one end as long as ``serve`` does, whose errors pass.

    Raises
    ------
    RosUnavailableError
        If ROS 2 does not start here, or its middleware or profile lets an end hear itself.
    """
    prepare_environment(TWO_ENDED_PROFILE)
    return_large_blocks()
    with ros_node(node_name) as node, ros_node(node_name, settings.link(is_far=is_far)) as link_node:
        check_middleware(current_rmw())
        check_deaf_to_itself(node)
        session = 1 + secrets.randbelow(WRAP - 1)
        end = End(node, link_node, settings, is_far=is_far, host=host, session=session, on_change=on_change)
        with closing(end):
            serve(end.tick, _TICK_S, [partial(getattr, each, "finished_s") for each in end.threads])


def return_large_blocks() -> None:
    """Let the C library return large blocks to the system when they are free, as glibc's mallopt(3) says.

    By default its threshold grows with the blocks it frees, up to 32 MB: maps that came and went stay in its heaps.
    """
    ctypes.CDLL(None).mallopt(_M_MMAP_THRESHOLD, _LARGE_BYTES)


def check_middleware(rmw: Rmw) -> None:
    """Refuse a middleware that no profile keeps from hearing itself.

    Raises
    ------
    RosUnavailableError
        If it is not Fast DDS.
    """
    if not rmw.is_fast_dds:
        raise RosUnavailableError(
            f"two ends need rmw_fastrtps_cpp; this process has {rmw.name}; set RMW_IMPLEMENTATION=rmw_fastrtps_cpp for "
            "it, or remove relay.link_domain"
        )


def check_deaf_to_itself(node: Node) -> None:
    """Refuse a Fast DDS profile of the user's own in which an end would hear its own samples, and send them back.

    Raises
    ------
    RosUnavailableError
        If endpoints of one participant match each other.
    """
    publisher = node.create_publisher(Empty, "~/check", 1)
    subscription = node.create_subscription(Empty, "~/check", lambda _sample: None, 1)
    time.sleep(0.1)
    hears_itself = publisher.get_subscription_count() > 0
    node.destroy_subscription(subscription)
    node.destroy_publisher(publisher)
    if hears_itself:
        raise RosUnavailableError(
            "the Fast DDS profile of this process lets it hear its own samples, which would circle; add "
            f"fastdds.ignore_local_endpoints=true to it, as in {TWO_ENDED_PROFILE}, or unset {profile_variables()}"
        )


def profile_variables(environ: Mapping[str, str] = os.environ) -> str:
    """Return the variables that choose the profile of this process."""
    return " and ".join(name for name in PROFILE_VARIABLES if name in environ)
