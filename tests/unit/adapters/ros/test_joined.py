"""What the graph shows of announced endpoints."""

import pytest

from arpd.adapters.ros.joined import unsettled
from tests.sample_publishers import publisher, reader

FAST_NS, SLOW_NS = 50_000_000, 100_000_000
AS_ANNOUNCED = {"deadline_ns": FAST_NS, "requests_ns": (FAST_NS,), "offers_ns": (FAST_NS,)}


@pytest.mark.parametrize(
    ("topic", "fields", "announced_ns", "expected"),
    [
        ("/a", {}, [FAST_NS], set()),
        ("/a", {"deadline_ns": SLOW_NS}, [FAST_NS], {"/a"}),
        ("/a", {"requests_ns": (FAST_NS, SLOW_NS)}, [FAST_NS], {"/a"}),
        ("/a", {"requests_ns": ()}, [FAST_NS], {"/a"}),
        ("/a", {}, [SLOW_NS], {"/a"}),
        ("/a", {"offers_ns": (FAST_NS, SLOW_NS)}, [FAST_NS, FAST_NS], {"/a"}),
        ("/a", {"offers_ns": (FAST_NS, SLOW_NS)}, [FAST_NS, SLOW_NS], set()),
        ("/b", {}, [SLOW_NS], set()),
    ],
    ids=[
        "as-announced",
        "reader-swapped",
        "two-readers",
        "unseen",
        "writer-swapped",
        "old-offer",
        "two-writers",
        "no-reader",
    ],
)
def test_topics_are_unsettled_while_the_graph_shows_other_qos_than_announced(topic, fields, announced_ns, expected):
    """A topic with an announced reader waits until requests and offers in the graph are exactly the announced ones."""
    readers = [reader("/listener", topic, **{**AS_ANNOUNCED, **fields})]
    publishers = [publisher(f"/talker{n}", "/a", deadline_ns=offered) for n, offered in enumerate(announced_ns)]
    assert unsettled(publishers, readers) == expected
