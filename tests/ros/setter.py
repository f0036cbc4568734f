"""Sets parameters of a node from outside, as `ros2 param set` and `arpd run` do."""

import time

from rcl_interfaces.srv import SetParametersAtomically
from rclpy.parameter import Parameter

_OWN = ("rate", "min_rate", "weight", "wire_bytes", "packets")


class Setter:
    """Atomic parameter calls to one node, with short names for the settings of one publisher or subscription."""

    def __init__(self, node, target, topic, kind="publisher"):
        self._client = node.create_client(SetParametersAtomically, f"{target}/set_parameters_atomically")
        assert self._client.wait_for_service(timeout_sec=10)
        own = "arpd" if kind == "publisher" else "arpd.readers"
        self._names = {
            "depth": f"qos_overrides.{topic}.{kind}.depth",
            "deadline": f"qos_overrides.{topic}.{kind}.deadline",
            **{name: f"arpd.{topic}.publisher.{name}" for name in _OWN},
            "generation": f"{own}.generation",
            "lease": f"{own}.lease",
        }

    def call(self, **values):
        """Begin a call; return its future."""
        parameters = [Parameter(self._names[key], value=value).to_parameter_msg() for key, value in values.items()]
        return self._client.call_async(SetParametersAtomically.Request(parameters=parameters))

    def __call__(self, **values):
        """Call, and return the result."""
        future = self.call(**values)
        until_s = time.monotonic() + 10
        while not future.done() and time.monotonic() < until_s:
            time.sleep(0.005)
        return future.result().result
