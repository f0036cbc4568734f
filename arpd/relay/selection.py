"""Selection of what the relay with two ends may carry, from the patterns of the configuration."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from arpd.model.names import compile_patterns, is_hidden, is_internal

if TYPE_CHECKING:
    import re

    from arpd.model.settings import RelaySettings

_ACTION_PART = "/_action/"
_ACTION_TOPICS = frozenset({"feedback", "status"})
_ACTION_SERVICES = frozenset({"send_goal", "cancel_goal", "get_result"})


@dataclass(frozen=True, kw_only=True, slots=True)
class Selection:
    """Names that may cross the link; all are those on the robot.

    An action of `relay.actions` crosses whole: its three services and its two topics, in both directions. No other name
    crosses that is hidden (a level begins with an underscore), and nothing of ROS or arpd itself. What `relay.deny`
    matches never crosses; for an action it is enough that `deny` matches the action.
    """

    _to_base: re.Pattern[str]
    _to_robot: re.Pattern[str]
    _deny: re.Pattern[str]
    _services: re.Pattern[str]
    _actions: re.Pattern[str]

    @classmethod
    def of(cls, settings: RelaySettings) -> Selection:
        """Return the selection that the settings ask for."""
        return cls(
            _to_base=compile_patterns(settings.to_base),
            _to_robot=compile_patterns(settings.to_robot),
            _deny=compile_patterns(settings.deny),
            _services=compile_patterns(settings.services),
            _actions=compile_patterns(settings.actions),
        )

    def to_base(self, name: str) -> bool:
        """Return whether the topic may cross from the robot to the base computer."""
        return self._is_carried(name, self._to_base)

    def to_robot(self, name: str) -> bool:
        """Return whether the topic may cross from the base computer to the robot."""
        return self._is_carried(name, self._to_robot)

    def may_call(self, name: str) -> bool:
        """Return whether the service may be called across the link, from either side."""
        return self._is_allowed(name, self._services, of_actions=_ACTION_SERVICES)

    def _is_carried(self, topic: str, allowed: re.Pattern[str]) -> bool:
        return self._is_allowed(topic, allowed, of_actions=_ACTION_TOPICS)

    def _is_allowed(self, name: str, allowed: re.Pattern[str], *, of_actions: frozenset[str]) -> bool:
        if is_internal(name) or self._deny.fullmatch(name):
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


def far_name(name: str, namespace: str) -> str:
    """Return the name on the base computer of what has this name on the robot.

    Parameters
    ----------
    namespace : ``relay.namespace``, empty = none
    """
    return namespace + name


def robot_name(name: str, namespace: str) -> str | None:
    """Return the name on the robot of what has this name on the base computer, None if it lies outside the namespace.

    Parameters
    ----------
    namespace : ``relay.namespace``, empty = none
    """
    return name.removeprefix(namespace) if name.startswith(f"{namespace}/") else None
