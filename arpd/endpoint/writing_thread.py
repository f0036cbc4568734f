"""The one thread of a participant that writes what waits in its paced queue, and serves who asked for a turn."""

from __future__ import annotations

import atexit
import math
import threading
import time
from collections import deque
from contextlib import suppress
from functools import partial
from typing import TYPE_CHECKING, Protocol, TypeVar

from arpd.endpoint.lane import SMALL_BYTES, Lane
from arpd.endpoint.queue import SOON_S, PacedQueue
from arpd.ros.rate_limits import OncePerMinute
from arpd.ros.rcl import InvalidHandle

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable

    from arpd.model.plan import TopicPlan
    from arpd.model.price import Price

_RETRY_S = 0.1
_IDLE_S = 1.0  # most between two turns, for the watchdog
_LAST_S = 2.0  # that a link may take for the last samples
_HEARD_S = 0.3  # that their readers may take to acknowledge them: six heartbeats of arpd's profile
_BLOCKED_S = 0.05  # a scheduler takes less
_SHUN = 20.0  # times the duration of the write, so that writes block a caller for a twentieth of its time at most

T = TypeVar("T")


class Turn(Protocol):
    """Who wants to be called now and then, for a topic."""

    topic_name: str

    def service(self, now_s: float) -> float:
        """Do what is due; return when to call again, ``inf`` = not before `WritingThread.wake` (s)."""

    def finish(self) -> None:
        """Write what waits, at the end of the thread."""


