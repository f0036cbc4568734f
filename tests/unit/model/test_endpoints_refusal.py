"""Reasons of refusals, as announced by any version."""

import pytest

from arpd.model.endpoints import RefusalReason


@pytest.mark.parametrize("reason", sorted(set(RefusalReason) - {RefusalReason.NONE}))
def test_a_known_reason_is_understood(reason):
    """A reason is recognised by its name."""
    assert RefusalReason.told(reason.value, words="no") is reason


@pytest.mark.parametrize("name", [None, "", "none", "solar_flare", "\x1b[2J"])
def test_a_refusal_of_unknown_reason_may_pass(name):
    """A refusal by an older or newer announcer counts as passing."""
    told = RefusalReason.told(name, words="no")
    assert (told, told.is_lasting) == (RefusalReason.OTHER, False)


@pytest.mark.parametrize("name", [None, "middleware", "none"])
def test_without_words_nothing_is_refused(name):
    """A reason without words is no refusal."""
    assert RefusalReason.told(name, words="") is RefusalReason.NONE
