"""Keeps a ROS 2 robot's wireless traffic inside what the link can carry, live."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from arpd.adapters.ros.publisher import AdaptivePublisher
    from arpd.adapters.ros.subscription import AdaptiveSubscription

    __version__: str

__all__ = ["AdaptivePublisher", "AdaptiveSubscription", "__version__"]


def __getattr__(name: str) -> Any:
    """Import on first use: what needs ROS, so that `import arpd` works without it, and the version, which is slow."""
    if name == "AdaptivePublisher":
        from arpd.adapters.ros.publisher import AdaptivePublisher  # noqa: PLC0415 - the reason is above

        return AdaptivePublisher
    if name == "AdaptiveSubscription":
        from arpd.adapters.ros.subscription import AdaptiveSubscription  # noqa: PLC0415 - the same

        return AdaptiveSubscription
    if name == "__version__":
        from importlib import metadata  # noqa: PLC0415 - the same

        return metadata.version("arpd")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
