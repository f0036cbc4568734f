"""The world of a daemon: publishers that take its plans, and what it sends besides."""

from __future__ import annotations

from dataclasses import replace

from arpd.model.link import LinkState
from arpd.model.observation import MemoryState
from tests.sample_link import INTERFACE, LINK, observation


class KnownLink:
    """An estimator that knows the link."""

    has_evidence, state = True, LinkState.STEADY

    def __init__(self, capacity):
        self.capacity = capacity

    def update(self, _observation):
        return replace(LINK, capacity_bytes_per_second=self.capacity, state=self.state)

    def wanted_probes(self, _now_s, *, is_short):
        return ()


class World:
    """Publishers that take each plan a while after it was sent.

    Parameters
    ----------
    takes_s : time until a plan is announced (s)
    deaf : nodes that take nothing
    sees : what the daemon observes besides
    """

    def __init__(self, *publishers, takes_s=0.0, deaf=(), **sees):
        self.publishers = {each.topic: each for each in publishers}
        self.takes_s, self.deaf = takes_s, deaf
        self.sees = {"memory": MemoryState(total_bytes=2**33, available_bytes=2**32), **sees}
        self.prices, self.probes, self.lease_s = [], [], None
        self.sent = []  # nodes and rows
        self._due = []  # time, plan, lease of what was sent and not taken

    def observe(self, now_s):
        for _, plan, lease_s in (due for due in self._due if due[0] <= now_s):
            self._take(plan, lease_s)
        self._due = [due for due in self._due if due[0] > now_s]
        publishers = tuple(self.publishers.values())
        return observation(now_s, counters=INTERFACE, publishers=publishers, **self.sees)

    def apply(self, plan, *, lease_s, missing, now_s):
        self.lease_s = lease_s
        for node in missing:
            if (node, plan.topics) not in self.sent:
                self.sent.append((node, plan.topics))
                if node not in self.deaf:
                    self._due.append((now_s + self.takes_s, plan, lease_s))

    def _take(self, plan, lease_s):
        for name, each in self.publishers.items():
            if (row := plan.topics.get(each.topic)) is not None:
                depth, deadline_ns = each.qos_by(row)
                self.publishers[name] = replace(
                    each,
                    generation=plan.generation,
                    lease_s=lease_s,
                    rate_hz=row.rate_hz,
                    paced_rate_hz=row.rate_hz,
                    depth=depth,
                    deadline_ns=deadline_ns,
                )

    def set_price(self, price):
        self.prices.append(price)

    def probe(self, request):
        self.probes.append(request)

    def stand_by(self):
        pass
