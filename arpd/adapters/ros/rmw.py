"""Which middleware ROS runs on here, and what arpd may do with it."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from arpd.model.endpoints import Refusal, RefusalReason

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

# Both are Fast DDS: its profile shortens heartbeats, its GUIDs tell hosts apart, its readers number samples.
_FAST_DDS = ("rmw_fastrtps_cpp", "rmw_fastrtps_dynamic_cpp")


@dataclass(frozen=True, kw_only=True, slots=True)
class Rmw:
    """A middleware and what was measured of it.

    Parameters
    ----------
    name : its identifier, as in RMW_IMPLEMENTATION
    can_swap : whether writers and readers may be replaced live: acknowledgements come fast enough to wait for them,
        and samples carry the sequence number that tells doubles apart
    tells_hosts : whether an endpoint's GID carries its host in bytes 2-3 . Not under DDS Security: there
        Fast DDS puts a hash of the certificate's subject, the enclave, into bytes 0-5
    """

    name: str
    can_swap: bool
    tells_hosts: bool

    @property
    def refusal(self) -> str:
        """Why depth and deadline stay as they are, empty when they need not."""
        if self.can_swap:
            return ""
        return f"{self.name} is paced and gated only: QoS swaps were measured on Fast DDS alone"


def rmw_of(name: str) -> Rmw:
    """Return what is known of a middleware, by its identifier; nothing is assumed of one that was never measured."""
    is_fast_dds = name in _FAST_DDS
    return Rmw(name=name, can_swap=is_fast_dds, tells_hosts=is_fast_dds)


def lasting_refusal(rmw: Rmw, *, latched: str) -> Refusal | None:
    """Return why an endpoint is never replaced, None if it is.

    Parameters
    ----------
    latched : what is wrong with replacing a TRANSIENT_LOCAL endpoint, in words; empty if it is none
    """
    if rmw.refusal:
        return Refusal(RefusalReason.MIDDLEWARE, rmw.refusal)
    return Refusal(RefusalReason.TRANSIENT_LOCAL, latched) if latched else None


def _identifier() -> str:
    from rclpy.utilities import get_rmw_implementation_identifier  # noqa: PLC0415 - this module works without ROS

    return str(get_rmw_implementation_identifier())


def current_rmw(identifier: Callable[[], str] = _identifier, *, environ: Mapping[str, str] = os.environ) -> Rmw:
    """Return the middleware of this process.

    Parameters
    ----------
    identifier : asks ROS for its name
    environ : where ROS 2 reads whether SROS 2 is on
    """
    rmw = rmw_of(identifier())
    return replace(rmw, tells_hosts=rmw.tells_hosts and environ.get("ROS_SECURITY_ENABLE") != "true")
