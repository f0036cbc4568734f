"""The graph and publishers on this middleware, and on one whose swaps were never measured; only its name is fake."""

from dataclasses import replace

from std_msgs.msg import String

from arpd import AdaptivePublisher
from arpd.ros.graph_view import GraphView
from arpd.ros.rmw import Rmw, current_rmw

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