class WritingThread:
    """Serves a paced queue; a thread that publishes may write at once what need not wait.

    A lane that a thread writes to is claimed, so that its samples leave in order and no other topic waits for it here.
    Writers of one participant still wait for each other inside Fast DDS while the socket is full.

    Parameters
    ----------
    warn : says a fault of a topic, each once a minute
    is_alive : returns False once its participant is gone, which ends the thread
    clock : monotonic clock (s)
    """

    def __init__(
        self,
        queue: PacedQueue,
        *,
        name: str,
        warn: Callable[[str], object],
        is_alive: Callable[[], bool] = lambda: True,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._queue = queue
        self._warn, self._logged = warn, OncePerMinute()
        self._is_alive = is_alive
        self._clock = clock
        self._lock = threading.RLock()  # guards all of these
        self._changed = threading.Condition(self._lock)  # the thread waits
        self._freed = threading.Condition(self._lock)  # others wait for a lane that is claimed
        self._waiters = 0
        self._turns: dict[Turn, float] = {}  # when they are due
        self._denied: dict[Lane, Turn] = {}  # of lanes that are claimed
        self._is_deciding = False
        self._late: deque[Callable[[], object]] = deque()
        self._is_stopping = False
        self._has_ended = False  # and written what waited: nobody paces what comes still
        self._next_s = 0.0  # when the thread wakes
        self._shunned_until_s = -math.inf  # until then only this thread writes, apart from `publish`
        self._ending_s = -math.inf  # when the first of those that end now began to wait
        self.finished_s = clock()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    def start(self) -> None:
        """Begin to write, until the process ends at the latest: after a signal nobody else may call `stop`."""
        self._thread.start()
        atexit.register(self.stop)

    def stop(self) -> None:
        """End the thread, which lets those finish that want turns, if the link takes what waits there."""
        if not self._thread.is_alive():
            return  # in a forked process nobody would ever release the lock
        with self._lock:
            self._is_stopping = True
            self._changed.notify()
        if threading.current_thread() is not self._thread:
            self._thread.join(timeout=_LAST_S)

    def add(self, lane: Lane) -> None:
        """Serve a lane from now on."""
        with self._lock:
            self._decide(partial(self._queue.add, lane))

    def remove(self, lane: Lane) -> None:
        """Serve it no more, after a write to it has ended; who publishes from now on gets InvalidHandle."""
        with self._lock:
            lane.is_closing = True  # a thread that publishes again and again would take it each time before this one
            self._wait_for(lane)
            self._decide(partial(self._queue.remove, lane))

    def rest_of(self, lane: Lane) -> list[bytes]:
        """Take all that waits of a lane, which is claimed from then on, after a write to it has ended.

        Raises RuntimeError where the caller has interrupted a change of the queue.
        """
        with self._lock:
            if self._is_deciding:
                raise RuntimeError("the queue is changing")
            self._wait_for(lane)
            lane.claimant = threading.get_ident()
            return self._decide(partial(self._queue.rest_of, lane, self._clock())) or []

    def heard_by_s(self) -> float:
        """Return until when a topic that ends may wait for its readers; all that end at once have one such time (s)."""
        if (now_s := time.monotonic()) > self._ending_s + _LAST_S:
            self._ending_s = now_s
        return self._ending_s + _HEARD_S

    @property
    def topics(self) -> int:
        """Count the lanes."""
        return len(self._queue)

    def retune(self, lane: Lane, plan: TopicPlan, price: Price | None) -> None:
        """Give a lane its plan and the price; None = no daemon is there."""
        with self._lock:
            self._queue.retune(lane, plan, price)
            if self._queue.is_waiting:  # a price comes for a thousand lanes: the thread looks once what that changes
                self._wake(0.0)

    def offer(self, lane: Lane, message: bytes, *, source: Hashable = None, lifespan_ns: int = 0) -> None:
        """Let a message of a writer with this LIFESPAN wait for its turn; 0 = infinite (ns)."""
        now_s = self._clock()
        expires_s = now_s + lifespan_ns / 1e9 if lifespan_ns else math.inf
        with self._lock:
            _require_open(lane)
            self._decide(partial(self._queue.offer, lane, message, now_s, source=source, expires_s=expires_s))
            self._wake_for_queue()

    def publish(self, lane: Lane, message: bytes) -> None:
        """Write a message in this thread if it may leave now, after the one that another thread is writing.

        A large one is left to the other thread: a full link would hold the caller, and its executor, until it is out.
        """
        if lane.may_conflate(message) and self._thread.is_alive():
            self.offer(lane, message)
            return
        now_s = self._clock()
        with self._lock:
            if lane.claimant is not None:
                self._wait_for(lane)
            sample = self._take(lane, message, now_s)
        if sample is not None:
            self._write(lane, sample)

    def pass_on(self, lane: Lane, message: bytes, source: Hashable = None) -> None:
        """Write a small message in this thread if it may leave now and writes do not block; never wait.

        For a caller that serves many topics. What blocks is left to the other thread.
        """
        now_s = self._clock()
        if len(message) > SMALL_BYTES or now_s < self._shunned_until_s:
            self.offer(lane, message, source=source)
            return
        with self._lock:
            sample = self._take(lane, message, now_s, source)
        if sample is not None and (took_s := self._write(lane, sample)) > _BLOCKED_S:
            self._shunned_until_s = now_s + _SHUN * took_s

    def claim(self, lane: Lane, turn: Turn) -> bool:
        """Return whether the caller may be at a lane's writer now; `release` comes next, or another turn."""
        with self._lock:
            if lane.claimant is not None:
                self._denied[lane] = turn
                return False
            lane.claimant = threading.get_ident()
            return True

    def release(self, lane: Lane) -> None:
        """Let others be at the lane's writer."""
        with self._lock:
            lane.claimant = None
            if self._waiters:
                self._freed.notify_all()
            if self._denied and (turn := self._denied.pop(lane, None)) is not None:
                self.wake(turn)
            self._wake_for_queue()

    def wake(self, turn: Turn) -> None:
        """Serve one who wants a turn at once; for any thread."""
        with self._lock:
            self._decide(partial(self._turns.__setitem__, turn, -math.inf))
            self._wake(0.0)

    def _wait_for(self, lane: Lane) -> None:
        # A signal may call this inside a write, and inside a change, in which nobody else may have the lock.
        self._waiters += 1
        while not self._is_deciding and lane.claimant not in {None, threading.get_ident()}:
            self._freed.wait()
        self._waiters -= 1

    def _decide(self, act: Callable[[], T]) -> T | None:
        """Let the queue or the turns change, now or at the end of the change that is under way in this thread.

        The function of a signal, or a finalizer, may publish in the middle of one.
        """
        if self._is_deciding:
            self._late.append(act)
            return None
        self._is_deciding = True
        try:
            return act()
        finally:
            self._is_deciding = False
            while self._late:
                self._decide(self._late.popleft())
                self._wake(0.0)

    def _take(self, lane: Lane, message: bytes, now_s: float, source: Hashable = None) -> bytes | None:
        """Return what the caller writes now, for which it then has claimed the lane."""
        _require_open(lane)
        if self._is_deciding:
            self._decide(partial(self._queue.offer, lane, message, now_s, source=source))
            return None
        if (sample := self._decide(lambda: self._take_now(lane, message, now_s, source))) is None:
            self._wake_for_queue()
        return sample

    def _take_now(self, lane: Lane, message: bytes, now_s: float, source: Hashable) -> bytes | None:
        sample: bytes | None = message
        if not (self._has_ended or self._queue.admit(lane, message, now_s)):
            self._queue.offer(lane, message, now_s, source=source)
            sample = self._queue.take_of(lane, now_s)
        if sample is not None:
            lane.claimant = threading.get_ident()
        return sample

    def _write(self, lane: Lane, sample: bytes) -> float:
        """Write a sample; return how long that took (s)."""
        before_s = self._clock()
        try:
            lane.write(sample)
        finally:
            took_s = self._clock() - before_s
            lane.blocked_s += took_s
            self.release(lane)
        return took_s

    def _serve(self, turn: Turn) -> None:
        try:
            due_s = turn.service(self._clock())
        except InvalidHandle:
            return  # it has just been destroyed
        except Exception as error:  # noqa: BLE001 - one topic's failure must not stop the others
            self._say(f"{turn.topic_name}: {error}; arpd tries again")
            due_s = self._clock() + _RETRY_S
        with self._lock:
            if due_s < self._turns.get(turn, math.inf):
                self._turns[turn] = due_s

    def _say(self, words: str) -> None:
        # What fails because the participant is gone is no fault, and the thread ends.
        if self._is_alive() and self._logged.take(words, self._clock()):
            self._warn(f"{words} (logged once a minute)")

    def _wake(self, by_s: float) -> None:
        if by_s < self._next_s:
            self._next_s = by_s
            self._changed.notify()

    def _wake_for_queue(self) -> None:
        if self._is_deciding:
            return  # its end wakes the thread
        if self._queue.is_waiting and self._next_s > (now_s := self._clock()) + SOON_S:
            try:
                due_s = self._decide(lambda: self._queue.due_s(now_s)) or 0.0
            except Exception:  # noqa: BLE001 - of any lane; the thread meets it, too, and says it
                due_s = 0.0
            self._wake(due_s)

    def _run(self) -> None:
        while not self._is_stopping and self._is_alive():
            try:
                if (act := self._next()) is not None:
                    act()
            except InvalidHandle:
                continue  # what it was for has just been destroyed
            except Exception as error:  # noqa: BLE001 - as above
                self._say(f"{error}; the next sample follows")
            self.finished_s = self._clock()
        for turn in tuple(self._turns):
            with suppress(RuntimeError):  # RCLError is one
                turn.finish()
        self._has_ended = True
        atexit.unregister(self.stop)

    def _next(self) -> Callable[[], object] | None:
        """Return what to do now; if nothing is due, wait."""
        with self._lock:
            try:
                if (act := self._decide(lambda: self._choose(self._clock()))) is not None:
                    return act
                self.finished_s = self._clock()
                self._decide(self._set_next)
            except Exception:
                self._decide(lambda: self._queue.drop_faulty(self._clock()))
                self._changed.wait(_RETRY_S)  # where it is the fault of no lane
                raise
            if self._next_s > self.finished_s and not self._is_stopping:  # `stop` may have come since
                self._changed.wait(self._next_s - self.finished_s)
            self._next_s = 0.0  # nobody need wake a thread that is awake
            return None

    def _choose(self, now_s: float) -> Callable[[], object] | None:
        """Return what to do now, None if nothing is due."""
        for turn, due_s in self._turns.items():
            if due_s <= now_s:
                del self._turns[turn]
                return partial(self._serve, turn)
        if (ready := self._queue.take(now_s)) is None:
            return None
        ready.lane.claimant = threading.get_ident()
        return partial(self._write, *ready)

    def _set_next(self) -> None:
        self._next_s = min(self.finished_s + _IDLE_S, self._due_s(self.finished_s))

    def _due_s(self, now_s: float) -> float:
        """Return when `_choose` may have something (s)."""
        return min(self._queue.due_s(now_s), *self._turns.values(), math.inf)


def _require_open(lane: Lane) -> None:
    if lane.is_closing:
        raise InvalidHandle("cannot publish because the publisher is destroyed")
