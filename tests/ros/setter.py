"""Retunes one publisher, as a plan does."""

from dataclasses import replace

_FIELDS = {"depth": "depth", "deadline": "deadline_ns", "rate": "rate_hz", "min_rate": "min_rate_hz"}


class Setter:
    """Changes of some settings, with short names; the others stay."""

    def __init__(self, publisher):
        self._publisher = publisher

    def __call__(self, **values):
        """Set them."""
        changes = {_FIELDS.get(name, name): value for name, value in values.items()}
        self._publisher._shared._retune(self._publisher, replace(self._publisher.plan, **changes))
