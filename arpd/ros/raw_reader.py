"""Serialized samples with the identity of their writer, taken in a thread of their own: arpd's only inlet.

rclpy's MessageInfo does not name the writer of a sample (7.1.6), and without it several writers of one topic cannot be
told apart. So a sample is taken from rcl, through ctypes; the reader itself is rclpy's.

The middleware announces new samples in a thread of its own, under its locks. A Python function called there would wait
for the interpreter, and so for a thread that holds it and waits for those locks: measured, the process stands still. So
the function called there is eventfd_write of the C library, which takes the same arguments: a number and a count.

Samples are taken by that count. rmw_fastrtps announces none that comes while the function is set, and where it counted
one too few, the last sample would wait for the next one from then on. So each reader is asked without a count at first,
and once a second.
"""

from __future__ import annotations

import ctypes
import logging
import math
import os
import select
import threading
import time
from collections import deque
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.type_support import check_for_type_support

from arpd.ros.rate_limits import OncePerMinute
from arpd.ros.rcl import InvalidHandle, MessageInfo, attached, is_live, rcl

if TYPE_CHECKING:
    from collections.abc import Callable

    from rclpy.context import Context
    from rclpy.node import Node
    from rclpy.qos import QoSProfile

log = logging.getLogger(__name__)
_LEAST_BYTES = 4  # the header of every serialized message
_NOBODY = bytes(16)
_MOST_REPEATS = 100
_MOST_AT_ONCE, _MOST_BYTES_AT_ONCE = 32, 100_000  # samples of one reader before the next reader's turn
_TURN_S = 1.0  # longest wait for a sample, and between two looks at every reader
_ALL = 1_000_000  # announced where nobody has counted
LATE_S = 0.5  # beyond that an outage lies between, and the newest sample of each writer is wanted
_LEAST_DEPTH, _ROOM = 2, 2.0  # a new endpoint costs something, so one is made where twice the bytes would be held
_NOTHING = 401  # RCL_RET_SUBSCRIPTION_TAKE_FAILED
REST_S = 0.005  # of threads that read messages of arpd: then no flood takes the processor


class Sample(NamedTuple):
    """One sample, serialized, with the GUID of its writer, its number there, and when it left and arrived (Unix, ns).

    The middleware's own thread notes the arrival, so a sample that waits for its reader is not late.
    """

    data: bytes
    writer: bytes
    sequence: int
    sent_ns: int = 0
    received_ns: int = 0


def is_late(sample: Sample, late_s: float) -> bool:
    """Return whether a sample has waited here for longer than that (s); never where nobody noted its arrival."""
    return 0 < sample.received_ns < time.time_ns() - late_s * 1e9


class Inlet(Protocol):
    """What a `ReadingThread` serves: a `RawReader`, or the inlet of a server or a client, by the name of its topic.

    ``notify`` is the function of rcl that sets what the middleware calls when something has come to the endpoint.
    """

    name: str
    handle: Any
    notify: Any

    def read(self, announced: int) -> int:
        """Take and deliver some of what was announced; return how many are left.

        More may have been announced than there are: a full history drops the oldest.
        """

    def destroy(self) -> None:
        """Read no more."""


