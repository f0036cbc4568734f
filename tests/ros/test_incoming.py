"""Samples that come from the link late, or before anybody knows their writer; the ghosts only note what they write."""

from types import SimpleNamespace

import pytest

from arpd.model.settings import RelaySettings
from arpd.relay.ends.incoming import Incoming
from arpd.relay.ends.offers import TopicOffer, WriterOffer
from arpd.relay.envelope import Chunk, Record, pack, writer_key
from arpd.relay.selection import Side

GID = "00" * 16


class World:
    """An end that hears of one writer of /cmd_vel, and a clock."""

    def __init__(self):
        self.now_s, self.written, self._sent = 100.0, [], 0
        ghost = SimpleNamespace(
            due_s=float("inf"), step=lambda **_is_reachable: None, matched=lambda: 1, write=self._write
        )
        ghost.follow = lambda offer, _planned: ghost.__dict__.update(offer=offer, gone_s=float("inf"))
        self.incoming = Incoming(
            nodes=SimpleNamespace(give=lambda _name, _make: ghost, tidy=lambda: None),
            reader=lambda _topic, **_options: None,
            side=Side(RelaySettings(), is_far=False),
            depths={},
        )

    def _write(self, record):
        self.written.append(record.sequence)
        return True

    def tell(self, lifespan_ns=0, link_name="/cmd_vel"):
        """Let the state of the other end come."""
        writers = (WriterOffer(node="/joystick", gid=GID, lifespan_ns=lifespan_ns),)
        offer = TopicOffer(type_name="std_msgs/msg/String", writers=writers, link_name=link_name)
        self.incoming.follow({"/cmd_vel": offer}, lambda _topic, _offer: "")

    def send(self, *, age_s):
        """Let a sample come that was so much longer on its way than usual."""
        self._sent += 1
        chunk = Chunk(1, 1, 0, 1, 0, 9, is_kept=False, part=b"")
        self.incoming.deliver(pack([Record(writer_key(GID), self._sent, b"")]), chunk, age_s)

    def wait(self, duration_s):
        self.now_s += duration_s
        self.incoming.step(is_reachable=True)


@pytest.fixture
def world(monkeypatch):
    world = World()
    monkeypatch.setattr("arpd.relay.ends.incoming.time", SimpleNamespace(monotonic=lambda: world.now_s))
    return world


def test_a_name_that_is_too_long_for_the_link_is_refused(world):
    """Nobody could make a writer of that name there; the reason says how long a name may be."""
    world.tell(link_name=f"/{236 * 'x'}")
    assert not world.incoming.refused
    world.tell(link_name=f"/{237 * 'x'}")
    assert world.incoming.refused == {"/cmd_vel": "its name has 238 characters, and no more than 237 cross"}


def test_of_what_an_outage_delayed_the_newest_is_delivered_and_a_fresh_one_replaces_it(world):
    """Old commands do not run one after the other, and none runs after a new one."""
    world.tell()
    for _ in range(5):
        world.send(age_s=3.0)
    world.wait(0.2)
    assert not world.written
    world.wait(0.2)
    assert world.written == [5]
    world.send(age_s=3.0)
    world.send(age_s=0.0)
    world.wait(1.0)
    assert (world.written, world.incoming.samples["outdated"]) == ([5, 7], 5)


def test_a_link_on_which_all_is_late_still_carries_the_newest_now_and_then(world):
    """A queue of a second that others fill does not stop a robot's commands, however quickly they come."""
    world.tell()
    for _ in range(30):
        world.send(age_s=1.0)
        world.wait(0.1)
    assert 7 <= len(world.written) <= 10
    assert world.written == sorted(world.written)


@pytest.mark.parametrize(
    ("age_s", "lifespan_ns", "written"), [(0.0, 0, [1, 2]), (3.0, 0, [2]), (0.0, 200_000_000, []), (0.0, 10**9, [1, 2])]
)
def test_what_waits_for_the_name_of_its_writer_does_not_become_fresh(world, age_s, lifespan_ns, written):
    """An end that has just started hears samples before the state that names their writers."""
    for _ in range(2):
        world.send(age_s=age_s)
    world.wait(0.5)
    world.tell(lifespan_ns)
    world.wait(0.4)
    assert world.written == written
