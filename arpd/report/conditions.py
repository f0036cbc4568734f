"""The one table of what arpd judges and logs: conditions, and what happens once.

Status line, page, `arpd status`, `arpd top`, /diagnostics, log, journal, ``arpd_condition`` and the alert take names,
words, weights and waiting times from here; systemd/arpd.catalog and docs/operating.md explain each row.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from types import MappingProxyType
from typing import TYPE_CHECKING, Self

if TYPE_CHECKING:
    from collections.abc import Mapping


class Severity(StrEnum):
    """Weight of an event or a condition for the people who run the robot."""

    INFO = "info"
    WARNING = "warning"  # something is worse than it should be, and arpd copes
    ERROR = "error"  # arpd cannot cope


_INFO, _WARNING, _ERROR = Severity
_LINK, _PLAN, _CONFIGURATION = "link", "plan", "configuration"  # statuses of /diagnostics


class Condition(StrEnum):
    """A condition of the daemon: of link and plan, the most important first; below `CLEAR` faults, the worst first.

    Attributes
    ----------
    part : status of /diagnostics that shows it; empty = it is all of them, or none
    severity : of the condition, and of the event that begins it
    is_wrong : True where somebody should look: `arpd status` exits 1, and the alert fires
    holds_s : how long it must hold before it counts (s)
    headline : a few words that stay the same while the condition does
    ended : what the log says when it ends
    message_id : of its events in the journal, which never changes; empty = it is no event
    """

    part: str
    severity: Severity
    is_wrong: bool
    holds_s: float
    headline: str
    ended: str
    message_id: str

    # fmt: off
    STANDING_BY = (
        "standing_by", _PLAN, _WARNING, True, 0.0, "Standing by",
        "this daemon drives the robot", "087aa90fdbde474c8d0d06feb8442741",
    )
    INTERFACE_DOWN = (
        "interface_down", _LINK, _ERROR, True, 0.0, "The link is down",
        "the link interface is up", "56baaf112fad4a9696cf65993f5fafcd",
    )
    OUTAGE = (
        "outage", _LINK, _ERROR, True, 0.0, "The link carries nothing",
        "the link carries again", "32c4ce334a894fc6932278bd88e17243",
    )
    MEASURING = "measuring", _PLAN, _INFO, False, 0.0, "No plan yet", "", ""
    NOTHING_TO_MANAGE = "nothing_to_manage", _PLAN, _INFO, False, 0.0, "Nothing to manage", "", ""
    MINIMUM_RATES = (  # while a queue drains, the budget may be less than the minimum rates for some seconds
        "minimum_rates", _PLAN, _WARNING, True, 10.0, "The minimum rates do not fit",
        "the minimum rates fit again", "0931344a58e643f4970621aab49ff3f5",
    )
    QUEUE = "queue", _LINK, _WARNING, False, 0.0, "A queue is building up", "", ""
    LIMITED = "limited", _PLAN, _WARNING, False, 0.0, "The link is the limit", "", ""
    CLEAR = "clear", "", _INFO, False, 0.0, "The link is fine", "", ""
    STALE = "stale", "", _ERROR, True, 3.0, "No tick finishes", "", ""  # ticks are 0.1 s apart
    RELOAD_REFUSED = (
        "reload_refused", _CONFIGURATION, _WARNING, True, 0.0, "Reload refused",
        "a new configuration is in force", "35736c7d631142bdb8129cbf76075abf",
    )
    PEER_LOST = (  # a peer with nothing to do reports every second or two
        "peer_lost", _LINK, _ERROR, True, 10.0, "The peer is silent",
        "a peer reports again", "d7d08a21c03147eab689d2cdb537711c",
    )
    RELAY_SILENT = (
        "relay_silent", _PLAN, _ERROR, True, 10.0, "The relay on the robot is silent",
        "the relay on the robot is heard", "2592b3235eaa47d6a614630d7d0e503e",
    )
    RELAY_CUT = (
        "relay_cut", _PLAN, _ERROR, True, 10.0, "The relay cannot reach its other end",
        "the relay reaches its other end", "3c17b5c2e1964829ba50a1ef1cde8484",
    )
    RELAY_REFUSES = (
        "relay_refuses", _PLAN, _WARNING, True, 0.0, "The relay refuses topics",
        "the relay refuses no topic any longer", "1c64c16357d944bd9bb0a76b9d9fd4b1",
    )
    UNCONFIRMED = (  # a swap proves itself within seconds, and arpd tries again
        "unconfirmed", _PLAN, _WARNING, True, 15.0, "Plan not confirmed",
        "no publisher is behind the plan any longer", "110bfeca52b7469a8e95c323182c6461",
    )
    RESTART_NEEDED = (
        "restart_needed", _CONFIGURATION, _WARNING, False, 0.0, "Restart needed",
        "the whole file is in force", "31dc202be3df438b8248cdd213c9f5e2",
    )
    SPARE_DAEMON = (
        "spare_daemon", _PLAN, _WARNING, False, 0.0, "Another daemon stands by",
        "no other daemon is left", "1de773e7854d4b7c9395e883a4998466",
    )
    WITHOUT_PEER = (
        "without_peer", _LINK, _INFO, False, 5.0, "No peer reports",
        "a peer reports", "c716434f875146e79ba858ed4b525e28",
    )
    POSTPONED = (
        "postponed", "", _INFO, False, 2.0, "QoS changes postponed",
        "nothing is postponed", "c74bec9dcc544a79999250a0f02fcd4a",
    )
    # fmt: on

    def __new__(  # noqa: PLR0917 - the columns of the table
        cls,
        name: str,
        part: str,
        severity: Severity,
        is_wrong: bool,  # noqa: FBT001
        holds_s: float,
        headline: str,
        ended: str,
        message_id: str,
    ) -> Self:
        """Return a member: its name in documents, and its attributes."""
        condition = str.__new__(cls, name)
        condition._value_ = name
        condition.part, condition.severity, condition.is_wrong = part, severity, is_wrong
        condition.holds_s, condition.headline = holds_s, headline
        condition.ended, condition.message_id = ended, message_id
        return condition

    @property
    def phrase(self) -> str:
        """The headline inside a sentence."""
        return self.headline[0].lower() + self.headline[1:]


@dataclass(frozen=True, slots=True)
class Finding:
    """A condition that holds, and the reason.

    Parameters
    ----------
    why : what follows the headline, without a full stop
    about : what it is about; it begins anew with another
    since_s : since when it has held, by the monotonic clock (s)
    """

    condition: Condition
    why: str
    about: str = ""
    since_s: float = -math.inf

    @property
    def text(self) -> str:
        """The whole sentence, headline first."""
        return f"{self.condition.headline}: {self.why}."

    @property
    def phrase(self) -> str:
        """The same, for a line that goes on."""
        return f"{self.condition.phrase}: {self.why}"


class Happening(StrEnum):
    """Events that are no condition; their severity depends on what happened."""

    STARTED = "started"
    PLAN = "plan"  # there is a new one
    CONFIRMED = "confirmed"  # every publisher runs it
    RATES = "rates"  # the link slows other topics than before, or by another amount, for long
    SWAP = "swap"  # publishers have new QoS, or keep theirs


MESSAGE_IDS: Mapping[str, str] = MappingProxyType(
    {
        Happening.STARTED: "4e20a19c0e7e4a5493ca2757515a75d5",
        Happening.PLAN: "bbbb582cc18347c595a8792d76eb4057",
        Happening.CONFIRMED: "eb0e5cf552d24fa5a7ebde2747d2430f",
        Happening.RATES: "f73447f74b29416fb80124cf6bd3c49d",
        Happening.SWAP: "baab9d07406841ef85e991140b3f5467",
        **{condition: condition.message_id for condition in Condition if condition.message_id},
    }
)
