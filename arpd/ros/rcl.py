"""Functions of rcl that rclpy does not offer, offers only with the interpreter held, or offers at a price."""

from __future__ import annotations

import ctypes
from functools import cache
from typing import TYPE_CHECKING, Any

from rclpy.event_handler import PublisherEventCallbacks, UnsupportedEventTypeError
from rclpy.impl.implementation_singleton import rclpy_implementation

if TYPE_CHECKING:
    from collections.abc import Callable

InvalidHandle = rclpy_implementation.InvalidHandle  # what a destroyed node or endpoint raises


class Allocator(ctypes.Structure):
    """rcutils_allocator_t."""

    _fields_ = (
        ("allocate", ctypes.c_void_p),
        ("deallocate", ctypes.c_void_p),
        ("reallocate", ctypes.c_void_p),
        ("zero_allocate", ctypes.c_void_p),
        ("state", ctypes.c_void_p),
    )


class SerializedMessage(ctypes.Structure):
    """rcutils_uint8_array_t of ROS 2 Jazzy."""

    _fields_ = (
        ("buffer", ctypes.c_void_p),
        ("length", ctypes.c_size_t),
        ("capacity", ctypes.c_size_t),
        ("allocator", Allocator),
    )


class _Outgoing(ctypes.Structure):
    """rcutils_uint8_array_t over bytes of Python, which it keeps alive; nobody may write to them."""

    _fields_ = (
        ("buffer", ctypes.c_char_p),  # takes bytes as they are; ctypes.cast would cost as much as the rest of a publish
        ("length", ctypes.c_size_t),
        ("capacity", ctypes.c_size_t),
        ("allocator", Allocator),
    )


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
        self.take = rcl.rcl_take_serialized_message
        self.take.argtypes = [ctypes.c_void_p] * 4
        self.notify_reader = rcl.rcl_subscription_set_on_new_message_callback
        self.notify_server = rcl.rcl_service_set_on_new_request_callback
        self.notify_client = rcl.rcl_client_set_on_new_response_callback
        for notify in (self.notify_reader, self.notify_server, self.notify_client):
            notify.argtypes = [ctypes.c_void_p] * 3
        self.eventfd_write = ctypes.cast(ctypes.CDLL(None).eventfd_write, ctypes.c_void_p)
        self._publish = rcl.rcl_publish_serialized_message
        self._publish.argtypes = [ctypes.c_void_p] * 3
        self._graph_guard = rcl.rcl_node_get_graph_guard_condition
        self._graph_guard.argtypes, self._graph_guard.restype = [ctypes.c_void_p], ctypes.c_void_p
        self._add_guard = rcl.rcl_wait_set_add_guard_condition
        self._add_guard.argtypes = [ctypes.c_void_p] * 3
        self._rmw_publisher = rcl.rcl_publisher_get_rmw_handle
        self._rmw_publisher.argtypes, self._rmw_publisher.restype = [ctypes.c_void_p], ctypes.c_void_p
        self._gid = rcl.rmw_get_gid_for_publisher
        self._gid.argtypes = [ctypes.c_void_p] * 2
        self.forget_error = rcutils.rcutils_reset_error
        self._error = rcutils.rcutils_get_error_string
        self._error.restype = _ErrorString
        self._init = rcutils.rcutils_uint8_array_init
        self._init.argtypes = [ctypes.c_void_p, ctypes.c_size_t, ctypes.c_void_p]
        self._allocator = rcutils.rcutils_get_default_allocator
        self._allocator.restype = Allocator

    def buffer(self) -> SerializedMessage:
        """Return an empty buffer, which rcl enlarges as needed."""
        held, allocator = SerializedMessage(), self._allocator()
        if self._init(ctypes.byref(held), 2048, ctypes.byref(allocator)) != 0:
            raise MemoryError("rcutils_uint8_array_init")
        return held

    def outlet(self, handle: Any) -> Outlet:
        """Return what publishes serialized samples through a publisher's handle."""
        return Outlet(handle, self._publish, self.error)

    def add_graph_guard(self, node: int, wait_set: int) -> None:
        """Let a wait set wait for changes of the graph that a node sees; both are pointers."""
        self._add_guard(wait_set, self._graph_guard(node), None)

    def gid_of(self, handle: Any) -> bytes:
        """Return the GUID of a publisher."""
        gid = _Gid()
        with handle:
            if self._gid(self._rmw_publisher(handle.pointer), ctypes.byref(gid)) != 0:
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

    Parameters
    ----------
    handle : of the publisher
    publish : ``rcl_publish_serialized_message``
    error : returns the words of its error
    """

    __slots__ = ("_error", "_handle", "_message", "_pointer", "_publish", "_reference")

    def __init__(self, handle: Any, publish: Callable[..., int], error: Callable[[], str]) -> None:
        self._handle = handle
        self._pointer = handle.pointer
        self._publish = publish
        self._error = error
        self._message = _Outgoing()
        self._reference = ctypes.byref(self._message)

    def publish(self, sample: bytes) -> None:
        """Publish a serialized sample; blocks while the link's queue is full.

        Raises
        ------
        RuntimeError
            If rcl refuses it.
        """
        message = self._message
        message.buffer = sample
        message.length = message.capacity = len(sample)
        with self._handle:
            fault = self._publish(self._pointer, self._reference, None)
        message.buffer = None  # a sample may be large
        if fault:
            raise RuntimeError(f"publishing failed: {self._error()}")


@cache
def rcl() -> Rcl:
    """Return the functions, loaded on first use: ROS may be missing."""
    return Rcl()


def no_publisher_events() -> PublisherEventCallbacks:
    """Return callbacks of a publisher without rclpy's defaults.

    Each default is a waitable that the node's executor checks in every turn, only to log a warning. With those of four
    publishers and four subscriptions a turn took 139 µs, without them 85 µs.
    """
    return PublisherEventCallbacks(use_default_callbacks=False)


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
