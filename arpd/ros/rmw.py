"""The middleware that ROS runs on here, and the actions arpd may take on it."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING

from arpd.model.errors import RosUnavailableError
from arpd.model.quantities import printable

if TYPE_CHECKING:
    from collections.abc import Mapping


@dataclass(frozen=True, kw_only=True, slots=True)
class Rmw:
    """A middleware, with its measured abilities; one that was never measured has none.

    Parameters
    ----------
    name : its identifier, as in RMW_IMPLEMENTATION
    is_secured : whether SROS 2 is on
    """

    name: str
    is_secured: bool = False

    @property
    def is_fast_dds(self) -> bool:
        """Whether it is the one that was measured.

        Acknowledgements come quickly and readers number samples, so that writers may be replaced live; and a profile
        keeps the endpoints of one participant from matching.
        """
        return self.name in {"rmw_fastrtps_cpp", "rmw_fastrtps_dynamic_cpp"}

    @property
    def tells_hosts(self) -> bool:
        """Whether bytes 2 and 3 of an endpoint's GID name its host.

        Under DDS Security bytes 0 to 5 are a hash of the certificate's subject, the enclave.
        """
        return self.is_fast_dds and not self.is_secured

    @property
    def refusal(self) -> str:
        """Reason why depth and deadline are never changed; empty if they are."""
        return "" if self.is_fast_dds else f"{self.name} is only paced: QoS swaps were measured on Fast DDS alone"


def chosen_rmw(environment: Mapping[str, str] = os.environ) -> Rmw:
    """Return the middleware that ROS loads in such an environment."""
    return Rmw(name=environment.get("RMW_IMPLEMENTATION") or "rmw_fastrtps_cpp")


def require_middleware(environment: Mapping[str, str] = os.environ) -> None:
    """Raise RosUnavailableError where RMW_IMPLEMENTATION names a middleware that cannot be loaded here.

    rcl would end the process that imports rclpy, so another one tries. The one that every ROS brings needs no try.
    """
    name = chosen_rmw(environment).name
    if name == "rmw_fastrtps_cpp":
        return
    tried = subprocess.run(
        [sys.executable, "-c", "import rclpy.impl.implementation_singleton"], check=False, capture_output=True
    )
    if tried.returncode not in {0, 1}:  # 1: there is no rclpy, which the import tells better
        raise RosUnavailableError(
            f"RMW_IMPLEMENTATION is {printable(name)}, and there is no such middleware here; "
            "unset it, or install its package (ros-jazzy-rmw-…)"
        )


def current_rmw() -> Rmw:
    """Return the middleware of this process."""
    from rclpy.utilities import get_rmw_implementation_identifier  # noqa: PLC0415 - this module works without ROS

    name = str(get_rmw_implementation_identifier())
    return Rmw(name=name, is_secured=os.environ.get("ROS_SECURITY_ENABLE") == "true")
