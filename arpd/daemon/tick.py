"""The daemon's tick; knows no ROS, no HTTP and no systemd."""

from __future__ import annotations

import logging
import math
import time
from dataclasses import replace
from functools import partial
from types import MappingProxyType
from typing import TYPE_CHECKING

from arpd import __version__
from arpd.apply.broadcast import Broadcast
from arpd.apply.ordering import Ordering
from arpd.apply.readers import plan_readers
from arpd.daemon.record import Record
from arpd.daemon.reload import Configuration
from arpd.daemon.restore import restore
from arpd.estimate.estimator import Estimator
from arpd.govern.budget import Budget
from arpd.govern.governor import Governor
from arpd.model.price import Price
from arpd.model.settings import Backend
from arpd.report.situation import status_line
from arpd.report.snapshot import Snapshot, Totals
from arpd.solve.program import Program
from arpd.solve.topics import memory_budget_bytes, topics_to_plan

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from arpd.apply.ordering import Steps
    from arpd.daemon.world import CapacityEstimator, World
    from arpd.model.allocation import Allocation, Topic
    from arpd.model.link import LinkEstimate, LinkState
    from arpd.model.observation import Observation
    from arpd.model.plan import Decision, ReaderPlans
    from arpd.model.settings import Settings
    from arpd.report.events import Event
    from arpd.report.history import History

log = logging.getLogger(__name__)

TICK_S = 0.1
BUSY_TICK_S = 0.03  # while the link is well used, when a fall fills its queue within a few of these
_WELL_USED = 0.5
_STEP = 0.005  # of the logarithm of a budget or capacity
_LEAST_SHARE = 1e-6  # the program divides nothing less
_HEAR_S = 2.5  # time until every endpoint with a plan, and any other daemon, has been heard


class Daemon:
    """Runs the tick over a world.

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
        self._program = self._program_of(settings)
        self._budget = Budget()
        self._governor = Governor(settings)
        self._broadcast = Broadcast()
        self._ordering = Ordering()
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
        if (snapshot := self.record.snapshot) is None:
            return TICK_S
        link = snapshot.link
        is_busy = link.delivery_rate_bytes_per_second > _WELL_USED * link.capacity_bytes_per_second
        return BUSY_TICK_S if is_busy else TICK_S

    @property
    def history(self) -> History:
        """The last ten minutes."""
        return self.record.history

    def tick(self, now_s: float) -> Decision:
        """Observe → estimate → solve → govern → apply → report, once."""
        observation = self._observe(now_s)
        link = self._estimator.update(observation)
        topics = topics_to_plan(observation.publishers, self.settings) if self._estimator.has_evidence else ()
        memory = memory_budget_bytes(observation.memory, self.settings.program)
        headroom = self.settings.link.headroom
        budget = self._budget.update(now_s, link, headroom=headroom)
        crossing = observation.sensing_topics + observation.actuation_topics
        divide = partial(self._divide, link, topics, memory, crossing)
        rates = divide(capacity=link.available_bytes_per_second, budget=budget)
        # A history stands for a part of the link, so what lasts needs the capacity that lasts.
        lasting_capacity = self._budget.lasting_bytes_per_second
        lasting = divide(capacity=lasting_capacity, budget=headroom * lasting_capacity)
        decision = self._decide(now_s, observation, link.state, rates=rates, lasting=lasting, topics=topics)
        reader_plans = plan_readers(observation.readers, decision.plan)
        steps = self._ordering.steps(
            now_s,
            publishers=observation.publishers,
            readers=observation.readers,
            plan=decision.plan,
            reader_plans=reader_plans,
            reason=decision.reason,
            lease_s=self.settings.lease_s,
        )
        if not observation.active_daemon:
            self._act(now_s, link, decision, steps)
        self._report(
            now_s,
            observation=observation,
            link=link,
            allocation=rates,
            decision=decision,
            steps=steps,
            reader_plans=reader_plans,
        )
        return decision

    def _divide(
        self,
        link: LinkEstimate,
        topics: Sequence[Topic],
        memory_bytes: float,
        crossing: int,
        *,
        capacity: float,
        budget: float,
    ) -> Allocation:
        """Divide a budget (bytes/s); it and the capacity come in steps, so most ticks ask the program nothing new."""
        budget = _stepped(budget)
        capacity = max(_stepped(capacity), budget)
        return self._program.solve(
            capacity,
            topics,
            memory_bytes,
            packet_overhead_s=link.available_packet_overhead_s,
            share=min(1.0, max(_LEAST_SHARE, round(budget / capacity, 6))) if capacity > 0 else 0.0,
            crossing=crossing,
        )

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
            return self._governor.stand_by()
        return self._governor.decide(
            now_s,
            state=state,
            rates=rates,
            lasting=lasting,
            topics=topics,
            publishers=observation.publishers,
            newest=max((reader.generation for reader in observation.readers), default=0),
        )

    def _act(self, now_s: float, link: LinkEstimate, decision: Decision, steps: Steps) -> None:
        free = Price(share_per_weight=math.inf, capacity_bytes_per_second=max(1.0, link.capacity_bytes_per_second))
        price = replace(decision.price or free, loss_ratio=link.loss_ratio)
        if self._broadcast.is_due(price, now_s):
            self._world.set_price(price)
        self._world.apply(steps.transitions, now_s=now_s)
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
        steps: Steps,
        reader_plans: ReaderPlans,
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
            confirmed=steps.confirmed,
            reader_plans=MappingProxyType(reader_plans),
            readers_confirmed=steps.readers_confirmed,
            lease_s=self.settings.lease_s,
            config_loaded_at_s=configuration.loaded_at_s,
            keys_awaiting_restart=configuration.awaiting_restart,
        )
        self.record.add(
            picture, world=self._world, program=self._program, governor=self._governor, configuration=configuration
        )

    def reload(self, load: Callable[[], Settings]) -> bool:
        """Take a new configuration whole, or keep the old one whole; see `Configuration.reload`."""
        return self.configuration.reload(load, take=self._take)

    def _take(self, fresh: Settings) -> None:
        """Bring settings into force everywhere, or nowhere."""
        program = self._program_of(fresh)  # this can fail, so it comes first
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

    def _program_of(self, settings: Settings) -> Program:
        try:
            return Program.of(settings, clock=self._clock)
        except ImportError as error:
            log.error("program.backend: %s cannot be used (%s); exact takes over", settings.program.backend, error)  # noqa: TRY400 - the traceback would not help
            return Program.of(settings, backend=Backend.EXACT, clock=self._clock)

    def restore(self, *, wait: Callable[[float], None]) -> int:
        """Give every publisher and reader its application's QoS back; see `arpd.daemon.restore.restore`.

        Parameters
        ----------
        wait : sleeps for the given time (s)

        Returns
        -------
        Number of publishers and readers that did not confirm in time.
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


def _stepped(bytes_per_second: float) -> float:
    """Return a rate rounded to steps of half a per cent, 0 below 1 byte/s."""
    return math.exp(round(math.log(bytes_per_second) / _STEP) * _STEP) if bytes_per_second >= 1.0 else 0.0
