"""One rclpy publisher behind the `arpd.model.endpoints.Writer` protocol."""

from __future__ import annotations

from contextlib import suppress
from copy import copy
from typing import TYPE_CHECKING, Any

from rcl_interfaces.msg import ParameterDescriptor
from rclpy.duration import Duration
from rclpy.event_handler import PublisherEventCallbacks, QoSPublisherEventType
from rclpy.executors import await_or_execute
from rclpy.parameter import Parameter
from rclpy.qos import QoSPolicyKind, QoSProfile, QoSReliabilityPolicy, qos_policy_name_from_kind
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.serialization import serialize_message

from arpd.model.endpoints import SwapResult, WriterQos
from arpd.ros.graph import Requests, period_ns
from arpd.ros.plan_message import checked
from arpd.ros.rcl import InvalidHandle, Outlet, status_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from rclpy.node import Node

_EVENTS = ("deadline", "liveliness", "incompatible_qos", "incompatible_type", "matched")


class RosWriter:
    """One of the writers behind an AdaptivePublisher.

    Parameters
    ----------
    create : makes the rclpy publisher, given its ``event_callbacks``
    event_callbacks : the application's own; called only while samples leave by this writer, so that the application
        does not notice when there are two
    requests : what the readers of its topic request
    in_force : returns the writer by which samples leave, None while the first one is made

    Attributes
    ----------
    publish : writes one serialized sample
    publish_late : does so also after the context has been shut down
    is_acknowledged : returns whether every sample written was acknowledged
    """

    def __init__(
        self,
        node: Node,
        create: Callable[..., Any],
        event_callbacks: PublisherEventCallbacks | None,
        *,
        requests: Requests,
        in_force: Callable[[], RosWriter | None],
    ) -> None:
        self._node = node
        self._requests = requests
        self._in_force = in_force
        self._missed = 0  # deadlines; Fast DDS counts them from the first sample on
        self._hears_of_deadlines = getattr(event_callbacks, "deadline", None) is not None
        self.refused_policy = ""  # by the reader that refused last
        self.publisher = create(event_callbacks=self._filtered(event_callbacks))
        outlet = Outlet(self.publisher.handle)  # rclpy would hold the interpreter while the link is full
        self.publish, self.publish_late = outlet.publish, outlet.publish_late
        self.is_acknowledged = outlet.is_acknowledged
        self.deadline_ns = period_ns(self.publisher.qos_profile.deadline)

    def matched(self) -> int:
        """Count the matched readers."""
        return int(self.publisher.get_subscription_count())

    def readers_acknowledge(self) -> bool:
        """Return whether the readers acknowledge what arrives."""
        is_reliable = self.publisher.qos_profile.reliability != QoSReliabilityPolicy.BEST_EFFORT
        return is_reliable and self._requests.are_reliable()

    def disconnects_readers(self) -> bool:
        """Return whether readers that the writer in force serves have refused this one."""
        now = self._in_force() or self
        return self.refusals() > 0 and bool(self._requests.lost(now.deadline_ns, self.deadline_ns))

    def refusals(self) -> int:
        """Count the readers that refused this writer's QoS since it was made, also those that another writer serves."""
        status = status_of(self.publisher, QoSPublisherEventType.RCL_PUBLISHER_OFFERED_INCOMPATIBLE_QOS)
        if status is None:
            return 0  # not counted here: such a reader shows when matching times out
        self.refused_policy = str(qos_policy_name_from_kind(status.last_policy_kind))
        return int(status.total_count)

    def deadlines_missed(self) -> int:
        """Count the offered deadlines missed since it was made; a destroyed writer keeps its last known count."""
        if self.deadline_ns and not self._hears_of_deadlines:
            with suppress(InvalidHandle):
                status = status_of(self.publisher, QoSPublisherEventType.RCL_PUBLISHER_OFFERED_DEADLINE_MISSED)
                self._missed = self._missed if status is None else int(status.total_count)
        return self._missed

    def destroy(self) -> None:
        """Destroy the writer."""
        self._node.destroy_publisher(self.publisher)

    def _filtered(self, callbacks: PublisherEventCallbacks | None) -> PublisherEventCallbacks:
        # No default callbacks: the executor would check each of them in every turn, only to log a warning.
        filtered = PublisherEventCallbacks(use_default_callbacks=False)
        for name in _EVENTS:
            if (callback := getattr(callbacks, name, None)) is not None:
                setattr(filtered, name, self._passing_on(callback, is_deadline=name == "deadline"))
        return filtered

    def _passing_on(self, callback: Callable[[Any], Any], *, is_deadline: bool) -> Callable[[Any], Any]:
        async def pass_on(event: Any) -> None:
            if is_deadline:
                self._missed = int(event.total_count)  # `status_of` would take the event from the application
            if self._in_force() in {self, None}:
                await await_or_execute(callback, event)

        return pass_on


