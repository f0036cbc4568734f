"""The daemon's tick; knows no ROS, no HTTP and no systemd."""

from __future__ import annotations

import math
import time
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

from arpd import __version__
from arpd.daemon.record import Record
from arpd.daemon.reload import Configuration
from arpd.estimate.estimator import Estimator
from arpd.govern.broadcast import Broadcast
from arpd.govern.budget import Budget
from arpd.govern.governor import Governor
from arpd.govern.plan import Progress, progress
from arpd.model.allocation import Allocation, Decision, Topic
from arpd.model.plan import MOST_GENERATION, QosPlan, own_qos
from arpd.model.price import Price
from arpd.report.snapshot import Snapshot
from arpd.solve.program import Program
from arpd.solve.topics import measured_traffic, memory_budget_bytes, rows_of_traffic

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from arpd.model.link import LinkEstimate
    from arpd.model.observation import Observation
    from arpd.model.settings import Settings
    from arpd.report.conditions import Event
    from arpd.ros.world import RosControl
    from arpd.sim.oracle import Oracle
    from arpd.sim.world import SimulatedWorld
    from arpd.solve.link import Link

    World = RosControl | SimulatedWorld

TICK_S = 0.1
_RESTING_TICK_S = 0.25  # while next to nothing crosses the link
_BUSY_TICK_S = 0.03  # while it is well used, when a fall fills its queue within a few of these
_WELL_USED = 0.5
_PLAN_S = 0.49  # twice a second: ticks come every 0.1 s or sooner, and the nearest one plans
_MOST_REST_S = 2.0  # planning that something else held up is no measure
_RESTS = 30.0  # times its duration, so that a thousand topics leave most of a core to the robot
_HEAR_S = 5.0  # time until every endpoint with a plan, and any other daemon, has been heard
_RESTORE_S = 8.0  # a swap settles for three seconds, proves itself and is told
_UNPACE_S = 3.0  # more for the rates, which need no swap


class Planned(NamedTuple):
    """What the last tick that planned found: rows, their division, the decision, and who shows its plan."""

    topics: Sequence[Topic] = ()
    allocation: Allocation = Allocation()
    decision: Decision = Decision()
    progress: Progress = Progress()


