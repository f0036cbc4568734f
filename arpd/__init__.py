"""Keeps the wireless traffic of a ROS 2 robot inside what its link can carry, by re-tuning live publishers.

A robot's nodes import AdaptivePublisher from here; it needs only the standard library and packages of ROS 2.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from arpd.endpoint.publisher import AdaptivePublisher

__all__ = ["AdaptivePublisher", "__version__"]

# The only place; pyproject.toml reads it. A constant, because nodes reach this package without its metadata.
__version__ = "0.1.0"


def __getattr__(name: str) -> Any:
    """Import AdaptivePublisher on first use, so that `import arpd` is fast and works without ROS.

    Raises
    ------
    ImportError
        If this Python is too old or has no ROS 2; the message says what to do.
    """
    if name != "AdaptivePublisher":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    if sys.version_info < (3, 11):  # noqa: UP036 - no pip has checked it where the package is reached through a link
        version = "{}.{}".format(*sys.version_info)
        raise ImportError(f"arpd.{name} needs Python 3.11 or newer; {sys.executable} is Python {version}", name="arpd")
    try:
        from arpd.endpoint.publisher import AdaptivePublisher  # noqa: PLC0415 - the reason is above
    except ImportError as error:
        missing = (error.name or "").partition(".")[0]
        if missing in {"", "arpd"}:  # a fault of arpd itself
            raise
        raise ImportError(f"arpd.{name} {_needs(missing, error)}", name=error.name) from None
    return AdaptivePublisher


def _needs(package: str, error: ImportError) -> str:
    """Say what AdaptivePublisher lacks here, and what to do about it.

    Parameters
    ----------
    package : the one that is missing, or that this Python cannot load
    error : why
    """
    from importlib.util import find_spec  # noqa: PLC0415 - slow, and only needed for the message

    python = sys.executable
    if find_spec(package):
        why = " ".join(str(error).split())
        way_out = "source /opt/ros/jazzy/setup.bash, and use the Python of that ROS (Ubuntu 24.04: /usr/bin/python3)"
        return f"cannot load {package} into {python} ({why}); {way_out}"
    if package == "rclpy" or not find_spec("rclpy"):
        way_out = "first run: source /opt/ros/jazzy/setup.bash"
    elif package.endswith(("_interfaces", "_msgs")):
        way_out = f"run: sudo apt install ros-jazzy-{package.replace('_', '-')}"
    else:
        way_out = "ROS 2 needs it: use /usr/bin/python3, or a virtual environment with --system-site-packages"
    return f"needs {package}, which {python} does not find; {way_out}"
