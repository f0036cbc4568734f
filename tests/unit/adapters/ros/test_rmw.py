"""Abilities of a middleware, by its name."""

from contextlib import nullcontext
from dataclasses import replace

import pytest
from prometheus_client import CollectorRegistry, generate_latest

from arpd.adapters.http.metrics import SnapshotCollector
from arpd.adapters.ros.crossing import Crossing, Endpoint, crossing_without_hosts
from arpd.adapters.ros.ends.run import check_middleware, profile_variables
from arpd.adapters.ros.rmw import current_rmw, rmw_of
from arpd.model.endpoints import Direction
from arpd.model.errors import RosUnavailableError
from arpd.report.status import status_document

MS = 1_000_000


@pytest.mark.parametrize("name", ["rmw_fastrtps_cpp", "rmw_fastrtps_dynamic_cpp"])
def test_fast_dds_is_swapped(name):
    """On Fast DDS swaps are on and hosts are known."""
    rmw = current_rmw(identifier=lambda: name, environ={})
    assert (rmw.name, rmw.can_swap, rmw.tells_hosts, rmw.refusal) == (name, True, True, "")


def test_under_sros2_guids_tell_no_hosts():
    """With security on Fast DDS still swaps, but its GUIDs have the enclave in place of the host."""
    rmw = current_rmw(identifier=lambda: "rmw_fastrtps_cpp", environ={"ROS_SECURITY_ENABLE": "true"})
    assert (rmw.can_swap, rmw.tells_hosts, rmw.refusal) == (True, False, "")


@pytest.mark.parametrize("name", ["rmw_cyclonedds_cpp", "rmw_connextdds", "rmw_zenoh_cpp", "rmw_of_next_year"])
def test_what_was_not_measured_is_only_paced(name):
    """On any other middleware swaps are refused by name, and its GIDs tell no hosts."""
    rmw = rmw_of(name)
    assert not rmw.can_swap
    assert not rmw.tells_hosts
    assert rmw.refusal.startswith(f"{name} is only paced")


@pytest.mark.parametrize(("name", "is_able"), [("rmw_fastrtps_cpp", True), ("rmw_cyclonedds_cpp", False)])
def test_two_ends_refuse_a_middleware_that_hears_itself(name, is_able):
    """Two ends start on Fast DDS; on another middleware they name it and end."""
    with nullcontext() if is_able else pytest.raises(RosUnavailableError, match=name):
        check_middleware(rmw_of(name))


@pytest.mark.parametrize("name", ["FASTDDS_DEFAULT_PROFILES_FILE", "FASTRTPS_DEFAULT_PROFILES_FILE"])
def test_a_profile_that_lets_an_end_hear_itself_is_named_by_its_variable(name):
    """Only the variable that is set is named."""
    assert profile_variables({"PATH": "/bin", name: "/a.xml"}) == name


def endpoint(process, deadline_ns=0):
    return Endpoint(host=b"", participant=process, deadline_ns=deadline_ns)


def test_without_hosts_a_reader_elsewhere_makes_a_topic_cross():
    """Where hosts are unknown, a reader in another process counts as sensing, with one copy."""
    crossing = crossing_without_hosts(
        writers=[endpoint(b"a")], readers=[endpoint(b"a"), endpoint(b"b", 9 * MS), endpoint(b"c", 5 * MS)]
    )
    assert crossing == Crossing(
        direction=Direction.SENSING,
        remote_readers=1,
        requests=(("", 0), ("", 5 * MS), ("", 9 * MS)),
        offers_ns=(0,),
        writers=frozenset({""}),
    )
    assert crossing.tightest_request_ns() == 5 * MS


@pytest.mark.parametrize(("writers", "readers"), [((b"a",), (b"a",)), ((b"a",), ()), ((), (b"b",))])
def test_without_hosts_one_process_is_local(writers, readers):
    """A topic within one process, or with one side only, does not cross."""
    crossing = crossing_without_hosts(writers=map(endpoint, writers), readers=map(endpoint, readers))
    assert (crossing.direction, crossing.remote_readers, crossing.tightest_request_ns()) == (Direction.LOCAL, 0, 0)


def test_the_readers_that_arpd_drives_bind_nobody():
    """The tightest request leaves out the named nodes, and `requests_of` returns those of one node."""
    readers = [
        Endpoint(host=b"", participant=b"b", deadline_ns=ns, node=node) for node, ns in (("/a", 5 * MS), ("/b", 7 * MS))
    ]
    crossing = crossing_without_hosts(writers=[endpoint(b"a")], readers=readers)
    assert (crossing.tightest_request_ns(), crossing.tightest_request_ns(besides={"/a"})) == (5 * MS, 7 * MS)
    assert (crossing.requests_of("/b"), crossing.requests_of("/c")) == ((7 * MS,), ())


def exposition(snapshot):
    registry = CollectorRegistry()
    registry.register(SnapshotCollector(lambda: snapshot, clock=lambda: snapshot.finished_at_s))
    return generate_latest(registry).decode()


def test_status_and_metrics_say_that_swaps_are_off(sample_snapshot):
    """Status and metrics name an unsupported middleware, the status with the reason."""
    sample = sample_snapshot
    rmw = rmw_of("rmw_cyclonedds_cpp")
    snapshot = replace(sample, observation=replace(sample.observation, rmw=rmw.name, rmw_refusal=rmw.refusal))
    assert status_document(snapshot)["rmw"] == {"name": rmw.name, "swaps": False, "refusal": rmw.refusal}
    assert 'arpd_rmw_info{rmw="rmw_cyclonedds_cpp",swaps="no"} 1.0' in exposition(snapshot)


def test_a_world_without_ros_names_no_middleware(sample_snapshot):
    """A simulated world shows no middleware."""
    sample = sample_snapshot
    snapshot = replace(sample, observation=replace(sample.observation, rmw=""))
    assert status_document(snapshot)["rmw"] is None
    assert "arpd_rmw" not in exposition(snapshot)
