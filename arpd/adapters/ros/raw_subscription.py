"""Messages from the network as bytes, of bounded size, and without letting a flood take the processor."""

from __future__ import annotations

import inspect
import logging
import math
import struct
import threading
import time
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from arpd.adapters.ros.events import InvalidHandle, no_subscription_events
from arpd.observe.rate_limits import RefusalCounts, TokenBucket

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from rclpy.qos import QoSProfile

    from arpd.model.observation import MessageKind, MessageRefusal

_MOST_AT_ONCE = 1000
_CALM_HZ = 200.0  # messages of a hundred nodes and two peers; more is a flood
_FLOOD_S = 3.0
_PAUSE_S, _WORK_S = 0.02, 0.005  # alternate in a flood
_WITH_INFO = inspect.signature(lambda _message, _info: None)
_ORDER = {0: ">", 1: "<"}  # by CDR's representation identifier (OMG DDSI-RTPS 2.3, 10.5)


class Pause:
    """Leaves time to the other threads during a flood; all subscriptions of an executor share one.

    Parameters
    ----------
    clock : monotonic clock (s)
    sleep : waits for the given time (s)
    """

    def __init__(
        self, clock: Callable[[], float] = time.monotonic, *, sleep: Callable[[float], None] = time.sleep
    ) -> None:
        self._clock = clock
        self._sleep = sleep
        self._ended_s = -math.inf

    def take(self) -> None:
        """Wait, unless another subscription has just waited."""
        if self._clock() - self._ended_s >= _WORK_S:
            self._sleep(_PAUSE_S)
            self._ended_s = self._clock()


class RawSubscription:
    """Receives one topic serialized, so that refused messages are never decoded.

    An executor takes a tenth of a millisecond or more per message, so thousands a second would leave it no time for
    anything else. This class takes all waiting messages together, at 10 us each, and in a flood the executor rests most
    of the time.

    Parameters
    ----------
    node : rclpy node; its owner spins it
    most_bytes : size above which a message is refused
    take : called with every message, serialized, and its MessageInfo
    refuse : called instead when a message is too long
    pause : taken in a flood; shared by the raw subscriptions of one executor
    calm_hz : most messages a second, and at once, that are no flood
    clock : monotonic clock (s)
    """

    def __init__(
        self,
        node: Any,
        msg_type: Any,
        topic: str,
        qos: QoSProfile,
        *,
        most_bytes: int,
        take: Callable[[bytes, Any], None],
        refuse: Callable[[], None],
        pause: Pause | None = None,
        calm_hz: float = _CALM_HZ,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._msg_type = msg_type
        self._most_bytes = most_bytes
        self._take = take
        self._refuse = refuse
        self._clock = clock
        self._pause = pause or Pause()
        self._calm = TokenBucket(calm_hz, calm_hz)
        self._flooded_until_s = -math.inf
        self._subscription: Any = None

        def tap(*taken: Any) -> None:
            # EventsExecutor passes message and MessageInfo as one pair (rclpy 7.1.6).
            self._on_message(*(taken if len(taken) == 2 else taken[0]))

        tap.__signature__ = _WITH_INFO  # type: ignore[attr-defined] # rclpy asks it whether to pass MessageInfo
        self._subscription = node.create_subscription(
            msg_type, topic, tap, qos, raw=True, event_callbacks=no_subscription_events()
        )

    @property
    def is_flooded(self) -> bool:
        """True during a flood and shortly after: some honest messages may be lost."""
        return self._clock() < self._flooded_until_s

    def _on_message(self, data: bytes, info: Any) -> None:
        waiting: tuple[bytes, Any] | None = data, info
        taken, now_s = 0, self._clock()
        while waiting is not None:
            self._receive(*waiting)
            taken += 1
            if not self._calm.take(now_s):
                self._flooded_until_s = now_s + _FLOOD_S
            waiting = self._waiting() if taken < _MOST_AT_ONCE else None
        if now_s < self._flooded_until_s:
            self._pause.take()

    def _waiting(self) -> tuple[bytes, Any] | None:
        if self._subscription is None:
            return None  # the first message arrived before the constructor was done
        try:
            with self._subscription.handle:
                taken = self._subscription.handle.take_message(self._msg_type, True)  # noqa: FBT003 - rclpy's "raw"
        except InvalidHandle:
            return None
        return None if taken is None else (taken[0], taken[1])

    def _receive(self, data: bytes, info: Any) -> None:
        if len(data) > self._most_bytes:
            self._refuse()
        else:
            self._take(data, info)


def peek(data: bytes) -> tuple[str, int]:
    """Return the name of the first status in a serialized DiagnosticArray, and the number of statuses.

    It takes 3 µs; decoding a message of ten statuses takes a hundred times that.

    Raises
    ------
    ValueError
        If the bytes are no DiagnosticArray, or an empty one.
    """
    try:
        order = _ORDER[data[1]]
        (frame,) = struct.unpack_from(order + "I", data, 12)  # after the stamp
        count_at = 4 + _aligned(12 + frame)
        count, _level, size = struct.unpack_from(order + "IB3xI", data, count_at)
        name = data[count_at + 12 : count_at + 11 + size]  # without its final zero
        if not count or size < 1 or len(name) != size - 1:
            raise ValueError("a DiagnosticArray without a status")
        return name.decode(), count
    except (KeyError, IndexError, struct.error) as fault:
        raise ValueError("no DiagnosticArray") from fault


def octets(data: bytes) -> bytes:
    """Return the content of a serialized UInt8MultiArray without dimensions; arpd's have none.

    Raises
    ------
    ValueError
        If the bytes are no such array.
    """
    try:
        dimensions, _offset, size = struct.unpack_from(_ORDER[data[1]] + "III", data, 4)
    except (KeyError, IndexError, struct.error) as fault:
        raise ValueError("no UInt8MultiArray") from fault
    held = data[16 : 16 + size]
    if dimensions or len(held) != size:
        raise ValueError("a UInt8MultiArray with dimensions, or cut off")
    return held


def _aligned(offset: int) -> int:
    return -4 * (-offset // 4)


log = logging.getLogger(__name__)


class RefusedMessages:
    """`RefusalCounts` for callbacks in any number of threads.

    Parameters
    ----------
    clock : monotonic clock (s)
    """

    def __init__(self, *, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._lock = threading.Lock()
        self._refusals = RefusalCounts()

    @property
    def counts(self) -> Mapping[tuple[MessageKind, MessageRefusal], int]:
        """Refusals so far."""
        with self._lock:
            return MappingProxyType(self._refusals.counts)

    def note(self, kind: MessageKind, reason: MessageRefusal, words: str, *, source: str = "") -> None:
        """Count a refusal, and log it once a minute per source.

        Parameters
        ----------
        words : the refused message and the reason
        source : its sender, empty = not known
        """
        with self._lock:
            is_news = self._refusals.note(kind, reason, source, self._clock())
        if is_news:
            log.warning("ignored (logged once a minute): %s", words)
