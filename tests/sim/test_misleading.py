"""What misled the estimate or the queue control of earlier versions, each in virtual time."""

from dataclasses import replace

from arpd.sim.link import CrossFlow, LinkModel
from tests.sim.test_price import QUEUE, ROBOT, at, play
from tests.sim.watched import MBIT, goodput, queues

FALLS_S, LASTS_S = 13.0, 28.0


def falling(**options):
    return play(at((0, 20), (FALLS_S, 5)), LASTS_S, **options)


def test_a_download_into_the_peer_is_no_capacity():
    """While the peer downloads 40 Mbit/s elsewhere, a link of 5 is not taken for more, and no plan goes up."""
    played = falling(into_peer=(CrossFlow(start_s=0.0, end_s=1000.0, rate_bytes_per_second=40.0 * MBIT),))
    stated = [tick.snapshot.link.capacity_bytes_per_second for tick in played.between(FALLS_S + 3.0, LASTS_S)]
    assert max(stated) < 1.25 * 5.0 * MBIT
    assert "up" not in played.plans(FALLS_S, LASTS_S)
    waits = queues(played.result, FALLS_S + 3.0, LASTS_S)
    assert waits[len(waits) // 2] < 0.15


def test_what_a_standstill_held_up_is_a_queue():
    """When a queue that the host cannot see stands still for 2 s and goes on slowly, it drains, and stays short."""
    out_of_sight = LinkModel(queue_bytes=0, firmware_bytes=QUEUE.queue_bytes)
    played = play(at((0, 6), (13, 1.5), (15, 0), (17, 1.5)), 30.0, model=out_of_sight)
    waits = queues(played.result, 20.0, 30.0)
    assert waits[len(waits) // 2] < 0.3
    assert goodput(played.result, 20.0, 30.0) > 0.5 * 1.5 * MBIT


def test_one_drop_without_a_peer_starves_nobody():
    """Without a peer, a packet that an idle interface drops every two seconds slows no topic."""

    def see(t_s, seen):
        return replace(seen, counters=replace(seen.counters, tx_dropped=int(max(0.0, t_s) / 2.0)))

    light = tuple(topic for topic in ROBOT if topic.name not in {"/camera", "/points"})  # 1.3 of 20 Mbit/s
    played = play(at((0, 20)), 40.0, topics=light, has_peer=False, see=see, model=QUEUE)
    assert {tick.decision.allowed for tick in played.between(5.0, 40.0)} == {1.0}
    assert all(topic.withheld_ratio < 0.05 for topic in played.result.topics)


def test_without_a_peer_the_interface_alone_shows_a_fall():
    """Without a peer, the queue of the interface shows a fall, and no more than it leaves; the link stays in use."""
    played = falling(has_peer=False)
    stated = [tick.snapshot.link.capacity_bytes_per_second for tick in played.between(FALLS_S + 3.0, LASTS_S)]
    assert max(stated) < 1.1 * 5.0 * MBIT
    waits = queues(played.result, FALLS_S + 5.0, LASTS_S)
    assert waits[len(waits) // 2] < 0.2
    assert goodput(played.result, FALLS_S + 5.0, LASTS_S) > 0.5 * 5.0 * MBIT
