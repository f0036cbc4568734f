"""The middleware that ROS runs on here, and the actions arpd may take on it."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

_FAST_DDS = ("rmw_fastrtps_cpp", "rmw_fastrtps_dynamic_cpp")


@dataclass(frozen=True, kw_only=True, slots=True)
class Rmw:
    """A middleware, with its measured abilities.

    Parameters
    ----------
    name : its identifier, as in RMW_IMPLEMENTATION
    is_fast_dds : whether it is the one that was measured: acknowledgements come quickly, readers number samples, so
        that writers may be replaced live, and a profile keeps the endpoints of one participant from matching
    tells_hosts : whether bytes 2 and 3 of an endpoint's GID name its host. Under DDS Security they do not: bytes 0 to 5
        are a hash of the certificate's subject, the enclave
    """

    name: str
    is_fast_dds: bool
    tells_hosts: bool

    @property
    def refusal(self) -> str:
        """Reason why depth and deadline are never changed; empty if they are."""
        return "" if self.is_fast_dds else f"{self.name} is only paced: QoS swaps were measured on Fast DDS alone"


def rmw_of(name: str) -> Rmw:
    """Return a middleware by its identifier; one that was never measured has no abilities."""
    return Rmw(name=name, is_fast_dds=name in _FAST_DDS, tells_hosts=name in _FAST_DDS)


def _identifier() -> str:
    from rclpy.utilities import get_rmw_implementation_identifier  # noqa: PLC0415 - this module works without ROS

    return str(get_rmw_implementation_identifier())


def current_rmw(identifier: Callable[[], str] = _identifier, *, environ: Mapping[str, str] = os.environ) -> Rmw:
    """Return the middleware of this process.

    Parameters
    ----------
    identifier : returns its name
    environ : environment in which ROS 2 finds whether SROS 2 is on
    """
    rmw = rmw_of(identifier())
    return replace(rmw, tells_hosts=rmw.tells_hosts and environ.get("ROS_SECURITY_ENABLE") != "true")
