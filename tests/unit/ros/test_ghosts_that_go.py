"""Servers of the other side's services that go: what becomes of the calls meanwhile."""

import time
from types import SimpleNamespace
from unittest.mock import MagicMock

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from diagnostic_msgs.srv import AddDiagnostics

from arpd.model.settings import RelaySettings
from arpd.relay.calls import Record
from arpd.relay.ends import calls as module
from arpd.relay.ends.offers import ServiceOffer
from arpd.relay.selection import Side

OFFERED = {"/set": ServiceOffer(type_name="diagnostic_msgs/srv/AddDiagnostics", node="/n")}
SESSION = 7


@pytest.fixture
def end(monkeypatch):
    """Return the calls of an end, and what it does: records on the link, responses, and the end of its server."""
    for name in ("ReadingThread", "GraphView"):
        monkeypatch.setattr(module, name, MagicMock())
    did, node = [], MagicMock()
    node.create_service().send_response = lambda _response, header: did.append((header, time.monotonic()))
    node.destroy_service = lambda _server: did.append("gone")
    calls = module.Calls(
        node,
        SimpleNamespace(give=lambda _name, make: make(node)),
        lambda data, _source: did.append(Record.decode(data).kind.name),
        session=1,
        side=Side.of(RelaySettings(services=("/**",)), is_far=True),
        timeout_s=10.0,
    )
    calls._session_there = SESSION
    calls._follow(OFFERED, SESSION, ())
    calls.did = did
    calls.ask = lambda header: calls._call("/set", AddDiagnostics.Request(), header)
    return calls


def test_a_call_of_a_server_that_goes_fails_at_once(end):
    """It does not cross: its failure would leave right before its server goes, and its caller would wait for ever."""
    end._follow({}, SESSION, ())
    end.ask("late")
    end._ghosts["/set"].release(time.monotonic())
    end._follow({}, SESSION, ())
    assert [each if isinstance(each, str) else each[0] for each in end.did] == ["late", "gone"]


def test_a_server_that_gives_way_to_one_of_this_side_takes_no_call(end):
    """Else the call would run on both sides, or the failure would arrive before the answer."""
    end._follow(OFFERED, SESSION, {"/set"})
    end.ask("both")
    assert end._ghosts["/set"].is_idle
    assert not end.did


def test_the_responses_of_an_end_that_stops_leave_five_at_a_time(end):
    """A client of ROS has room for ten."""
    for number in range(20):
        end.ask(number)
    del end.did[:]
    end.close()
    answered = [each[1] for each in end.did if not isinstance(each, str)]
    assert len(answered) == 20
    assert all(late - early > 0.015 for early, late in zip(answered, answered[5:], strict=False))
    assert end.did[-1] == "gone"
