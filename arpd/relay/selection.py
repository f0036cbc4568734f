"""One end's side: the names there, and which of them may cross the link, from the patterns of the configuration."""

from __future__ import annotations

from typing import TYPE_CHECKING

from arpd.model.names import ROS_TOPICS, compile_patterns, is_hidden, is_internal

if TYPE_CHECKING:
    import re

    from arpd.model.settings import RelaySettings

_ACTION_PART = "/_action/"
_ACTION_TOPICS = frozenset({"feedback", "status"})
_ACTION_SERVICES = frozenset({"send_goal", "cancel_goal", "get_result"})


class Side:
    """The robot's side or the base computer's. On the link and in the configuration all names are those on the robot.

    An action of `relay.actions` crosses whole: its three services and its two topics, in both directions. No other name
    crosses that is hidden (a level begins with an underscore), nothing of arpd itself, and a topic of ROS itself, such
    as /rosout, only where it is named and not just matched. What `relay.deny` matches never crosses; for an action it
    is enough that `deny` matches the action.
    """

    def __init__(self, settings: RelaySettings, *, is_far: bool) -> None:
        self._namespace = settings.namespace if is_far else ""  # of the robot's names on this side
        chosen = settings.deny, settings.services, settings.actions
        self._deny, self._services, self._actions = map(compile_patterns, chosen)
        to_base, to_robot = (
            (compile_patterns(patterns), ROS_TOPICS.intersection(patterns))
            for patterns in (settings.to_base, settings.to_robot)
        )
        self._leaving, self._entering = (to_robot, to_base) if is_far else (to_base, to_robot)

    def local_name(self, name: str) -> str:
        """Return the name on this side of what has this name on the robot; an empty name stays empty."""
        return self._namespace + name if name else name

    def robot_name(self, local: str) -> str | None:
        """Return the name on the robot of what has this name here, None if it lies outside the namespace."""
        return local.removeprefix(self._namespace) if local.startswith(f"{self._namespace}/") else None

    def node_name(self, local: str) -> str:
        """Return the name on the robot of a node here; one outside the namespace has the same there."""
        return self.robot_name(local) or local

    def may_leave(self, name: str) -> bool:
        """Return whether the topic may cross from this side to the other."""
        return self._is_allowed(name, *self._leaving, of_actions=_ACTION_TOPICS)

    def may_enter(self, name: str) -> bool:
        """Return whether the topic may cross from the other side to this one."""
        return self._is_allowed(name, *self._entering, of_actions=_ACTION_TOPICS)

    def may_call(self, name: str) -> bool:
        """Return whether the service may be called across the link, from either side."""
        return self._is_allowed(name, self._services, frozenset(), of_actions=_ACTION_SERVICES)

    def _is_allowed(
        self, name: str, allowed: re.Pattern[str], of_ros: frozenset[str], *, of_actions: frozenset[str]
    ) -> bool:
        if (is_internal(name) and name not in of_ros) or self._deny.fullmatch(name):
            return False
        if not is_hidden(name):
            return allowed.fullmatch(name) is not None
        action, _, part = name.rpartition(_ACTION_PART)
        return (
            part in of_actions
            and not is_hidden(action)
            and self._actions.fullmatch(action) is not None
            and self._deny.fullmatch(action) is None
        )
