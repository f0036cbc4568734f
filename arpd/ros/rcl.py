"""What rclpy does not offer, of rcl for the most, offers only with the interpreter held, or offers at a price."""

from __future__ import annotations

import ctypes
import threading
from functools import cache
from typing import TYPE_CHECKING, Any, TypeVar

from rclpy.event_handler import PublisherEventCallbacks, UnsupportedEventTypeError
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.publisher import Publisher

if TYPE_CHECKING:
    from collections.abc import Callable

T = TypeVar("T")
_making = threading.RLock()  # of `attached`; what is made may need another one
InvalidHandle = rclpy_implementation.InvalidHandle  # what a destroyed node or endpoint raises
#: Of a publisher. Each of rclpy's default callbacks is a waitable that the node's executor checks in every turn, only
#: to log a warning: with those of four publishers and four subscriptions a turn took 139 µs, without them 85 µs.
NO_EVENTS = PublisherEventCallbacks(use_default_callbacks=False)


class Allocator(ctypes.Structure):
    """rcutils_allocator_t."""

    _fields_ = tuple(
        (name, ctypes.c_void_p) for name in ("allocate", "deallocate", "reallocate", "zero_allocate", "state")
    )


_TIMEOUT = 2  # RMW_RET_TIMEOUT
_REST_OF_ARRAY = (("length", ctypes.c_size_t), ("capacity", ctypes.c_size_t), ("allocator", Allocator))


class SerializedMessage(ctypes.Structure):
    """rcutils_uint8_array_t of ROS 2 Jazzy."""

    _fields_ = (("buffer", ctypes.c_void_p), *_REST_OF_ARRAY)


class _Outgoing(ctypes.Structure):
    """rcutils_uint8_array_t over bytes of Python, which it keeps alive; nobody may write to them."""

    # It takes bytes as they are; ctypes.cast would cost as much as the rest of a publish.
    _fields_ = (("buffer", ctypes.c_char_p), *_REST_OF_ARRAY)


class MessageInfo(ctypes.Structure):
    """rmw_message_info_t of ROS 2 Jazzy."""

    _fields_ = (
        ("source_timestamp", ctypes.c_int64),
        ("received_timestamp", ctypes.c_int64),
        ("publication_sequence_number", ctypes.c_uint64),
        ("reception_sequence_number", ctypes.c_uint64),
        ("implementation_identifier", ctypes.c_char_p),
        ("publisher_gid", ctypes.c_uint8 * 16),
        ("from_intra_process", ctypes.c_bool),
    )


class _Gid(ctypes.Structure):
    """rmw_gid_t of ROS 2 Jazzy."""

    _fields_ = (("implementation_identifier", ctypes.c_char_p), ("data", ctypes.c_uint8 * 16))


class _ErrorString(ctypes.Structure):
    """rcutils_error_string_t."""

    _fields_ = (("text", ctypes.c_char * 1024),)


class Rcl:
    """Functions of rcl and rcutils of ROS 2 Jazzy; they run without the interpreter, so other threads go on."""

    def __init__(self) -> None:
        rcl, rcutils = ctypes.CDLL("librcl.so"), ctypes.CDLL("librcutils.so")  # loaded by rclpy already

        def function(library: Any, name: str, *, takes: int = 0, returns: Any = ctypes.c_int) -> Any:
            found = library[name]
            found.argtypes, found.restype = [ctypes.c_void_p] * takes, returns
            return found

        self.take = function(rcl, "rcl_take_serialized_message", takes=4)
        self.publish = function(rcl, "rcl_publish_serialized_message", takes=3)
        self.publish_late = function(rcl, "rmw_publish_serialized_message", takes=3)
        self.is_acknowledged = function(rcl, "rmw_publisher_wait_for_all_acked", takes=3)  # a time is two numbers
        self.notify_reader = function(rcl, "rcl_subscription_set_on_new_message_callback", takes=3)
        self.notify_server = function(rcl, "rcl_service_set_on_new_request_callback", takes=3)
        self.notify_client = function(rcl, "rcl_client_set_on_new_response_callback", takes=3)
        self.eventfd_write = ctypes.cast(ctypes.CDLL(None).eventfd_write, ctypes.c_void_p)
        self._graph_guard = function(rcl, "rcl_node_get_graph_guard_condition", takes=1, returns=ctypes.c_void_p)
        self._add_guard = function(rcl, "rcl_wait_set_add_guard_condition", takes=3)
        self.rmw_publisher = function(rcl, "rcl_publisher_get_rmw_handle", takes=1, returns=ctypes.c_void_p)
        self._gid = function(rcl, "rmw_get_gid_for_publisher", takes=2)
        self.forget_error = function(rcutils, "rcutils_reset_error", returns=None)
        self._error = function(rcutils, "rcutils_get_error_string", returns=_ErrorString)
        self._init = function(rcutils, "rcutils_uint8_array_init", takes=3)  # a size_t is as wide as a pointer
        self._allocator = function(rcutils, "rcutils_get_default_allocator", returns=Allocator)

    def buffer(self) -> SerializedMessage:
        """Return an empty buffer, which rcl enlarges as needed."""
        held, allocator = SerializedMessage(), self._allocator()
        if self._init(ctypes.byref(held), 2048, ctypes.byref(allocator)) != 0:
            raise MemoryError("rcutils_uint8_array_init")
        return held

    def add_graph_guard(self, node: int, wait_set: int) -> None:
        """Let a wait set wait for changes of the graph that a node sees; both are pointers."""
        self._add_guard(wait_set, self._graph_guard(node), None)

    def gid_of(self, handle: Any) -> bytes:
        """Return the GUID of a publisher."""
        gid = _Gid()
        with handle:
            if self._gid(self.rmw_publisher(handle.pointer), ctypes.byref(gid)) != 0:
                raise RuntimeError(f"a publisher without a GUID: {self.error()}")
        return bytes(gid.data)

    def error(self) -> str:
        """Return the words of the last error of this thread, and forget it."""
        words: str = self._error().text.decode(errors="replace")
        self.forget_error()
        return words


