"""The events of `reliability.py`, and their times."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import random
    from collections.abc import Mapping

#: Events of a bad hour; a shorter run has its share of each kind, and at least one.
HOUR = {
    "rate": 120,
    "reload": 60,
    "kill run": 12,
    "kill peer": 6,
    "kill relay": 3,
    "restart run": 5,
    "outage": 10,
    "interface": 3,
}
HOUR_MINUTES = 15.0  # duration of the whole hour here
KILLS = ("kill", "restart")  # first words of these kinds
KILLS_UNTIL = 0.6  # of the run
LONGEST_S = {"outage": 6.0, "interface": 8.0}
WARM_UP_S, CALM_S = 6.0, 6.0


@dataclass(frozen=True, kw_only=True, slots=True)
class Event:
    """Something that happens to the robot."""

    at_s: float
    kind: str
    lasts_s: float = 0.0


def schedule(
    minutes: float, rng: random.Random, hour: Mapping[str, int] = HOUR, *, of_minutes: float = HOUR_MINUTES
) -> list[Event]:
    """Spread the hour's events over the run, and the kills evenly over its first part.

    Parameters
    ----------
    minutes : duration of the run
    hour : events by kind
    of_minutes : duration of a run that has all of them
    """
    counts = {kind: max(1, round(count * minutes / of_minutes)) for kind, count in hour.items()}
    last_s = minutes * 60.0 - CALM_S
    kills = [kind for kind in counts if kind.startswith(KILLS) for _ in range(counts[kind])]
    rng.shuffle(kills)
    slot_s = (KILLS_UNTIL * last_s - WARM_UP_S) / len(kills)
    events = [Event(at_s=WARM_UP_S + slot_s * k, kind=kind) for k, kind in enumerate(kills)]
    for kind, longest_s in LONGEST_S.items():
        if kind in counts:
            span_s = (last_s - 10.0 - WARM_UP_S) / counts[kind]
            events += [
                Event(
                    at_s=WARM_UP_S + span_s * (k + 0.9 * rng.random()), kind=kind, lasts_s=rng.uniform(1.0, longest_s)
                )
                for k in range(counts[kind])
            ]
    events += [
        Event(at_s=rng.uniform(WARM_UP_S, last_s), kind=kind)
        for kind in ("rate", "reload")
        for _ in range(counts.get(kind, 0))
    ]
    return sorted(events, key=lambda event: event.at_s)
