"""Restoring: a stopping daemon gives every publisher its application's QoS back."""

from __future__ import annotations

from typing import TYPE_CHECKING

from arpd.govern.progress import paced_restore_plan, progress, restore_plan

if TYPE_CHECKING:
    from collections.abc import Callable

    from arpd.daemon.world import World
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
    generation : of the plan that restores, above every plan of this daemon
    clock : monotonic clock (s)
    wait : sleeps for one tick

    Returns
    -------
    Number of publishers that did not confirm in time.
    """
    begun_s = clock()
    plan_of = paced_restore_plan
    while True:
        now_s = clock()
        observation = observe(now_s)
        if observation.active_daemon:
            return 0  # the plan in force is another daemon's
        # Every publisher with a plan, also a predecessor's plan, also on a topic whose far reader has left.
        publishers = [publisher for publisher in observation.publishers if publisher.generation > 0]
        generation = max([generation, *(publisher.generation for publisher in publishers)])
        plan = plan_of(publishers, generation=generation)
        come = progress(publishers, plan)
        missing = len(publishers) - come.confirmed
        is_done, spent_s = not (missing or come.missing), now_s - begun_s
        if plan_of is paced_restore_plan and (is_done or spent_s > _RESTORE_S):
            plan_of = restore_plan
            continue
        if is_done or spent_s > _RESTORE_S + _UNPACE_S:
            return missing
        world.apply(plan, lease_s=0.0, missing=come.missing, now_s=now_s)
        wait()
