"""Abilities of a middleware, by its name."""

from contextlib import nullcontext
from types import SimpleNamespace

import pytest

from arpd.model.endpoints import Direction
from arpd.model.errors import RosUnavailableError
from arpd.relay.main import check_middleware
from arpd.ros.crossing import Crossing, crossing
from arpd.ros.rmw import Rmw

MS = 1_000_000


@pytest.mark.parametrize("name", ["rmw_cyclonedds_cpp", "rmw_connextdds", "rmw_zenoh_cpp", "rmw_of_next_year"])
def test_what_was_not_measured_is_only_paced(name):
    """On any other middleware swaps are refused by name, and its GIDs tell no hosts."""
    rmw = Rmw(name=name)
    assert not rmw.is_fast_dds
    assert not rmw.tells_hosts
    assert rmw.refusal.startswith(f"{name} is only paced")


@pytest.mark.parametrize(("name", "is_able"), [("rmw_fastrtps_cpp", True), ("rmw_cyclonedds_cpp", False)])
def test_two_ends_refuse_a_middleware_that_hears_itself(name, is_able):
    """Two ends start on Fast DDS; on another middleware they name it and end."""
    with nullcontext() if is_able else pytest.raises(RosUnavailableError, match=name):
        check_middleware(Rmw(name=name))


def endpoint(process, deadline_ns=0):
    return SimpleNamespace(participant=process, deadline_ns=deadline_ns, node="")


def test_without_hosts_a_reader_elsewhere_makes_a_topic_cross():
    """Where hosts are unknown, a reader in another process counts as sensing, with one copy."""
    found = crossing(
        writers=[endpoint(b"a")],
        readers=[endpoint(b"a"), endpoint(b"b", 9 * MS), endpoint(b"c", 5 * MS)],
        robot=None,
    )
    assert found == Crossing(
        direction=Direction.SENSING,
        remote_readers=1,
        requested_ns=5 * MS,
        writers=frozenset({""}),
    )
