"""The time for which a plan outlives its daemon."""

from dataclasses import replace

from hypothesis import given
from hypothesis import strategies as st

from arpd.adapters.ros.grant import Lease
from arpd.model.settings import OnLost, Settings


@given(st.lists(st.floats(0.0, 100.0), min_size=1), st.floats(0.1, 100.0), st.floats(0.0, 200.0))
def test_it_is_over_when_the_last_sign_of_life_is_older_than_the_grant(signs, granted_s, now_s):
    """Only the newest sign counts, in any order of notes."""
    lease = Lease()
    lease.granted_s = granted_s
    for sign_s in signs:
        lease.renew(sign_s)
    assert lease.is_over(now_s) == (now_s - max(signs) > granted_s)


def test_only_the_choice_of_baseline_grants_a_lease():
    """`on_lost: keep` grants no lease."""
    settings = Settings(lost_after_s=12.0)
    assert settings.lease_s == 0.0
    assert replace(settings, on_lost=OnLost.BASELINE).lease_s == 12.0
