"""Serialized samples with the identity of their writer, taken in a thread of their own, without an executor.

rclpy's MessageInfo does not name the writer of a sample (7.1.6), and without it several writers of one topic cannot be
told apart. So a sample is taken from rcl, through ctypes; the reader itself is rclpy's.

The middleware announces new samples in a thread of its own, under its locks. A Python function called there would wait
for the interpreter, and so for a thread that holds it and waits for those locks: measured, the process stands still. So
the function called there is eventfd_write of the C library, which takes the same arguments: a number and a count.
"""

from __future__ import annotations

import ctypes
import logging
import os
import select
import threading
import time
from collections import deque
from typing import TYPE_CHECKING, Any, NamedTuple

from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.type_support import check_for_type_support

from arpd.adapters.ros.events import InvalidHandle
from arpd.adapters.ros.rcl import MessageInfo, rcl

if TYPE_CHECKING:
    from collections.abc import Callable

    from rclpy.node import Node
    from rclpy.qos import QoSProfile

log = logging.getLogger(__name__)
_LEAST_BYTES = 4  # the header of every serialized message
_NOBODY = bytes(16)
_MOST_REPEATS = 100
_MOST_AT_ONCE = 32  # samples of one reader before the next reader's turn
_TURN_S = 1.0  # longest wait for a sample
_LEAST_DEPTH, _ROOM = 2, 2.0  # a new reader misses samples, so one is made where twice the bytes would be held
_NOTHING = 401  # RCL_RET_SUBSCRIPTION_TAKE_FAILED


class Sample(NamedTuple):
    """One sample, serialized, with the GUID of its writer and its number there."""

    data: bytes
    writer: bytes
    sequence: int


