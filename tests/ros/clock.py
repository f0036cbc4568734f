"""A clock that tests put forward, so that what takes seconds need not be waited for."""

import time

from arpd.endpoint.node_publishers import NodePublishers
from arpd.ros.attached import attached


class SkippingClock:
    """The time of this computer, and what was skipped."""

    def __init__(self):
        self._skipped_s = 0.0

    def __call__(self):
        return time.monotonic() + self._skipped_s

    def skip(self, seconds):
        self._skipped_s += seconds

    def rule(self, node):
        """Let what arpd makes for the publishers of a new node use this clock."""
        attached(node, NodePublishers, lambda: NodePublishers(node, clock=self))
        return node
