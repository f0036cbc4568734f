"""Keeps the wireless traffic of a ROS 2 robot inside what its link can carry, by re-tuning live publishers."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from arpd.adapters.ros.publisher import AdaptivePublisher
    from arpd.adapters.ros.subscription import AdaptiveSubscription

    __version__: str

__all__ = ["AdaptivePublisher", "AdaptiveSubscription", "__version__"]


def __getattr__(name: str) -> Any:
    """Import on first use: `import arpd` then works without ROS, and does not wait for the version, which is slow."""
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
