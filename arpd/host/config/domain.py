"""ROS domain of this computer's own nodes, which the relay's link domain must not be."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping


def local_domain(environment: Mapping[str, str] = os.environ) -> int | None:
    """Return the domain that rcl takes from the environment; None if ROS_DOMAIN_ID is no number, which rcl refuses."""
    try:
        return int(environment.get("ROS_DOMAIN_ID") or "0", base=0)
    except ValueError:
        return None


def shared_domain(link_domain: int | None, local: int | None) -> str | None:
    """Return what is wrong if the link domain is the domain of this computer's own nodes.

    Parameters
    ----------
    link_domain : ``relay.link_domain``
    local : what `local_domain` returns on this host
    """
    if link_domain is None or link_domain != local:
        return None
    return f"{link_domain} is the domain of this computer's own nodes (ROS_DOMAIN_ID); choose another"