class ReadingThread:
    """Takes what has come for any number of `Inlet`; their functions are called in this thread.

    Parameters
    ----------
    step : called after every turn; returns when to call it again at the latest, by the monotonic clock (s)
    rest_s : rest after every turn, in which more samples come together (s)
    is_alive : returns False once its participant is gone, which destroys what it serves, and ends the thread
    """

    def __init__(
        self,
        *,
        step: Callable[[], float] = lambda: math.inf,
        rest_s: float = 0.0,
        is_alive: Callable[[], bool] = lambda: True,
    ) -> None:
        self._step = step
        self._rest_s = rest_s
        self._is_alive = is_alive
        # When it last finished a sample or a wait. A function may write, and a write onto a full link blocks for long,
        # so the watchdog's time runs for one sample alone.
        self.finished_s = time.monotonic()
        self._rcl = rcl()
        self._buffer, self._info = self._rcl.buffer(), MessageInfo()
        self._arguments = ctypes.byref(self._buffer), ctypes.byref(self._info)
        self._readers: dict[int, Inlet] = {}  # by the event that the middleware writes
        self._retired: deque[int] = deque()  # events of nobody; this thread may still be about to read one
        self._events = select.epoll()
        self._logged = OncePerMinute()
        self._stopping = threading.Lock()  # taken by who stops the thread, for good
        self._woken = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._events.register(self._woken, select.EPOLLIN)
        self._thread = threading.Thread(target=self._run, name="arpd-reading", daemon=True)
        self._thread.start()

    @classmethod
    def of(cls, context: Context) -> ReadingThread:
        """Return the thread that reads arpd's messages in a participant, made on first use; it ends with it."""

        def make() -> ReadingThread:
            thread = cls(rest_s=REST_S, is_alive=partial(is_live, context))
            context.on_shutdown(thread.stop)
            return thread

        return attached(context, cls, make)

    def stop(self) -> None:
        """End the thread; samples that wait are dropped. It may have ended already."""
        if not self._thread.is_alive() or not self._stopping.acquire(blocking=False):  # a forked process has none
            return
        if threading.current_thread() is not self._thread:
            self.wake()
            self._thread.join(timeout=2.0)
        self._close_retired()
        self._events.close()
        os.close(self._woken)

    def wake(self) -> None:
        """Call the step now; for any thread, before `stop` returns."""
        os.eventfd_write(self._woken, 1)

    def watch(self, reader: Inlet) -> int:
        """Read from a reader from now on; return its event, for `unwatch`."""
        event = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._readers[event] = reader
        self._events.register(event, select.EPOLLIN)
        with reader.handle:
            reader.notify(reader.handle.pointer, self._rcl.eventfd_write, event)
        os.eventfd_write(event, _ALL)
        return event

    def unwatch(self, reader: Inlet, event: int) -> None:
        """Read it no more; something may still be delivered meanwhile."""
        with reader.handle:
            reader.notify(reader.handle.pointer, None, None)
        del self._readers[event]
        if self._events.closed or not self._thread.is_alive():  # a forked process shares the epoll with its parent
            os.close(event)
            return
        self._events.unregister(event)
        # Closed here, its number could be a socket's before the thread reads it, and the thread would wait there.
        self._retired.append(event)

    def take(self, handle: Any) -> Sample | None:
        """Take a sample of a subscription, None if there is none; only for this thread."""
        with handle:
            result = self._rcl.take(handle.pointer, *self._arguments, None)
        if result != 0:
            if result != _NOTHING:
                self._rcl.forget_error()
            return None
        info, buffer = self._info, self._buffer
        return Sample(
            ctypes.string_at(buffer.buffer, buffer.length),
            bytes(info.publisher_gid),
            info.publication_sequence_number,
            info.source_timestamp,
            info.received_timestamp,
        )

    def note_finished(self) -> float:
        """Note that something has been delivered, and return the time (s); only for this thread."""
        self.finished_s = time.monotonic()
        return self.finished_s

    def say_late(self, name: str) -> None:
        """Say that samples of a topic were left out; only for this thread."""
        if self._logged.take("", time.monotonic()):
            why = f"its samples waited for more than {LATE_S:g} s, and the newest of each writer goes on"
            log.warning("this computer is too busy for %s: %s (logged once a minute for all topics)", name, why)

    def _close_retired(self) -> None:
        while self._retired:
            os.close(self._retired.popleft())

    def _run(self) -> None:
        left: dict[int, int] = {}  # what was announced and is not taken yet, by event
        look_s = time.monotonic() + _TURN_S
        while True:
            self._close_retired()
            wait_s = min(_TURN_S, self._step_now() - time.monotonic())
            ready = {event for event, _ in self._events.poll(0 if left else max(0.0, wait_s))}
            if self.note_finished() >= look_s:
                look_s = self.finished_s + _TURN_S
                left |= dict.fromkeys([*self._readers], _ALL)
            if self._is_over():
                return
            for event in ready | left.keys():
                announced = left.pop(event, 0)
                reader = self._readers.get(event)
                try:
                    if event in ready:
                        announced += os.eventfd_read(event)
                    if reader is not None and (more := reader.read(announced)):
                        left[event] = more
                except (InvalidHandle, OSError):
                    continue  # just destroyed
                except Exception:
                    log.exception("a sample of %s failed; the next one follows", reader.name if reader else "a topic")
                    left[event] = announced
            if ready and self._rest_s:
                time.sleep(self._rest_s)

    def _is_over(self) -> bool:
        if not self._is_alive():  # after a signal rclpy runs no `on_shutdown` callback
            for reader in tuple(self._readers.values()):
                reader.destroy()  # it would keep the participant
            self.stop()
        return self._stopping.locked()

    def _step_now(self) -> float:
        try:
            return self._step()
        except Exception:
            log.exception("a step between samples failed; the next one follows")
            return math.inf


