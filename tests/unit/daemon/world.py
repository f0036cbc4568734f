"""The part of a daemon's world that most tests do not look at."""

from __future__ import annotations

from arpd.model.observation import Glance


class QuietWorld:
    """Keeps the prices and the probes that it is given, and has news at every glance."""

    def __init__(self, graph):
        self.graph = graph
        self.prices = []
        self.probes = []

    def set_price(self, price):
        self.prices.append(price)

    def probe(self, request):
        self.probes.append(request)

    def reconfigure(self, graph):
        self.graph = graph

    def results(self):
        return {}

    def stand_by(self):
        self.stood_by = True

    def glance(self):
        return Glance(has_reports=True, backlog_bytes=None)

    def probes_sent(self):
        return 0, 0