class ReadingThread:
    """Takes the samples of any number of `RawReader`; their functions are called in this thread.

    Parameters
    ----------
    clock : monotonic clock (s)
    """

    def __init__(self, *, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        # When it last finished a sample or a wait. A function may write, and a write onto a full link blocks for long,
        # so the watchdog's time runs for one sample alone.
        self.finished_s = clock()
        self._rcl = rcl()
        self._buffer, self._info = self._rcl.buffer(), MessageInfo()
        self._arguments = ctypes.byref(self._buffer), ctypes.byref(self._info)
        self._readers: dict[int, RawReader] = {}  # by the event that the middleware writes
        self._retired: deque[int] = deque()  # events of nobody; this thread may still be about to read one
        self._events = select.epoll()
        self._stop = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._events.register(self._stop, select.EPOLLIN)
        self._thread = threading.Thread(target=self._run, name="arpd-reading", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End the thread; samples that wait are dropped."""
        os.eventfd_write(self._stop, 1)
        self._thread.join(timeout=2.0)
        self._close_retired()
        self._events.close()
        os.close(self._stop)

    def watch(self, reader: RawReader) -> int:
        """Take a reader's samples from now on; return its event, for `unwatch`."""
        event = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._readers[event] = reader
        self._events.register(event, select.EPOLLIN)
        with reader.handle:
            self._rcl.notify(reader.handle.pointer, self._rcl.eventfd_write, event)
        return event

    def unwatch(self, reader: RawReader, event: int) -> None:
        """Take them no more; one may still be delivered meanwhile."""
        with reader.handle:
            self._rcl.notify(reader.handle.pointer, None, None)
        del self._readers[event]
        self._events.unregister(event)
        # Closed here, its number could be a socket's before the thread reads it, and the thread would wait there.
        self._retired.append(event)

    def _close_retired(self) -> None:
        while self._retired:
            os.close(self._retired.popleft())

    def _run(self) -> None:
        unfinished: set[int] = set()  # readers with more samples than one turn takes
        while True:
            self._close_retired()
            ready = {event for event, _ in self._events.poll(0 if unfinished else _TURN_S)}
            self.finished_s = self._clock()
            if self._stop in ready:
                return
            for event in ready | unfinished:
                unfinished.discard(event)
                try:
                    if event in ready:
                        os.eventfd_read(event)  # before the samples are taken: later ones set it again
                    reader = self._readers.get(event)
                    if reader is not None and not self._read(reader):
                        unfinished.add(event)
                except (InvalidHandle, OSError):
                    continue  # just destroyed
                except Exception:
                    log.exception("a sample of %s failed; the next one follows", reader.topic if reader else "a topic")
                    unfinished.add(event)

    def _read(self, reader: RawReader) -> bool:
        """Take some samples; return whether that was all."""
        info, buffer = self._info, self._buffer
        for _ in range(_MOST_AT_ONCE):
            with reader.handle:
                result = self._rcl.take(reader.handle.pointer, *self._arguments, None)
            if result != 0:
                if result != _NOTHING:
                    self._rcl.forget_error()
                return True
            sample = Sample(
                ctypes.string_at(buffer.buffer, buffer.length),
                bytes(info.publisher_gid),
                info.publication_sequence_number,
            )
            if reader.is_new(sample):
                reader.deliver(sample)
                if not reader.has_room_for(sample):
                    return True
            elif reader.is_stuck:
                reader.renew()
                return True
            self.finished_s = self._clock()
        return False


class RawReader:
    """A reader of one topic whose samples a `ReadingThread` takes.

    Parameters
    ----------
    node : node it belongs to
    msg_type : message class; no message is decoded
    topic : fully qualified topic name
    qos : its QoS
    deliver : called with every sample, in the thread
    thread : takes the samples
    most_bytes : what may wait for the thread; a reader whose samples turn out too large for that gets a smaller depth
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
        most_bytes: int | None = None,
    ) -> None:
        self.topic = topic
        self.deliver = deliver
        self._node, self._msg_type, self._qos = node, msg_type, qos
        self._thread = thread
        self._most_bytes = most_bytes
        self._lock = threading.Lock()
        self._is_destroyed = False
        self._last = (b"", 0)  # writer and number of the newest sample
        self._repeats = 0
        check_for_type_support(msg_type)
        self._make()

    def destroy(self) -> None:
        """Destroy the reader; a sample may still be delivered while this is called."""
        with self._lock:
            self._is_destroyed = True
            self._unmake()

    def is_new(self, sample: Sample) -> bool:
        """Return whether this is a sample, and another one than the last."""
        is_one = len(sample.data) >= _LEAST_BYTES and sample.writer != _NOBODY
        if is_one and (sample.writer, sample.sequence) != self._last:
            self._last, self._repeats = (sample.writer, sample.sequence), 0
            return True
        self._repeats += 1
        return False

    @property
    def is_stuck(self) -> bool:
        """True when it gives the same sample, or none, again and again.

        Seen once, in a bench that kills the writers of large samples on a lossy link: Fast DDS gave 1.6 million samples
        of /points that were none, as fast as they were taken.
        """
        return self._repeats > _MOST_REPEATS

    def has_room_for(self, sample: Sample) -> bool:
        """Return whether its depth of such samples is within bounds; if not, begin again with a smaller one."""
        depth = self._qos.depth
        if self._most_bytes is None or depth <= _LEAST_DEPTH or len(sample.data) * depth <= _ROOM * self._most_bytes:
            return True
        self._qos.depth = max(_LEAST_DEPTH, self._most_bytes // len(sample.data))
        self._begin_again()
        return False

    def renew(self) -> None:
        """Begin again with a new reader; only for the thread that takes its samples."""
        log.warning("%s gives one sample again and again; a new reader takes its place", self.topic)
        self._repeats = 0
        self._begin_again()

    def _begin_again(self) -> None:
        with self._lock:
            if not self._is_destroyed:
                self._unmake()
                self._make()

    def _make(self) -> None:
        with self._node.handle:
            # Not by Node.create_subscription: an executor would take the samples.
            self.handle = rclpy_implementation.Subscription(
                self._node.handle, self._msg_type, self.topic, self._qos.get_c_qos_profile()
            )
        self._event = self._thread.watch(self)

    def _unmake(self) -> None:
        self._thread.unwatch(self, self._event)
        self.handle.destroy_when_not_in_use()
