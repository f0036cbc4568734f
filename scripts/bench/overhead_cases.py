"""The robots of `overhead.py`: their topics, and their configuration for arpd."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import yaml

from arpd.adapters.sim.demo import COMMAND_TOPIC
from scripts.bench.child import sample_of
from scripts.bench.overhead_targets import DEMO_TOPICS
from scripts.robot.run import CONFIG

PREFIX = "/link"
_RELAY_TOPICS = 250  # one node announces at most 256 publishers (`arpd.observe.registry.MOST_OF_NODE`)
_PLANS_PER_TOPIC = 20  # per minute, as in the default budget of 240 for twelve topics
_NO_TEXT_BYTES = len(sample_of(0, 10)) - 10  # of a serialized std_msgs/String

#: Number of topics → serialized size (bytes) and rate (Hz) of each; twelve are the demo robot's.
SYNTHETIC = {50: (2000, 10.0), 100: (1000, 10.0), 500: (800, 2.0), 1000: (800, 1.0)}


@dataclass(frozen=True, kw_only=True, slots=True)
class Topic:
    """One topic.

    Parameters
    ----------
    name : at its source
    payload_bytes : serialized size (bytes)
    rate_hz : rate of its source (Hz)
    is_command : whether an AdaptivePublisher on the CEDDP sends it to the robot; other topics take the relay
    """

    name: str
    payload_bytes: int
    rate_hz: float
    is_command: bool = False

    @property
    def text_bytes(self) -> int:
        """Length of a std_msgs/String of this size (characters)."""
        return self.payload_bytes - _NO_TEXT_BYTES

    @property
    def link_name(self) -> str:
        """Name on the link."""
        return self.name if self.is_command else PREFIX + self.name


@dataclass(frozen=True, kw_only=True, slots=True)
class Case:
    """A robot.

    Parameters
    ----------
    preferences : the sections ``topics`` and ``defaults`` of its configuration
    """

    topics: tuple[Topic, ...]
    preferences: dict[str, Any]

    @property
    def sensing(self) -> tuple[Topic, ...]:
        """Topics that go through the relay."""
        return tuple(topic for topic in self.topics if not topic.is_command)

    @property
    def commands(self) -> tuple[Topic, ...]:
        """Topics from the CEDDP."""
        return tuple(topic for topic in self.topics if topic.is_command)

    @property
    def offered_bytes_per_second(self) -> float:
        """Payload that the sources offer (bytes/s)."""
        return sum(topic.payload_bytes * topic.rate_hz for topic in self.topics)

    @property
    def offered_hz(self) -> float:
        """Messages that the sources offer (Hz)."""
        return sum(topic.rate_hz for topic in self.topics)

    def relays(self) -> list[dict[str, Any]]:
        """Return the configuration of each relay; the first is also the daemon's.

        The section ``governor`` lets an arpd that counts swaps per minute plan all topics at once; others refuse it.
        """
        names = [topic.name for topic in self.sensing]
        shares = [names[at : at + _RELAY_TOPICS] for at in range(0, len(names), _RELAY_TOPICS)]
        governor = {"swaps_per_minute": _PLANS_PER_TOPIC * max(len(self.topics), DEMO_TOPICS)}
        return [
            {
                **self.preferences,
                "governor": governor,
                "relay": {"prefix": PREFIX, "topics": [{"name": name} for name in share]},
            }
            for share in shares
        ]


def case_of(topics: int) -> Case:
    """Return the robot with so many topics: of `SYNTHETIC`, or the demo's."""
    if topics == DEMO_TOPICS:
        return _demo()
    payload_bytes, rate_hz = SYNTHETIC[topics]
    made = tuple(
        Topic(name=f"/sensor_{k:04d}/data", payload_bytes=payload_bytes, rate_hz=rate_hz) for k in range(topics)
    )
    return Case(topics=made, preferences={})


def _demo() -> Case:
    document = yaml.safe_load(CONFIG.read_text(encoding="utf-8"))
    topics = tuple(
        Topic(
            name=entry["name"].removeprefix(PREFIX),
            payload_bytes=int(entry["payload"].removesuffix("B")),
            rate_hz=float(entry["source_rate_hz"]),
            is_command=entry["name"] == COMMAND_TOPIC,
        )
        for entry in document["topics"]
    )
    return Case(topics=topics, preferences={"topics": document["topics"]})
