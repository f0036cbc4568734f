"""Summaries of the relay, which the robot's end sends the daemon on its host."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

from std_msgs.msg import UInt8MultiArray

from arpd.adapters.ros.names import RELAY_SUMMARY_TOPIC
from arpd.adapters.ros.rcl import rcl
from arpd.adapters.ros.relay_summaries import SUMMARY_QOS
from arpd.apply.relay.envelope import wrap
from arpd.apply.relay.offers import EndState
from arpd.apply.relay.partner import EVERY_S
from arpd.apply.relay.summary import encode_summary, topics_of

if TYPE_CHECKING:
    from rclpy.node import Node

    from arpd.adapters.ros.ends.calls import Calls
    from arpd.adapters.ros.ends.incoming import Incoming
    from arpd.adapters.ros.ends.link_thread import LinkThread
    from arpd.adapters.ros.ends.outgoing import Outgoing
    from arpd.model.relay import RelaySummary

_NOBODY = EndState(session="", number=0)


class Summaries:
    """Sends one summary a second, and one whenever the status line changes; nobody across the link reads them."""

    def __init__(self, link_node: Node, link: LinkThread, incoming: Incoming, outgoing: Outgoing, calls: Calls) -> None:
        self._link = link
        self._incoming = incoming
        self._outgoing = outgoing
        self._calls = calls
        self._publisher = link_node.create_publisher(UInt8MultiArray, RELAY_SUMMARY_TOPIC, SUMMARY_QOS)
        self._due_s = -math.inf
        self._status = ""

    def is_due(self, now_s: float, status: str) -> bool:
        """Return whether to send one now."""
        return now_s >= self._due_s or status != self._status

    def send(self, now_s: float, *, here: EndState, there: EndState | None, status: str, end: RelaySummary) -> None:
        """Send one.

        Parameters
        ----------
        here, there : states of this end and the other
        status : the status line
        end : what only the end itself knows
        """
        self._due_s, self._status = now_s + EVERY_S, status
        there = there or _NOBODY
        summary = replace(
            end,
            other_host=there.host,
            to_ceddp=topics_of(here, there),
            to_robot=topics_of(there, here),
            received=self._incoming.received,
            doubled=self._incoming.doubled,
            unknown=self._incoming.unknown,
            outdated=self._incoming.outdated,
            link_bytes=self._link.link_bytes,
            incomplete=self._outgoing.incomplete,
            calls_failed=dict(self._calls.failures),
        )
        rcl().publish(self._publisher.handle, wrap(encode_summary(summary)))
