"""Topics that cross the link, or could, as `arpd topics` finds them on the robot."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True, slots=True)
class TopicTraffic:
    """Traffic of one topic, measured for some seconds.

    Parameters
    ----------
    samples : samples that arrived
    rate_hz : rate of all its writers together, 0 = none arrived (Hz)
    mean_bytes, largest_bytes : serialized size of its samples, None = none arrived (bytes)
    """

    samples: int
    rate_hz: float
    mean_bytes: float | None = None
    largest_bytes: int | None = None

    @property
    def bytes_per_second(self) -> float:
        """Payload that its writers publish (bytes/s)."""
        return self.rate_hz * (self.mean_bytes or 0.0)


@dataclass(frozen=True, kw_only=True, slots=True)
class LinkTopic:
    """One topic, with the nodes that use it on this host and beyond; the empty name is a node whose name is unknown.

    Parameters
    ----------
    name : its name; for a topic that a relay with one end republishes, the name of the original
    types : type, or types that its endpoints disagree on
    writers, readers : nodes on this host
    far_writers, far_readers : nodes beyond it, and those of arpd's relay that stand for them
    is_latched : whether a writer is TRANSIENT_LOCAL, or without a writer a reader
    relayed_as : name under which a relay with one end republishes it; empty = none does
    traffic : what was measured; None = nothing was
    unmeasured : reason for that
    """

    name: str
    types: tuple[str, ...]
    writers: tuple[str, ...] = ()
    readers: tuple[str, ...] = ()
    far_writers: tuple[str, ...] = ()
    far_readers: tuple[str, ...] = ()
    is_latched: bool = False
    relayed_as: str = ""
    traffic: TopicTraffic | None = None
    unmeasured: str = ""

    @property
    def is_from_robot(self) -> bool:
        """True if a node of this host publishes it; else it comes from beyond, or would."""
        return bool(self.writers)

    @property
    def is_crossing(self) -> bool:
        """True if a node on one side reads what a node on the other one publishes."""
        return bool((self.writers and self.far_readers) or (self.far_writers and self.readers))

    @property
    def type_name(self) -> str:
        """Its type; empty if its endpoints disagree."""
        return self.types[0] if len(self.types) == 1 else ""


@dataclass(frozen=True, kw_only=True, slots=True)
class TopicList:
    """All topics found, in the order of their names, and the way to read them.

    Parameters
    ----------
    topics : every topic
    seconds : time that they were measured (s)
    domain_id : ROS domain
    cannot_tell_hosts : reason why endpoints on this host look like those beyond it; empty = they do not
    """

    topics: tuple[LinkTopic, ...]
    seconds: float
    domain_id: int
    cannot_tell_hosts: str = ""
