"""The middleware that ROS runs on here, and the actions arpd may take on it."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from arpd.model.endpoints import Refusal, RefusalReason

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

# Both are Fast DDS: its profile shortens heartbeats, its GUIDs name hosts, and its readers number samples.
_FAST_DDS = ("rmw_fastrtps_cpp", "rmw_fastrtps_dynamic_cpp")


@dataclass(frozen=True, kw_only=True, slots=True)
class Rmw:
    """A middleware, with its measured abilities.

    Parameters
    ----------
    name : its identifier, as in RMW_IMPLEMENTATION
    can_swap : whether writers and readers may be replaced live: acknowledgements come quickly, and samples have
        sequence numbers that show duplicates
    tells_hosts : whether bytes 2 and 3 of an endpoint's GID name its host. Under DDS Security they do not: bytes 0 to 5
        are a hash of the certificate's subject, the enclave
    can_ignore_itself : whether a profile keeps the endpoints of one participant from matching, as two ends need
    """

    name: str
    can_swap: bool
    tells_hosts: bool
    can_ignore_itself: bool

    @property
    def refusal(self) -> str:
        """Reason why depth and deadline are never changed; empty if they are."""
        if self.can_swap:
            return ""
        return f"{self.name} is only paced: QoS swaps were measured on Fast DDS alone"


def rmw_of(name: str) -> Rmw:
    """Return a middleware by its identifier; one that was never measured has no abilities."""
    is_fast_dds = name in _FAST_DDS
    return Rmw(name=name, can_swap=is_fast_dds, tells_hosts=is_fast_dds, can_ignore_itself=is_fast_dds)


def lasting_refusal(rmw: Rmw, *, latched: str) -> Refusal | None:
    """Return the reason why an endpoint is never replaced, None if it may be.

    Parameters
    ----------
    latched : reason against replacing a TRANSIENT_LOCAL endpoint, in words; empty if it is none
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
    identifier : returns its name
    environ : environment in which ROS 2 finds whether SROS 2 is on
    """
    rmw = rmw_of(identifier())
    return replace(rmw, tells_hosts=rmw.tells_hosts and environ.get("ROS_SECURITY_ENABLE") != "true")
