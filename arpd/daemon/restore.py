"""Restoring: a stopping daemon gives every publisher its application's QoS back."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from arpd.govern.progress import progress
from arpd.model.plan import MOST_GENERATION, QosPlan, TopicPlan

if TYPE_CHECKING:
    from collections.abc import Callable

    from arpd.daemon.world import World
    from arpd.model.endpoints import PublisherState
    from arpd.model.observation import Observation

_RESTORE_S = 8.0  # a swap settles for three seconds, proves itself and is told
_UNPACE_S = 3.0  # more for the rates, which need no swap


def restore(
    world: World,
    observe: Callable[[float], Observation],
    *,
    generation: int,
    clock: Callable[[], float],
    wait: Callable[[], None],
) -> int:
    """Restore every publisher that carries a plan, and wait until the snapshots show it.

    The rates come last: on a link that cannot carry the applications' full traffic, no new writer could prove itself.

    Parameters
    ----------
    observe : observes the world at a time of the monotonic clock (s)
    generation : of the plan that restores, above every plan of this daemon, unless that is the highest that nodes take
    clock : monotonic clock (s)
    wait : sleeps for one tick

    Returns
    -------
    Number of publishers that did not confirm in time.
    """
    begun_s, missing = clock(), 0
    for is_paced, until_s in ((True, _RESTORE_S), (False, _RESTORE_S + _UNPACE_S)):
        while True:
            now_s = clock()
            observation = observe(now_s)
            if observation.active_daemon:
                return 0  # the plan in force is another daemon's
            # Every publisher with a plan, also a predecessor's plan, also on a topic whose far reader has left.
            publishers = [publisher for publisher in observation.publishers if publisher.generation > 0]
            generation = min(MOST_GENERATION, max([generation, *(each.generation for each in publishers)]))
            rows = {publisher.topic: _own_qos(publisher, is_paced=is_paced) for publisher in publishers}
            plan = QosPlan(generation=generation, topics=rows)
            shown = progress(publishers, plan)
            missing = len(publishers) - shown.confirmed
            if not (missing or shown.missing) or now_s - begun_s > until_s:
                break
            world.apply(plan, lease_s=0.0, missing=shown.missing, now_s=now_s)
            wait()
    return missing


def _own_qos(publisher: PublisherState, *, is_paced: bool) -> TopicPlan:
    return TopicPlan(
        rate_hz=publisher.paced_rate_hz if is_paced else math.inf,
        min_rate_hz=0.0,
        deadline_ns=publisher.baseline_deadline_ns,
        depth=publisher.baseline_depth,
    )
