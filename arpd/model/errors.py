"""Errors that arpd raises on purpose; each message names the place, the fault and the way out."""

from __future__ import annotations


class ArpdError(Exception):
    """Root of every error that arpd raises on purpose.

    Attributes
    ----------
    exit_code : process exit code when the error ends a command (sysexits.h where one fits)
    """

    exit_code = 1


class UsageError(ArpdError):
    """Command line that asks for something that does not exist."""

    exit_code = 2


class ConfigError(ArpdError):
    """Configuration that cannot be used.

    Parameters
    ----------
    faults : one line per fault, each ``file:line:col: key: what is wrong; what would be right``
    """

    exit_code = 78

    def __init__(self, faults: list[str]) -> None:
        super().__init__("\n".join(faults))
        self.faults = faults


class TraceError(ArpdError):
    """Link trace that cannot be used; the message is ``file:line:col: what is wrong; what would be right``."""


class DaemonUnreachableError(ArpdError):
    """URL at which no daemon answers."""

    exit_code = 3  # as systemctl status and every init script since LSB say it


class NoAnswerError(DaemonUnreachableError):
    """Address at which nothing listens, or what listens says nothing.

    Parameters
    ----------
    message : what the user reads
    url : the address
    is_late : whether somebody listens, and has not answered in time
    """

    def __init__(self, message: str, *, url: str, is_late: bool) -> None:
        super().__init__(message)
        self.url, self.is_late = url, is_late


class NotKnownError(ArpdError):
    """Fact about this computer that cannot be read; the message says why."""


class LinkError(ArpdError):
    """Link that cannot be used: its interface, a new address of it, or an unknown name of its other end."""


#: What to do where Python finds no ROS 2.
GET_ROS = "source /opt/ros/jazzy/setup.bash or pip install 'arpd[ros]'"


class RosUnavailableError(ArpdError):
    """ROS 2 that this Python cannot import, or that does not start."""

    exit_code = 69