def swap_failure(result: SwapResult, qos: WriterQos, *, requests: Requests, offered_ns: int) -> str:
    """Return in words why a swap to this QoS failed, where the writer that stays offers the deadline ``offered_ns``."""
    if result is SwapResult.FAILED:
        reason = f"the middleware refused a writer with depth {qos.depth} and deadline {qos.deadline_ns} ns"
    elif lost := requests.lost(offered_ns, qos.deadline_ns):
        reason = f"DEADLINE {qos.deadline_ns or 'infinite'} would lose readers ({', '.join(lost)})"
    else:
        reason = f"not all readers matched in time (in the graph: {', '.join(requests.names()) or 'none'})"
    return f"writer swap of {requests.topic} failed: {reason}; the old writer stays"


def serialized(msg: Any, msg_type: Any) -> bytes:
    """Return the bytes of a message, or of one that is serialized already; raises TypeError if it is neither."""
    if isinstance(msg, bytes):
        return msg
    if isinstance(msg, msg_type):
        return bytes(serialize_message(msg))
    raise TypeError(f"Expected {msg_type}, got {type(msg)}")


def qos_of(profile: QoSProfile) -> WriterQos:
    """Return the policies of a profile that a swap changes."""
    return WriterQos(depth=max(1, profile.depth), deadline_ns=period_ns(profile.deadline))


def with_qos(profile: QoSProfile, qos: WriterQos) -> QoSProfile:
    """Return a profile with another depth and deadline; every other policy is the application's."""
    changed = copy(profile)
    changed.depth = qos.depth
    changed.deadline = Duration(nanoseconds=qos.deadline_ns)
    return changed


def overridden(node: Node, topic: str, profile: QoSProfile, options: QoSOverridingOptions | None) -> QoSProfile:
    """Return a profile with the depth and the deadline that the start of the process gives a publisher of this topic.

    A parameter file or ``--ros-args -p`` gives them under ROS 2's standard names (design.ros2.org, "QoS Overrides by
    Parameters"). They are the application's own QoS from then on; their parameters are read-only, as rclpy's are.

    Raises ValueError, which names the parameter, if one is out of bounds.
    """
    own = qos_of(profile)
    found = {}
    suffix = "" if options is None or options.entity_id is None else f"_{options.entity_id}"
    for policy, field, value in (("depth", "depth", own.depth), ("deadline", "deadline_ns", own.deadline_ns)):
        name = f"qos_overrides.{topic}.publisher{suffix}.{policy}"
        if not node.has_parameter(name):  # without a default: a later publisher of the topic may have other QoS
            description = ParameterDescriptor(read_only=True, description=f"{policy} of {topic}")
            node.declare_parameter(name, Parameter.Type.INTEGER, description)
        try:
            found[field] = checked(field, node.get_parameter_or(name, Parameter(name, value=value)).value, own)
        except ValueError as fault:
            raise ValueError(f"{name}: {fault}") from fault
    qos = WriterQos(**found)
    return profile if qos == own else with_qos(profile, qos)


def without_ours(options: QoSOverridingOptions | None) -> QoSOverridingOptions | None:
    """Return the options without depth and deadline, which `overridden` declares."""
    if options is None:
        return None
    kinds = [kind for kind in options.policy_kinds if kind not in {QoSPolicyKind.DEPTH, QoSPolicyKind.DEADLINE}]
    return QoSOverridingOptions(kinds, callback=options.callback, entity_id=options.entity_id)
