"""What the relay says of itself."""

import pytest

from arpd.model.relay import RelaySummary
from arpd.relay.ends.offers import EndState, TopicOffer, WriterOffer
from arpd.relay.status import status_line, topics_of


def offer(*nodes):
    writers = tuple(WriterOffer(node=node, gid=f"{number:032x}") for number, node in enumerate(nodes))
    return TopicOffer(type_name="std_msgs/msg/String", writers=writers, link_name="/scan")


@pytest.mark.parametrize(
    ("nodes", "wants", "offered"),
    [
        (("/arpd",), (), 0),
        (("/arpd",), ("/scan",), 1),
        (("/arpd", "/lidar"), (), 1),
    ],
)
def test_diagnostics_of_arpd_alone_are_no_topic_that_could_cross(nodes, wants, offered):
    """Else nobody would learn that the relay finds none of the user's nodes."""
    sender = EndState(session=1, topics={"/scan": offer(*nodes)})
    found = topics_of(sender, EndState(session=2, wants=frozenset(wants)))
    assert (found.offered, found.wanted) == (offered, len(wants))


def test_a_refusal_names_the_host_where_it_holds():
    """A type that is not installed "here" is missing on that computer, wherever one reads of it."""
    robot = EndState(session=1, host="spot", topics={"/scan": offer("/lidar")}, refused={"/cmd": "no such type here"})
    base = EndState(session=2, host="desk", topics={"/cmd": offer("/joy")}, refused={"/scan": "two types here"})
    assert topics_of(robot, base).refused == {"/scan": "on desk: two types here"}
    assert topics_of(base, robot).refused == {"/cmd": "on spot: no such type here"}


def test_no_topic_is_said_to_cross_while_the_other_end_is_silent():
    """The line says that they wait."""
    silent = status_line(RelaySummary(is_reachable=False), is_far=False, is_met=True, second_ends=())
    assert silent.startswith(
        "the base computer's end is silent; 0 of 0 topics wait to cross to the base computer, 0 of"
    )
