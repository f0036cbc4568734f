"""The daemon's tick; knows no ROS, no HTTP and no systemd."""

from __future__ import annotations

import logging
import math
import time
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

from arpd import __version__
from arpd.daemon.record import Record
from arpd.daemon.reload import Configuration
from arpd.daemon.restore import restore
from arpd.daemon.turns import Turns
from arpd.estimate.estimator import Estimator
from arpd.govern.broadcast import Broadcast
from arpd.govern.budget import Budget
from arpd.govern.governor import Governor
from arpd.govern.progress import progress
from arpd.model.price import Price
from arpd.report.situation import status_line
from arpd.report.snapshot import Snapshot, Totals
from arpd.solve.program import Program
from arpd.solve.topics import measured_traffic, memory_budget_bytes, rows_of_traffic

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from arpd.daemon.world import CapacityEstimator, World
    from arpd.govern.progress import Progress
    from arpd.model.allocation import Allocation, Topic
    from arpd.model.link import LinkEstimate, LinkState
    from arpd.model.observation import Observation
    from arpd.model.plan import Decision
    from arpd.model.settings import Settings
    from arpd.report.events import Event
    from arpd.report.history import History

log = logging.getLogger(__name__)

TICK_S = 0.1
BUSY_TICK_S = 0.03  # while the link is well used, when a fall fills its queue within a few of these
RESTING_TICK_S = 0.25  # while next to nothing crosses it
_LATE_S = 0.005  # a thread wakes up late
_WELL_USED = 0.5
_HEAR_S = 5.0  # time until every endpoint with a plan, and any other daemon, has been heard


