"""The ways in which the robot publishes: with plain rclpy, or under a daemon."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True, slots=True)
class Manner:
    """The settings of the nodes of one run.

    Parameters
    ----------
    is_managed : a daemon governs the robot, with a peer and a relay
    has_two_ends : the relay has an end on each side, so that every topic keeps its name, and every node is a plain one
    """

    is_managed: bool = False
    has_two_ends: bool = False


RCLPY_DEFAULTS = Manner()
WITH_ARPD = Manner(is_managed=True)
WITH_TWO_ENDS = Manner(is_managed=True, has_two_ends=True)
