"""Reasons of refusals, as announcers of any version tell them."""

import pytest

from arpd.model.endpoints import RefusalReason


@pytest.mark.parametrize("reason", sorted(set(RefusalReason) - {RefusalReason.NONE}))
def test_a_known_reason_is_understood(reason):
    """A reason is read back by its name."""
    assert RefusalReason.told(reason.value, words="no") is reason


@pytest.mark.parametrize("name", [None, "", "none", "solar_flare", "\x1b[2J"])
def test_a_refusal_of_unknown_reason_may_pass(name):
    """An announcer that is older or newer is asked again, as before there were reasons."""
    told = RefusalReason.told(name, words="no")
    assert (told, told.is_lasting) == (RefusalReason.OTHER, False)


@pytest.mark.parametrize("name", [None, "middleware", "none"])
def test_without_words_nothing_is_refused(name):
    """A reason without a refusal is none."""
    assert RefusalReason.told(name, words="") is RefusalReason.NONE
