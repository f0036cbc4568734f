"""Summaries of the relay, which its end on this host sends the daemon."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

from rclpy.qos import QoSProfile, QoSReliabilityPolicy
from std_msgs.msg import UInt8MultiArray

from arpd.adapters.ros.names import RELAY_SUMMARY_TOPIC
from arpd.adapters.ros.raw_reader import RawReader
from arpd.adapters.ros.serialized import octets
from arpd.apply.relay.summary import MOST_SUMMARY_BYTES, decode_summary
from arpd.model.observation import MessageKind, MessageRefusal
from arpd.observe.rate_limits import TokenBucket

if TYPE_CHECKING:
    from collections.abc import Callable

    from arpd.adapters.ros.raw_reader import ReadingThread, Sample
    from arpd.adapters.ros.refused_messages import RefusedMessages
    from arpd.model.relay import RelaySummary

SUMMARY_QOS = QoSProfile(depth=1, reliability=QoSReliabilityPolicy.BEST_EFFORT)
_SILENT_S = 3.5  # three summaries missed
_HEADER_BYTES = 32  # of a serialized array, and its padding
_HZ, _BURST = 20.0, 20.0  # the end sends one a second, and ten a second while much changes


class RelaySummaries:
    """Receives the summaries, and keeps the newest.

    Parameters
    ----------
    node : the daemon's node in the link domain
    thread : reads them
    refused : counts refused messages
    clock : monotonic clock (s)
    """

    def __init__(
        self,
        node: Any,
        *,
        thread: ReadingThread,
        refused: RefusedMessages,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._refused = refused
        self._clock = clock
        self._bucket = TokenBucket(_HZ, _BURST)
        self._newest: tuple[float, RelaySummary | None] = clock(), None  # with the time of its arrival
        self._reader = RawReader(
            node,
            UInt8MultiArray,
            RELAY_SUMMARY_TOPIC,
            SUMMARY_QOS,
            deliver=self._on_summary,
            thread=thread,
            most_bytes=MOST_SUMMARY_BYTES + _HEADER_BYTES,
            refuse=lambda: self._refuse(MessageRefusal.SIZE, "a message is longer than any summary of a relay"),
        )

    def newest(self, now_s: float) -> tuple[RelaySummary | None, bool]:
        """Return the newest summary, None if there is none or it is old, and whether the end is silent."""
        at_s, summary = self._newest
        is_silent = now_s - at_s > _SILENT_S
        return None if is_silent else summary, is_silent

    def _on_summary(self, sample: Sample) -> None:
        now_s = self._clock()
        if not self._bucket.take(now_s):
            self._refuse(MessageRefusal.RATE, "there are more summaries than one end of a relay sends")
            return
        try:
            self._newest = now_s, decode_summary(octets(sample.data))
        except ValueError as fault:
            self._refuse(MessageRefusal.MALFORMED, str(fault))

    def _refuse(self, reason: MessageRefusal, words: str) -> None:
        self._refused.note(MessageKind.RELAY_SUMMARIES, reason, words)
