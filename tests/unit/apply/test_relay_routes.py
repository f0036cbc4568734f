"""Routes of relayed topics, chosen from their publishers."""

from arpd.apply.relay_routes import Route, RouteRefusal, TopicWriter, choose_route, own_output

CARRIER, SECOND, OUTPUT = "/relay", "/relay_2", "/link/x"


def source(node="/a", type_name="std_msgs/msg/String", *, is_reliable=True, is_latched=False):
    return TopicWriter(node=node, type_name=type_name, is_reliable=is_reliable, is_latched=is_latched)


def route(*sources, in_force=None, readers=()):
    return choose_route(sources, carriers={CARRIER, SECOND}, output=OUTPUT, output_readers=readers, in_force=in_force)


STRING = Route(type_name="std_msgs/msg/String", is_reliable=True, is_latched=False)
LATCHED = Route(type_name="std_msgs/msg/String", is_reliable=True, is_latched=True)


def test_the_weakest_publisher_decides():
    """One best-effort publisher makes the reader best-effort, one volatile publisher makes it volatile."""
    assert route(source(is_latched=True), source("/b", is_latched=True)) == LATCHED
    mixed = route(source(is_latched=True), source("/b", is_reliable=False))
    assert mixed == Route(type_name="std_msgs/msg/String", is_reliable=False, is_latched=False)


def test_reliability_returns_and_durability_does_not():
    """When the weak publisher leaves, the reader is reliable again; latched again only when the type changes."""
    weak = Route(type_name="std_msgs/msg/String", is_reliable=False, is_latched=False)
    assert route(source(is_latched=True), in_force=weak) == STRING
    other = Route(type_name="std_msgs/msg/Empty", is_reliable=True, is_latched=False)
    assert route(source(is_latched=True), in_force=other) == LATCHED


def test_two_types_are_refused_and_named():
    """Two types on a topic that is not carried yet are refused, and their publishers are named."""
    refusal = route(source("/b"), source("/a", "std_msgs/msg/Empty"))
    assert refusal == RouteRefusal(
        reason="it has more than one type: std_msgs/msg/Empty from /a, std_msgs/msg/String from /b"
    )


def test_what_flows_is_not_taken_away_by_another_type():
    """The carried type stays, the other one is named, and its QoS does not count."""
    stray = source("/b", "std_msgs/msg/Empty", is_reliable=False)
    chosen = route(source(), stray, in_force=STRING)
    assert chosen == Route(
        type_name="std_msgs/msg/String", is_reliable=True, is_latched=False, ignored="std_msgs/msg/Empty from /b"
    )


def test_a_carried_type_that_left_makes_room_for_the_next():
    """When only another type is left, it is carried."""
    chosen = route(source(type_name="std_msgs/msg/Empty"), in_force=STRING)
    assert chosen == Route(type_name="std_msgs/msg/Empty", is_reliable=True, is_latched=False)


def test_circles_are_refused_and_named():
    """A topic that the carrier writes, or that a reader of the output writes, is refused."""
    own = route(source(), source(CARRIER))
    assert own == RouteRefusal(reason="/relay publishes it itself, so its output would be its own input")
    other = route(source(SECOND))
    assert other == RouteRefusal(reason="/relay_2 publishes it itself, so its output would be its own input")
    echo = route(source(), source("/echo"), readers=("/echo", "/far"))
    assert echo == RouteRefusal(reason="/echo reads /link/x and publishes it, so messages would loop")


def test_output_names_are_no_input():
    """A name under the prefix, or one that is its own output, is refused; a name that only resembles it is not."""
    assert own_output("/link/x", prefix="/link", output="/link/link/x") is not None
    assert own_output("/link", prefix="/link", output="/link/link") is not None
    assert own_output("/x", prefix="/link", output="/x") is not None
    assert own_output("/linkage/x", prefix="/link", output="/link/linkage/x") is None