class Daemon:
    """Runs the tick over a world; most ticks only follow the link, and two a second do everything (`Turns`).

    Parameters
    ----------
    world : what it observes and acts on
    settings : configuration in force
    interface : link interface as configured; the snapshot has the name of the interface that was found
    config_path : file of the settings, for the snapshot
    clock, wall_clock : monotonic and Unix time (s)
    estimator : estimates the capacity; `arpd.estimate.estimator.Estimator` by default
    tell : called with each event of the decision log
    """

    def __init__(
        self,
        world: World,
        settings: Settings,
        *,
        interface: str,
        config_path: str = "",
        clock: Callable[[], float] = time.monotonic,
        wall_clock: Callable[[], float] = time.time,
        estimator: CapacityEstimator | None = None,
        tell: Callable[[Event], None] = lambda _event: None,
    ) -> None:
        self._world = world
        self._interface = interface
        self._has_interface = False  # whether it was ever there
        self._began_s: float | None = None  # when the world was first observed
        self._clock = clock
        self._wall_clock = wall_clock
        self._estimator: CapacityEstimator = estimator or Estimator(settings.link)
        self._program = Program(settings, clock=self._clock)
        self._budget = Budget()
        self._governor = Governor(settings)
        self._broadcast = Broadcast()
        self._turns = Turns()
        self._link: LinkEstimate | None = None
        self._ticked_s = -math.inf  # the last tick that finished and was no glance
        self._topics: Sequence[Topic] = ()  # of the last whole turn
        self.configuration = Configuration(settings, path=config_path, wall_clock=wall_clock)
        self.record = Record(tell=tell)

    @property
    def settings(self) -> Settings:
        """Configuration in force."""
        return self.configuration.settings

    @property
    def interface(self) -> str:
        """Name of the link interface, now or last; as configured until it is found."""
        return self._interface

    @property
    def snapshot(self) -> Snapshot | None:
        """The daemon after its last finished tick, None before the first."""
        return self.record.snapshot

    @property
    def pause_s(self) -> float:
        """Most time until the next tick (s)."""
        if (link := self._link) is None:
            return TICK_S
        is_busy = link.delivery_rate_bytes_per_second > _WELL_USED * link.capacity_bytes_per_second
        return BUSY_TICK_S if is_busy else TICK_S

    @property
    def history(self) -> History:
        """The last ten minutes."""
        return self.record.history

    def tick(self, now_s: float) -> Decision:
        """Observe → estimate → price; at a whole turn observe → estimate → solve → govern → apply → report.

        Where the usual time has not passed a glance comes first, and a tick that would find nothing new ends there.
        """
        if (snapshot := self.record.snapshot) is not None and self._may_rest(now_s):
            return replace(snapshot.decision, level_changed=False, reason="")
        began_s, self._ticked_s = self._clock(), -math.inf
        observation = self._observe(now_s)
        link = self._link = self._estimator.update(observation)
        budget = self._budget.update(now_s, link, headroom=self.settings.link.headroom, topics=self._topics)
        facts = self._facts(observation, link)
        if not self._turns.is_due(now_s, facts=facts, publishers=observation.publishers):
            return self._follow(now_s, observation, link, budget)
        traffic = measured_traffic(observation.publishers) if self._estimator.has_evidence else ()
        topics = self._topics = rows_of_traffic(traffic, self.settings)
        solve = partial(
            self._program.solve,
            topics=topics,
            memory_budget_bytes=memory_budget_bytes(observation.memory, self.settings.program),
            packet_overhead_s=link.available_packet_overhead_s,
            crossing=_crossing(observation),
        )
        rates = solve(link.available_bytes_per_second, share=_share(budget, link))
        # A history stands for a part of the link, so what lasts needs the capacity that lasts.
        lasting = solve(self._budget.lasting_bytes_per_second)
        decision = self._decide(now_s, observation, link.state, rates=rates, lasting=lasting, topics=topics)
        come = progress(observation.publishers, decision.plan, lease_s=self.settings.lease_s)
        if not observation.active_daemon:
            self._send(now_s, decision.price, link, budget=budget, divided=rates)
            self._world.apply(decision.plan, lease_s=self.settings.lease_s, missing=come.missing, now_s=now_s)
        self._report(
            now_s,
            observation=observation,
            link=link,
            allocation=rates,
            decision=decision,
            come=come,
        )
        self._turns.note(
            now_s,
            facts=facts,
            publishers=observation.publishers,
            took_s=self._clock() - began_s,
            is_settled=not come.missing,
        )
        self._ticked_s = now_s
        return decision

    def _may_rest(self, now_s: float) -> bool:
        """Return whether a glance shows nothing that is worth a tick before the usual time."""
        is_resting = self._link is not None and self._link.is_resting
        if now_s - self._ticked_s >= (RESTING_TICK_S if is_resting else TICK_S) - _LATE_S:
            return False
        glance = self._world.glance()
        return not glance.has_reports and not self._estimator.needs_look(now_s, glance.backlog_bytes)

    def _facts(self, observation: Observation, link: LinkEstimate) -> tuple[object, ...]:
        """Return what calls for a whole turn when it changes."""
        publishers, interface = len(observation.publishers), self._interface if self._has_interface else ""
        return link.state, self._estimator.has_evidence, publishers, observation.active_daemon, interface

    def _follow(self, now_s: float, observation: Observation, link: LinkEstimate, budget: float) -> Decision:
        """Let the price follow the link until the next whole turn; the plan in force stays."""
        snapshot = self.record.snapshot
        assert snapshot is not None, "the first tick is a whole turn"
        decision, allocation = snapshot.decision, snapshot.allocation
        if not observation.active_daemon:
            price = self._program.price(
                link.available_bytes_per_second,
                self._topics,
                packet_overhead_s=link.available_packet_overhead_s,
                share=_share(budget, link),
                crossing=_crossing(observation),
            )
            decision = replace(decision, price=price, level_changed=False, reason="")
            allocation = replace(allocation, price=price, capacity_bytes_per_second=budget)
            self._send(now_s, price, link, budget=budget, divided=snapshot.allocation)
        finished_s = self._clock()
        self.record.follow(
            replace(
                snapshot,
                finished_at_s=finished_s,
                unix_time_s=self._wall_clock(),
                tick_s=finished_s - now_s,
                observation=observation,
                link=link,
                decision=decision,
                allocation=allocation,
            )
        )
        self._ticked_s = now_s
        return decision

    def _observe(self, now_s: float) -> Observation:
        observation = self._world.observe(now_s)
        if self._began_s is None:
            self._began_s = now_s
        if observation.counters is not None:
            self._interface, self._has_interface = observation.counters.interface, True
        return observation

    def _decide(
        self,
        now_s: float,
        observation: Observation,
        state: LinkState,
        *,
        rates: Allocation,
        lasting: Allocation,
        topics: Sequence[Topic],
    ) -> Decision:
        if observation.active_daemon:
            self._world.stand_by()
            return self._governor.stand_by()
        return self._governor.decide(
            now_s,
            state=state,
            rates=rates,
            lasting=lasting,
            topics=topics,
            publishers=observation.publishers,
            participants=max(1, observation.remote_participants),
        )

    def _send(
        self, now_s: float, price: Price | None, link: LinkEstimate, *, budget: float, divided: Allocation
    ) -> None:
        """Send the price where it is due, and the probes that the estimator wants."""
        free = Price(share_per_weight=math.inf, capacity_bytes_per_second=max(1.0, link.capacity_bytes_per_second))
        price = price or free
        share = _share(budget, link)
        spare = 0.0
        if math.isinf(price.share_per_weight):
            spare = max(0.0, share - sum(topic.share for topic in divided.topics))
        price = replace(price, loss_ratio=link.loss_ratio, budget_share=share, spare_share=spare)
        if self._broadcast.is_due(price, now_s):
            self._world.set_price(price)
        for request in self._estimator.wanted_probes(now_s):
            self._world.probe(request)

    def _report(
        self,
        now_s: float,
        *,
        observation: Observation,
        link: LinkEstimate,
        allocation: Allocation,
        decision: Decision,
        come: Progress,
    ) -> None:
        finished_s, configuration = self._clock(), self.configuration
        picture = Snapshot(
            version=__version__,
            interface=self._interface,
            has_interface=self._has_interface,
            finished_at_s=finished_s,
            unix_time_s=self._wall_clock(),
            tick_s=finished_s - now_s,
            observation=observation,
            link=link,
            allocation=allocation,
            decision=decision,
            totals=Totals(),
            settings=self.settings,
            config_path=configuration.path,
            config_error=configuration.error,
            confirmed=come.confirmed,
            lease_s=self.settings.lease_s,
            config_loaded_at_s=configuration.loaded_at_s,
            keys_awaiting_restart=configuration.awaiting_restart,
        )
        self.record.add(
            picture, world=self._world, program=self._program, governor=self._governor, configuration=configuration
        )

    def reload(self, load: Callable[[], Settings]) -> bool:
        """Take a new configuration whole, or keep the old one whole; see `Configuration.reload`."""
        self._turns.ask()
        return self.configuration.reload(load, take=self._take)

    def _take(self, fresh: Settings) -> None:
        """Bring settings into force everywhere, or nowhere."""
        program = Program(fresh, clock=self._clock)
        try:
            self._reconfigure(fresh)
        except BaseException:
            self._reconfigure(self.settings)
            raise
        self.record.keep_counts_of(self._program)
        self._program = program

    def _reconfigure(self, settings: Settings) -> None:
        self._world.reconfigure(settings.graph)
        self._estimator.reconfigure(settings.link)
        self._governor.reconfigure(settings)

    def restore(self, *, wait: Callable[[float], None]) -> int:
        """Give every publisher its application's QoS back; see `arpd.daemon.restore.restore`.

        Parameters
        ----------
        wait : sleeps for the given time (s)

        Returns
        -------
        Number of publishers that did not confirm in time.
        """
        generation = self._governor.plan.generation + 1
        self._observe(self._clock())
        while self._clock() - (self._began_s or 0.0) < _HEAR_S:
            # Endpoints with a predecessor's plan, or the active daemon, may not have been heard yet.
            wait(TICK_S)
            self._observe(self._clock())
        return restore(self._world, self._observe, generation=generation, clock=self._clock, wait=lambda: wait(TICK_S))

    def status_line(self) -> str:
        """Return one line for ``systemctl status``."""
        return status_line(self.snapshot)


def _crossing(observation: Observation) -> int:
    """Return the number of topics that cross the link, managed or not."""
    return observation.sensing_topics + observation.actuation_topics


def _share(budget: float, link: LinkEstimate) -> float:
    """Return a budget as a part of what the link has for arpd's topics, 0..1."""
    return min(1.0, budget / max(1.0, link.available_bytes_per_second))