class Outlet:
    """Publishes serialized samples through one publisher's handle, one at a time.

    It keeps what a call needs: a structure per call would cost half as much as the rest of it.
    """

    __slots__ = ("_handle", "_message", "_pointer", "_rcl", "_reference")

    def __init__(self, handle: Any) -> None:
        self._rcl, self._handle, self._pointer = rcl(), handle, handle.pointer
        self._message = _Outgoing()
        self._reference = ctypes.byref(self._message)

    def publish(self, sample: bytes) -> None:
        """Publish a sample; blocks while the link's queue is full, and raises rclpy's RCLError if rcl refuses it."""
        with self._handle:
            self._publish(self._rcl.publish, self._pointer, sample)

    def publish_late(self, sample: bytes) -> None:
        """Publish a sample as `publish` does; rcl would refuse it once its context has been shut down."""
        with self._handle:
            self._publish(self._rcl.publish_late, self._rcl.rmw_publisher(self._pointer), sample)

    def is_acknowledged(self) -> bool:
        """Return whether no sample waits for an acknowledgement, also once the context has been shut down."""
        with self._handle:
            # A longer timeout would block the pacing thread (docs/design.md, DDS facts).
            return bool(self._rcl.is_acknowledged(self._rcl.rmw_publisher(self._pointer), 0, 0) != _TIMEOUT)

    def _publish(self, function: Any, pointer: int, sample: bytes) -> None:
        message = self._message
        message.buffer = sample
        message.length = message.capacity = len(sample)
        fault = function(pointer, self._reference, None)
        message.buffer = None  # a sample may be large
        if fault:
            words = self._rcl.error()
            raise rclpy_implementation.RCLError(f"{self._handle.get_topic_name()}: Failed to publish: {words}")


@cache
def rcl() -> Rcl:
    """Return the functions, loaded on first use: ROS may be missing."""
    return Rcl()


class NotedPublisher(Publisher):
    """A publisher that calls a function before its node destroys it."""

    def __init__(self, note: Callable[[], None], *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self._note = note

    def destroy(self) -> None:
        """Destroy it, as `Publisher.destroy` does."""
        self._note()
        super().destroy()


def is_live(context: Any) -> bool:
    """Return whether a context has not been shut down.

    `Context.ok` would wait for a lock that a shutdown holds while it waits for threads of arpd's.
    """
    try:
        with context.handle:
            return bool(context.handle.ok())
    except InvalidHandle:
        return False


def status_of(endpoint: Any, event: Any) -> Any:
    """Return the middleware's count of an event at an endpoint, None where it does not count it.

    This takes the event, so a callback for it is not called.
    """
    # A new handle each time, 3 µs. It adds no waitable to the executor's turns, and it keeps no endpoint alive after
    # the application destroyed its node.
    handle = endpoint.handle
    try:
        with handle:
            event_handle = rclpy_implementation.EventHandle(handle, event)
    except UnsupportedEventTypeError:
        return None
    with event_handle:
        status = event_handle.take_event()
    event_handle.destroy_when_not_in_use()
    return status


def attached(owner: Any, kind: type[T], make: Callable[[], T]) -> T:
    """Return the object of this kind that a node or a context has, after making it on first use."""
    name = f"_arpd_{kind.__name__}"
    with _making:
        found = getattr(owner, name, None)
        if not isinstance(found, kind):
            found = make()
            setattr(owner, name, found)
    return found
