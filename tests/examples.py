"""How many examples Hypothesis draws: the same few in the gate, ten times as many at random in `scripts/test --all`."""

from __future__ import annotations

import os

from hypothesis import Phase, settings

IS_RANDOM = os.environ.get("ARPD_TESTS_RANDOM") == "1"
_FACTOR = 10 if IS_RANDOM else 1


def examples(count, **more):
    """Return settings with ``count`` examples, ten times as many where they are drawn at random."""
    return settings(max_examples=count * _FACTOR, **more)


def register():
    """Make the profiles of pytest's runs, and load the one of this run."""
    settings.register_profile("gate", deadline=None, derandomize=True, database=None)
    settings.register_profile("random", deadline=None, max_examples=100 * _FACTOR, print_blob=True)
    # The same examples each time, so that the score of `mutmut run` repeats; the first that fails is enough.
    settings.register_profile("mutants", settings.get_profile("gate"), phases=[Phase.explicit, Phase.generate])
    settings.load_profile("random" if IS_RANDOM else "gate")