def bounded_depth(depth: int, sample: bytes, most_bytes: int | None) -> int:
    """Return the depth of an endpoint that is to hold no more bytes than these, in samples like this one."""
    if most_bytes is None or depth <= _LEAST_DEPTH or len(sample) * depth <= _ROOM * most_bytes:
        return depth
    return max(_LEAST_DEPTH, most_bytes // len(sample))


class RawReader:
    """A reader of one topic whose samples a `ReadingThread` takes.

    Parameters
    ----------
    msg_type : message class; no message is decoded
    deliver : called with every sample, in the thread
    most_held_bytes : what may wait for the thread; a reader whose samples are too large for that gets a smaller depth
    is_kept : whether samples are delivered, too, that are late because this computer is busy, where newer ones of their
        writer wait
    """

    def __init__(
        self,
        node: Node,
        msg_type: Any,
        topic: str,
        qos: QoSProfile,
        *,
        deliver: Callable[[Sample], None],
        thread: ReadingThread,
        most_held_bytes: int | None = None,
        is_kept: bool = True,
    ) -> None:
        self.name, self.notify, self._thread = topic, rcl().notify_reader, thread
        self._deliver = deliver
        self._node, self._msg_type, self._qos = node, msg_type, qos
        self._most_held_bytes, self._is_kept = most_held_bytes, is_kept
        self._lock = threading.Lock()
        self._is_destroyed = False
        self._last = (b"", 0, 0)  # writer and number of the newest sample, and when it left
        self._repeats = 0
        check_for_type_support(msg_type)
        with self._lock:  # a large sample that waits already lets the thread begin again
            self._make()

    def destroy(self) -> None:
        """Destroy the reader, if it is not yet; a sample may still be delivered while this is called."""
        with self._lock:
            if not self._is_destroyed:
                self._is_destroyed = True
                self._close()

    def _is_new(self, sample: Sample) -> bool:
        """Return whether this is a sample, and another one than the last.

        Seen once, in a bench that kills the writers of large samples on a lossy link: Fast DDS gave 1.6 million samples
        of /points that were none, as fast as they were taken.
        """
        identity = sample.writer, sample.sequence, sample.sent_ns  # not every middleware numbers samples
        if sample.writer == _NOBODY or identity == self._last:
            self._repeats += 1
            return False
        self._last, self._repeats = identity, 0
        return len(sample.data) >= _LEAST_BYTES

    def read(self, announced: int) -> int:
        """Take and deliver some samples; return how many are left.

        To ask for one more, only to hear that there is none, would cost as much as to take it.
        """
        thread = self._thread
        late: dict[bytes, Sample] = {}  # by writer
        size = 0
        for _ in range(_MOST_AT_ONCE):
            # Under the lock, because a node with a reader in use stays in the graph beyond its `destroy_node`.
            with self._lock:
                sample = thread.take(self.handle) if announced > 0 and not self._is_destroyed else None
            if sample is None:
                announced = 0
                break
            if self._is_new(sample):
                announced -= 1
                size += len(sample.data)
                if late.pop(sample.writer, None):
                    thread.say_late(self.name)
                late[sample.writer] = sample
                if (self._is_kept or not is_late(sample, LATE_S)) and not self._deliver_all(late):
                    return 0
            elif self._repeats > _MOST_REPEATS:
                log.warning("%s gives one sample again and again; a new reader takes its place", self.name)
                self._repeats = 0
                self._begin_again()
                return 0
            if size > _MOST_BYTES_AT_ONCE:
                break
        return announced if self._deliver_all(late) else 0

    def _deliver_all(self, samples: dict[bytes, Sample]) -> bool:
        """Deliver these, which are none then; return whether the reader goes on."""
        while samples:
            sample = samples.pop(next(iter(samples)))
            self._deliver(sample)
            if not self._has_room_for(sample):
                return False
            self._thread.note_finished()
        return True

    def _has_room_for(self, sample: Sample) -> bool:
        """Return whether its depth of such samples is within bounds; if not, begin again with a smaller one.

        Where large samples come late the middleware may drop them: to take each only to pass over it costs more.
        """
        depth = bounded_depth(self._qos.depth, sample.data, self._most_held_bytes)
        if not self._is_kept and len(sample.data) > _MOST_BYTES_AT_ONCE and is_late(sample, LATE_S):
            depth = min(depth, _LEAST_DEPTH)
            self._thread.say_late(self.name)
        if depth == self._qos.depth:
            return True
        self._qos.depth = depth
        self._begin_again()
        return False

    def _begin_again(self) -> None:
        with self._lock:
            if not self._is_destroyed:
                self._close()
                self._make()

    def _close(self) -> None:
        self._thread.unwatch(self, self._event)
        self.handle.destroy_when_not_in_use()

    def _make(self) -> None:
        with self._node.handle:
            # Not by Node.create_subscription: an executor would take the samples.
            self.handle = rclpy_implementation.Subscription(
                self._node.handle, self._msg_type, self.name, self._qos.get_c_qos_profile()
            )
        self._event = self._thread.watch(self)
