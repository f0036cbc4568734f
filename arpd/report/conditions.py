"""The one table of what arpd judges and logs: conditions, and what happens once.

Status line, page, `arpd status`, `arpd top`, /diagnostics, log, journal, ``arpd_condition`` and the alert take names,
words, weights and waiting times from here; systemd/arpd.catalog and docs/operating.md explain each row.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
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

_COLUMNS = ("part", "severity", "is_wrong", "holds_s", "headline", "message_id")


class Condition(StrEnum):
    """A condition of the daemon: of link and plan, the most important first; below `CLEAR` faults, the worst first.

    Attributes
    ----------
    part : status of /diagnostics that shows it; empty = it is all of them, or none
    severity : of the condition, and of the event that begins it
    is_wrong : True where somebody should look: `arpd status` exits 1, and the alert fires
    holds_s : how long it must hold before it counts (s)
    headline : a few words that stay the same while the condition does
    message_id : of its events in the journal, which never changes; empty = it is no event
    """

    part: str
    severity: Severity
    is_wrong: bool
    holds_s: float
    headline: str
    message_id: str

    # fmt: off
    STANDING_BY = "standing_by", _PLAN, _WARNING, True, 0.0, "Standing by", "087aa90fdbde474c8d0d06feb8442741"
    INTERFACE_DOWN = "interface_down", _LINK, _ERROR, True, 0.0, "The link is down", "56baaf112fad4a9696cf65993f5fafcd"
    OUTAGE = "outage", _LINK, _ERROR, True, 0.0, "The link carries nothing", "32c4ce334a894fc6932278bd88e17243"
    MEASURING = "measuring", _PLAN, _INFO, False, 0.0, "No plan yet", ""
    NOTHING_TO_MANAGE = "nothing_to_manage", _PLAN, _INFO, False, 0.0, "Nothing to manage", ""
    # while a queue drains, the budget may be less than the minimum rates for some seconds
    MINIMUM_RATES = (
        "minimum_rates", _PLAN, _WARNING, True, 10.0, "The minimum rates do not fit",
        "0931344a58e643f4970621aab49ff3f5",
    )
    QUEUE = "queue", _LINK, _WARNING, False, 0.0, "A queue is building up", ""
    LIMITED = "limited", _PLAN, _WARNING, False, 0.0, "The link is the limit", ""
    BEHIND = "behind", _PLAN, _WARNING, False, 0.0, "A topic falls behind", ""
    CLEAR = "clear", "", _INFO, False, 0.0, "The link is enough", ""
    # ticks are 0.1 s apart
    STALE = "stale", "", _ERROR, True, 3.0, "No tick finishes", ""
    RELOAD_REFUSED = (
        "reload_refused", _CONFIGURATION, _WARNING, True, 0.0, "Reload refused", "35736c7d631142bdb8129cbf76075abf",
    )
    # a peer with nothing to do reports every second or two
    PEER_LOST = "peer_lost", _LINK, _ERROR, True, 10.0, "The peer is silent", "d7d08a21c03147eab689d2cdb537711c"
    RELAY_SILENT = (
        "relay_silent", _PLAN, _ERROR, True, 10.0, "The relay on the robot is silent",
        "2592b3235eaa47d6a614630d7d0e503e",
    )
    RELAY_CUT = (
        "relay_cut", _PLAN, _ERROR, True, 10.0, "The relay cannot reach its other end",
        "3c17b5c2e1964829ba50a1ef1cde8484",
    )
    RELAY_REFUSES = (
        "relay_refuses", _PLAN, _WARNING, True, 0.0, "The relay refuses topics", "1c64c16357d944bd9bb0a76b9d9fd4b1",
    )
    LEFT_OUT = "left_out", _PLAN, _WARNING, True, 0.0, "Publishers are left out", "d8ac84e735774927a9ea4768d449aca3"
    # a swap proves itself within seconds, and arpd tries again
    UNCONFIRMED = "unconfirmed", _PLAN, _WARNING, True, 15.0, "Plan not confirmed", "110bfeca52b7469a8e95c323182c6461"
    RESTART_NEEDED = (
        "restart_needed", _CONFIGURATION, _WARNING, False, 0.0, "Restart needed", "31dc202be3df438b8248cdd213c9f5e2",
    )
    # a daemon that was killed stays in the graph for 20 s, and one that starts hears the price of the other within two
    SPARE_DAEMON = (
        "spare_daemon", _PLAN, _WARNING, False, 30.0, "Another daemon stands by", "1de773e7854d4b7c9395e883a4998466",
    )
    WITHOUT_PEER = "without_peer", _LINK, _INFO, False, 5.0, "No peer reports", "c716434f875146e79ba858ed4b525e28"
    POSTPONED = "postponed", "", _INFO, False, 2.0, "QoS changes postponed", "c74bec9dcc544a79999250a0f02fcd4a"
    # fmt: on

    def __new__(cls, name: str, *columns: object) -> Self:
        """Return a member: its name in documents, and its attributes in the order above."""
        condition = str.__new__(cls, name)
        condition._value_ = name
        for attribute, column in zip(_COLUMNS, columns, strict=True):
            setattr(condition, attribute, column)
        return condition

    @property
    def phrase(self) -> str:
        """The headline inside a sentence."""
        rest = self.headline.split(" ")[0][1:]
        is_name = rest != rest.lower()  # QoS, for example
        return self.headline if is_name else self.headline[0].lower() + self.headline[1:]


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
    RATES = "rates"  # the link slows other topics than before, or by another amount, for long
    SWAP = "swap"  # publishers have new QoS, or keep theirs


@dataclass(frozen=True, slots=True)
class Event:
    """One line of the decision log.

    Parameters
    ----------
    kind, severity : what it is about, and its weight
    text : a plain sentence without a full stop: "the link slows 1 topic: /camera/image 30 → 2.1 Hz"
    topic, node : the topic and the node it is about, empty when there are several
    details : further facts by lower-case name, for programs
    number : counts up from 1 since the daemon started; 0 until it is in the log
    at_s, unix_time_s : monotonic and wall clock when it happened (s)
    """

    kind: Condition | Happening
    severity: Severity
    text: str
    topic: str = ""
    node: str = ""
    details: Mapping[str, str] = field(default_factory=lambda: MappingProxyType({}))
    number: int = 0
    at_s: float = 0.0
    unix_time_s: float = 0.0


MESSAGE_IDS: Mapping[str, str] = MappingProxyType(
    {
        Happening.STARTED: "4e20a19c0e7e4a5493ca2757515a75d5",
        Happening.PLAN: "bbbb582cc18347c595a8792d76eb4057",
        Happening.RATES: "f73447f74b29416fb80124cf6bd3c49d",
        Happening.SWAP: "baab9d07406841ef85e991140b3f5467",
        **{condition: condition.message_id for condition in Condition if condition.message_id},
    }
)