class Daemon:
    """Runs the tick over a world.

    Parameters
    ----------
    world : what it observes and acts on
    settings : configuration in force
    config_path : file of the settings, for the snapshot
    clock, wall_clock : monotonic and Unix time (s)
    estimator : estimates the capacity; `arpd.estimate.estimator.Estimator` by default
    tell : called with each event of the decision log
    timed : as of `Record`
    load : as of `Program`

    Attributes
    ----------
    interface : name of the link interface, now or last; as configured until it is found
    """

    def __init__(
        self,
        world: World,
        settings: Settings,
        *,
        config_path: str = "",
        clock: Callable[[], float] = time.monotonic,
        wall_clock: Callable[[], float] = time.time,
        estimator: Estimator | Oracle | None = None,
        tell: Callable[[Event], None] = lambda _event: None,
        timed: Callable[[str, float], None] = lambda _name, _took_s: None,
        load: Callable[[str], Any] | None = None,
    ) -> None:
        self.interface = settings.link.interface
        self.configuration = Configuration(settings, path=config_path, wall_clock=wall_clock)
        self.record = Record(tell=tell, timed=timed)
        self._world = world
        self._began_s = math.inf  # when the world was first observed
        self._has_interface = False  # whether it was ever there
        self._clock = clock
        self._wall_clock = wall_clock
        self._estimator = estimator or Estimator(settings.link)
        self._budget = Budget()
        self._load = load
        self._program = Program(settings, clock=self._clock, load=load)
        self._governor = Governor(settings)
        self._broadcast = Broadcast()
        self._planned = Planned()
        self._planned_s, self._took_s = -math.inf, 0.0  # when the last tick that planned began, and how long it took
        self._facts: tuple[object, ...] = ()  # that it rests on

    @property
    def settings(self) -> Settings:
        """Configuration in force."""
        return self.configuration.settings

    @property
    def snapshot(self) -> Snapshot | None:
        """The daemon after its last finished tick, None before the first."""
        return self.record.snapshot

    @property
    def pause_s(self) -> float:
        """Most time until the next tick (s)."""
        if self.snapshot is None:
            return TICK_S
        link = self.snapshot.link
        if link.delivery_rate_bytes_per_second > _WELL_USED * link.capacity_bytes_per_second:
            return _BUSY_TICK_S
        return _RESTING_TICK_S if link.is_resting else TICK_S

    def tick(self, now_s: float) -> Decision:
        """Observe → estimate → price; twice a second, or on news, also solve → govern → apply → report."""
        seen = self._observe(now_s)
        link = self._estimator.update(seen)
        budget = self._budget.update(now_s, link, headroom=self.settings.link.headroom, topics=self._planned.topics)
        is_planning = self._plan_is_due(now_s, self._news(seen, link))
        if is_planning:
            self._plan(seen, link, budget)
        else:
            self._follow(seen, link, budget)
        if not seen.active_daemon:
            self._send(seen, link, budget)
        self._note(seen, link, is_planning=is_planning)
        return self._planned.decision

    def _observe(self, now_s: float) -> Observation:
        seen = self._world.observe(now_s)
        if pinned := self.settings.graph.pinned:
            seen = replace(seen, **pinned)
        self._began_s = min(self._began_s, now_s)
        if seen.counters is not None:
            self.interface, self._has_interface = seen.counters.interface, True
        return seen

    def _news(self, seen: Observation, link: LinkEstimate) -> tuple[object, ...]:
        """Return what calls for a plan when it changes; while one is under way, all that nodes tell."""
        told = seen.publishers if self._planned.progress.missing else len(seen.publishers)
        interface = self.interface if self._has_interface else ""
        return link.state, self._estimator.has_evidence, told, seen.active_daemon, interface

    def _plan_is_due(self, now_s: float, news: tuple[object, ...]) -> bool:
        since_s = now_s - self._planned_s
        is_time = since_s >= _PLAN_S or news != self._facts
        return is_time and since_s >= min(_MOST_REST_S, _RESTS * self._took_s)

    def _plan(self, seen: Observation, link: LinkEstimate, budget: float) -> None:
        """Solve for the budget of this moment and for the lasting one, let the governor decide, and send its plan."""
        topics: Sequence[Topic] = rows_of_traffic(measured_traffic(seen.publishers), self.settings)
        if not self._estimator.has_evidence:
            self._governor.expect(seen.now_s, topics)
            topics = ()
        memory_bytes = memory_budget_bytes(seen.memory, self.settings.program)
        # A history stands for a part of the link, so what lasts needs the capacity that lasts.
        capacity, overhead_s = self._budget.lasting
        link_that_lasts = self._program.on_link(
            capacity, topics, packet_overhead_s=overhead_s, crossing=_crossing(seen)
        )
        lasting = self._program.solve(link_that_lasts, memory_bytes)
        rates = self._program.follow(lasting, self._of_now(topics, seen, link, budget), memory_bytes)
        if seen.active_daemon:
            self._world.stand_by()
            self._planned = Planned(topics, replace(rates, price=None), self._governor.stand_by())
            return
        decision = self._governor.decide(
            seen.now_s,
            state=link.state,
            rates=rates,
            lasting=lasting,
            topics=topics,
            publishers=seen.publishers,
            # Between two ends nothing is swapped on the link: the relay's queue takes a plan as it is.
            participants=max(1, seen.remote_participants) if self.settings.relay.link_domain is None else 0,
        )
        shown = progress(seen.publishers, decision.plan, lease_s=self.settings.lease_s)
        self._world.apply(decision.plan, lease_s=self.settings.lease_s, missing=shown.missing, now_s=seen.now_s)
        self._planned = Planned(topics, rates, decision, shown)

    def _follow(self, seen: Observation, link: LinkEstimate, budget: float) -> None:
        """Let the price follow the link, by the closed form; the plan in force stays."""
        topics, allocation, decision, shown = self._planned
        price = self._of_now(topics, seen, link, budget).price() if topics and not seen.active_daemon else None
        allocation = replace(allocation, price=price, budget_bytes_per_second=budget)
        self._planned = Planned(topics, allocation, replace(decision, reason=""), shown)

    def _of_now(self, topics: Sequence[Topic], seen: Observation, link: LinkEstimate, budget: float) -> Link:
        return self._program.on_link(
            link.available_bytes_per_second,
            topics,
            packet_overhead_s=link.available_packet_overhead_s,
            share=_share(budget, link),
            crossing=_crossing(seen),
        )

    def _is_finding(self, seen: Observation) -> bool:
        """Return whether there is no price yet, and nodes may have one of a predecessor, which is better than none."""
        is_new = self._planned.allocation.price is None and seen.now_s - self._began_s < _HEAR_S
        return is_new and (not seen.publishers or any(publisher.generation for publisher in seen.publishers))

    def _send(self, seen: Observation, link: LinkEstimate, budget: float) -> None:
        """Send the price where it is due, and the probes that the estimator wants."""
        now_s = seen.now_s
        free = Price(share_per_weight=math.inf, capacity_bytes_per_second=max(1.0, link.capacity_bytes_per_second))
        price, share, spare = self._planned.allocation.price or free, _share(budget, link), 0.0
        if math.isinf(price.share_per_weight):
            spare = max(0.0, share - sum(topic.share for topic in self._planned.allocation.topics))
        price = replace(price, loss_ratio=link.loss_ratio, budget_share=share, spare_share=spare)
        if not self._is_finding(seen) and self._broadcast.is_due(price, now_s):
            self._world.set_price(price)
        for request in self._estimator.wanted_probes(now_s, is_short=math.isfinite(price.share_per_weight)):
            self._world.probe(request)
            self.record.note_probe(request)

    def _note(self, seen: Observation, link: LinkEstimate, *, is_planning: bool) -> None:
        """Show what this tick has done, and count it if it planned; after one that raised, the next plans again."""
        finished_s, configuration = self._clock(), self.configuration
        snapshot = Snapshot(
            version=__version__,
            interface=self.interface,
            has_interface=self._has_interface,
            finished_at_s=finished_s,
            unix_time_s=self._wall_clock(),
            tick_s=finished_s - seen.now_s,
            observation=seen,
            link=link,
            allocation=self._planned.allocation,
            decision=self._planned.decision,
            totals=self.record.totals,
            settings=self.settings,
            config_path=configuration.path,
            config_error=configuration.error,
            confirmed=self._planned.progress.confirmed,
            config_loaded_at_s=configuration.loaded_at_s,
            keys_awaiting_restart=configuration.awaiting_restart,
            events=self.record.decision_log.events,
            found=self.record.found,
        )
        self.record.note(snapshot)
        if is_planning:
            self.record.count(snapshot, program=self._program, governor=self._governor)
            self._planned_s, self._took_s = seen.now_s, self._clock() - seen.now_s
            self._facts = self._news(seen, link)

    def reload(self, load: Callable[[], Settings]) -> bool:
        """Take a new configuration whole, or keep the old one whole; see `Configuration.reload`."""
        self._facts = ()
        return self.configuration.reload(load, take=self._take)

    def _take(self, fresh: Settings) -> None:
        """Bring settings into force everywhere, or nowhere: only a program could refuse them, so it comes first."""
        self._program = Program(fresh, clock=self._clock, outcomes=self._program.outcomes, load=self._load)
        self._estimator.reconfigure(fresh.link)
        self._governor.reconfigure(fresh)

    def restore(self, *, wait: Callable[[float], None]) -> int | None:
        """Give every publisher that carries a plan its application's QoS back, and wait until the snapshots show it.

        The rates come last: on a link that cannot carry the applications' full traffic, no new writer could prove
        itself.

        Parameters
        ----------
        wait : sleeps for the given time (s)

        Returns
        -------
        Number of publishers that did not confirm in time, None where another daemon drives them.
        """
        missing, seen = 0, self._observe(self._clock())
        while self._clock() - self._began_s < _HEAR_S:
            # Endpoints with a predecessor's plan, or the active daemon, may not have been heard yet.
            wait(TICK_S)
            seen = self._observe(self._clock())
        begun_s, next_one = self._clock(), self._governor.plan.generation + 1
        generation = min(MOST_GENERATION, max([next_one, *(each.generation for each in seen.publishers)]))
        for is_paced, until_s in ((True, _RESTORE_S), (False, _RESTORE_S + _UNPACE_S)):
            while True:
                seen = self._observe(self._clock())
                if seen.active_daemon or any(each.generation > generation for each in seen.publishers):
                    return None  # the plan in force is another daemon's
                # Also with a predecessor's plan, and on a topic whose far reader has left.
                publishers = [publisher for publisher in seen.publishers if publisher.generation > 0]
                publishers.sort(key=lambda publisher: publisher.paced_rate_hz)  # of one topic the fastest counts
                rates = {each.topic: each.paced_rate_hz if is_paced else math.inf for each in publishers}
                plan = QosPlan(generation=generation, topics={topic: own_qos(rate) for topic, rate in rates.items()})
                shown = progress(publishers, plan)
                missing = len(publishers) - shown.confirmed
                if not (missing or shown.missing) or seen.now_s - begun_s > until_s:
                    break
                self._world.apply(plan, lease_s=0.0, missing=shown.missing, now_s=seen.now_s)
                wait(TICK_S)
        return missing


def _crossing(seen: Observation) -> int:
    return seen.sensing_topics + seen.actuation_topics


def _share(budget: float, link: LinkEstimate) -> float:
    """Return a budget as a part of what the link has for arpd's topics, 0..1."""
    return min(1.0, budget / max(1.0, link.available_bytes_per_second))
