"""The examples of hypothesis while `mutmut run` measures how many mutants the tests kill."""

from hypothesis import Phase, settings

# The same examples each time, so that the score repeats; the first that fails is enough.
settings.register_profile(
    "mutants", derandomize=True, database=None, deadline=None, phases=[Phase.explicit, Phase.generate]
)
