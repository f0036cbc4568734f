"""The graph and publishers on this middleware, and on one whose swaps were never measured; only its name is fake."""

import os
import subprocess
import sys
from dataclasses import replace

import pytest
from std_msgs.msg import String

from arpd import AdaptivePublisher
from arpd.model.endpoints import RefusalReason, SwapTiming
from arpd.ros import graph
from arpd.ros.graph import GraphView
from arpd.ros.rmw import Rmw, current_rmw
from tests.ros.world import DOMAIN, REPO

OTHER = Rmw(name="rmw_cyclonedds_cpp")


def test_an_unmeasured_middleware_is_paced_and_not_swapped(ros, monkeypatch):
    """A new rate is in force at once, the depth stays, and the announcement says why."""
    assert current_rmw().is_fast_dds
    monkeypatch.setattr("arpd.endpoint.publisher.current_rmw", lambda: OTHER)
    publisher = AdaptivePublisher(ros.node("talker"), String, "/x", 10)
    publisher.retune(replace(publisher.plan, depth=20, rate_hz=3.0))
    state = publisher.state()
    assert (state.depth, state.rate_hz) == (10, 3.0)
    assert state.refusal == OTHER.refusal
    publisher.retune(replace(publisher.plan, depth=10))
    assert not publisher.state().refusal


def test_a_name_that_is_no_text_hides_no_other(ros, eventually, monkeypatch):
    """Who announces one on the network stops neither the daemon nor a relay: the topics from before stay known."""
    node = ros.node("arpd")
    view = GraphView.of(node)
    before = eventually("topics show", lambda: view.types)
    monkeypatch.setattr(node, "get_topic_names_and_types", lambda: bytes([255]).decode())
    ros.node("talker")
    eventually("the change is noticed", lambda: view.look() > 0)
    assert view.types == before


def test_a_name_that_is_no_text_stops_no_swap(ros, monkeypatch, eventually):
    """A swap that waits in vain for a reader ends with its reason, though the graph cannot be read."""
    publisher = AdaptivePublisher(ros.node("talker"), String, "/x", 10, swap_timing=SwapTiming(match_timeout_s=0.1))
    current = publisher._flow.swap.current
    current.matched, current.is_acknowledged = (lambda: 1), (lambda: True)
    monkeypatch.setattr(graph, "readers_of", lambda *_arguments: bytes([255]).decode())
    publisher.retune(replace(publisher.plan, depth=20))
    eventually("the daemon hears why", lambda: publisher.state().refusal_reason is RefusalReason.UNMATCHED)


ANNOUNCED = f"""
import socket
from arpd.model.settings import LinkDomain
from arpd.ros.runtime import TWO_ENDED_PROFILE, prepare_environment, ros_node, prepare_for_this_host

def ear(domain, participant):  # announcements go to the ports of participants, whether there are any or not
    ear = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    ear.bind(("127.0.0.1", 7400 + 250 * domain + 10 + 2 * participant))
    return ear

prepare_environment(TWO_ENDED_PROFILE)
on_link, here = ear({DOMAIN + 1}, 3), ear({DOMAIN}, 20)
with ros_node("end", LinkDomain(domain_id={DOMAIN + 1}, peer="")):
    prepare_for_this_host()
    with ros_node("end"):
        on_link.setblocking(False)
        more = 0  # announcements here than on the link
        while more < 3:
            here.recv(65536)
            more += 1
            try:
                while on_link.recv(65536):
                    more -= 1
            except BlockingIOError:
                pass
"""


def test_an_end_announces_itself_more_often_on_its_host_than_on_the_link(ros):
    """A node that starts there waits for the next announcement, and those cost no link."""
    environment = {**os.environ, "ROS_DOMAIN_ID": str(DOMAIN)}
    subprocess.run([sys.executable, "-c", ANNOUNCED], env=environment, cwd=REPO, check=True, timeout=30.0)


MET = f"""
import socket
from pathlib import Path
from arpd.model.settings import LinkDomain
from arpd.ros.runtime import TWO_ENDED_PROFILE, prepare_environment, ros_node, prepare_for_this_host

prepare_environment(TWO_ENDED_PROFILE)
with ros_node("end", LinkDomain(domain_id={DOMAIN + 1}, peer="")):
    prepare_for_this_host()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ear:
        ear.bind(("127.0.0.5", 7400 + 250 * {DOMAIN} + 10))
        ear.settimeout(10.0)
        with ros_node("end"):
            print("fastrtps_port" in Path("/proc/self/maps").read_text(), len(ear.recv(65536)) > 0)
"""


@pytest.mark.parametrize("transports", ["UDPv4", "UDPv4?non_blocking=true", "DEFAULT"])
def test_an_end_shares_memory_only_where_it_is_asked_to(ros, transports):
    """Nodes of another user than arpd's would match it, and exchange nothing with it; static peers meet it anyway."""
    own = {"ROS_DOMAIN_ID": str(DOMAIN), "FASTDDS_BUILTIN_TRANSPORTS": transports, "ROS_STATIC_PEERS": "127.0.0.5"}
    told = subprocess.run(
        [sys.executable, "-c", MET], env={**os.environ, **own}, capture_output=True, cwd=REPO, check=True, text=True
    )
    assert f"{transports == 'DEFAULT'} True" in told.stdout.splitlines()  # Fast DDS may say something beside


TOLD = f"""
import socket
from arpd.host.discovery import announced
from arpd.model.settings import LinkDomain
from arpd.ros.runtime import TWO_ENDED_PROFILE, prepare_environment, ros_node

def told(domain, address):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ear:
        ear.bind(("127.0.0.1", 7400 + 250 * domain + 10 + 2 * 3))
        with ros_node("end", LinkDomain(domain_id=domain, peer=""), address=address):
            return announced(ear.recv(65536)).addresses

prepare_environment(TWO_ENDED_PROFILE)
assert told({DOMAIN + 1}, "127.0.0.9") == {{"127.0.0.9"}}
assert "127.0.0.9" not in told({DOMAIN + 2}, None)
"""


def test_a_participant_of_the_link_tells_the_address_it_has_there_and_no_other(ros):
    """Else all that crosses would cross once for each network of this computer; others made later tell all of them."""
    environment = {**os.environ, "FASTDDS_BUILTIN_TRANSPORTS": "UDPv4"}
    subprocess.run([sys.executable, "-c", TOLD], env=environment, cwd=REPO, check=True, timeout=30.0)
