"""Sets the parameters of one publisher or subscription, as its node does when it is asked to."""

from rclpy.parameter import Parameter

_OWN = ("rate", "min_rate", "weight", "wire_bytes", "packets")


class Setter:
    """Atomic changes, with short names for the settings."""

    def __init__(self, node, topic, kind="publisher"):
        self._node = node
        self._names = {
            "depth": f"qos_overrides.{topic}.{kind}.depth",
            "deadline": f"qos_overrides.{topic}.{kind}.deadline",
            **{name: f"arpd.{topic}.publisher.{name}" for name in _OWN},
        }

    def __call__(self, **values):
        """Set, and return the result."""
        parameters = [Parameter(self._names[key], value=value) for key, value in values.items()]
        return self._node.set_parameters_atomically(parameters)
