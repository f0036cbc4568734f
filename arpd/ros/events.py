"""QoS events of a publisher or a subscription, as the middleware counts them."""

from __future__ import annotations

from typing import Any

from rclpy.event_handler import PublisherEventCallbacks, UnsupportedEventTypeError
from rclpy.impl.implementation_singleton import rclpy_implementation

EventHandle = rclpy_implementation.EventHandle
InvalidHandle = rclpy_implementation.InvalidHandle  # what a destroyed node or endpoint raises


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
            event_handle = EventHandle(handle, event)
    except UnsupportedEventTypeError:
        return None
    with event_handle:
        status = event_handle.take_event()
    event_handle.destroy_when_not_in_use()
    return status
