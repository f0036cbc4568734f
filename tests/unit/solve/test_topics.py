"""Rows of the program, from publishers or from what the configuration assumes."""

from dataclasses import replace

import pytest

from arpd.model.endpoints import Direction
from arpd.model.observation import MemoryState
from arpd.model.settings import DefaultPreferences, Policy, ProgramSettings, Settings, TopicSettings
from arpd.model.wire import wire_size
from arpd.solve.topics import assumed_traffic, measured_traffic, memory_budget_bytes, rows_of_traffic
from tests.sample_publishers import publisher

MIB = 2.0**20


def driver(topic="/scan", node="/driver", **fields):
    return publisher(node, topic, **{"payload_bytes": 6000.0, "rate_hz": 20.0, "remote_readers": 1, **fields})


def test_a_row_has_the_cost_and_the_preferences_of_a_topic():
    """Wire bytes come from the payload, the desired rate from the source, the rest from the configuration."""
    preferences = TopicSettings(
        name="/scan", weight=3.0, min_rate_hz=2.0, min_depth=2, max_depth=50, latency_budget_s=None
    )
    (row,) = rows_of_traffic(measured_traffic([driver()]), Settings(topics=(preferences,)))
    size, packets = wire_size(6000.0, rate_hz=20.0)
    assert (row.name, row.wire_bytes, row.packets) == ("/scan", size, packets)
    assert (row.desired_rate_hz, row.min_rate_hz, row.weight) == (20.0, 2.0, 3.0)
    assert (row.min_depth, row.max_depth, row.latency_budget_s) == (2, 50, None)
    assert row.slot_bytes == pytest.approx(700.0 + 1.3 * 6000.0)


def test_a_pattern_sets_weight_floor_and_cap_of_all_it_matches():
    """Its floor holds for large samples, too; that of the defaults does not, unless it is the Rmin of Eq. (4)."""
    pattern = TopicSettings(name="/camera/**", weight=3.0, min_rate_hz=2.0, max_rate_hz=5.0)
    large = [driver("/camera/left", payload_bytes=1e6), driver("/camera/right"), driver("/map", payload_bytes=1e6)]
    rows = rows_of_traffic(measured_traffic(large), Settings(topics=(pattern,)))
    expected = [(3.0, 2.0, 5.0), (3.0, 2.0, 5.0), (1.0, 0.0, 20.0)]
    assert [(row.weight, row.min_rate_hz, row.desired_rate_hz) for row in rows] == expected
    uniform = Settings(program=ProgramSettings(policy=Policy.UNIFORM), topics=(pattern,))
    assert {row.min_rate_hz for row in rows_of_traffic(measured_traffic(large), uniform)} == {1.0}


def test_a_command_keeps_twenty_samples_a_second_unless_the_configuration_says_otherwise():
    """Small topics to the robot come before a fair share of a weak link; large ones, and an Rmin of Eq. (4), do not."""
    topics = [
        driver("/cmd_vel", payload_bytes=52.0, source_rate_hz=50.0),
        driver("/joy", payload_bytes=90.0, source_rate_hz=10.0),
        driver("/map", payload_bytes=1e6),
        driver("/mine", payload_bytes=52.0),
    ]
    traffic = measured_traffic([replace(each, direction=Direction.ACTUATION) for each in topics])
    own = TopicSettings(name="/mine", min_rate_hz=2.0)
    for settings, expected in (
        (Settings(topics=(own,)), [20.0, 10.0, 0.0, 2.0]),
        (Settings(defaults=DefaultPreferences(min_rate_hz=30.0), topics=(own,)), [30.0, 10.0, 0.0, 2.0]),
        (Settings(program=ProgramSettings(policy=Policy.UNIFORM)), [1.0] * 4),
    ):
        assert [row.min_rate_hz for row in rows_of_traffic(traffic, settings)] == expected


def test_an_assumed_topic_makes_the_row_of_a_measured_one():
    """The same payload and source with one remote reader give the same row, offline and in the daemon."""
    preferences = TopicSettings(name="/scan", weight=2.0, max_rate_hz=15.0, payload_bytes=6000.0, source_rate_hz=20.0)
    settings = Settings(topics=(preferences,))
    assert rows_of_traffic(assumed_traffic(settings), settings) == rows_of_traffic(
        measured_traffic([driver()]), settings
    )


def test_publishers_of_one_topic_share_a_row_that_costs_what_all_send():
    """Each publisher sends its own samples, a copy per remote reader, at least one; the largest rate counts."""
    publishers = [
        driver(node="/a", remote_readers=2, payload_bytes=9000.0, source_rate_hz=10.0),
        driver(node="/b", remote_readers=0, payload_bytes=50.0, source_rate_hz=30.0),
        driver(node="/silent", payload_bytes=5000.0, source_rate_hz=0.0),
    ]
    (row,) = rows_of_traffic(measured_traffic(publishers), Settings())
    (slow, few), (fast, many) = wire_size(9000.0, rate_hz=10.0), wire_size(50.0, rate_hz=30.0)
    assert row.desired_rate_hz * row.wire_bytes == pytest.approx(2 * 10.0 * slow + 30.0 * fast)
    assert (row.packets, row.desired_rate_hz) == (round(2 * few / 3 + many), 30.0)


def test_local_and_unmeasured_topics_get_no_row():
    """A topic needs a reader on another host and a known payload."""
    publishers = [driver("/local", direction=Direction.LOCAL), driver("/new", payload_bytes=0.0)]
    assert rows_of_traffic(measured_traffic(publishers), Settings()) == ()


@pytest.mark.parametrize(
    ("source_hz", "min_hz", "max_hz", "floor_hz", "desired_hz"),
    [
        (20.0, 1.0, None, 1.0, 20.0),
        (20.0, 1.0, 15.0, 1.0, 15.0),
        (20.0, 1.0, 50.0, 1.0, 20.0),
        (5.0, 50.0, None, 5.0, 5.0),
        (0.0, 2.0, None, 2.0, 2.0),
        (0.0, 0.0, None, 0.0, 0.0),
    ],
    ids=["source", "capped", "cap above source", "floor above source", "silent", "silent without a floor"],
)
def test_a_topic_wants_no_more_than_its_source_publishes(source_hz, min_hz, max_hz, floor_hz, desired_hz):
    """Neither floor nor desired rate exceeds the source; a silent topic keeps its floor."""
    settings = Settings(defaults=DefaultPreferences(min_rate_hz=min_hz, max_rate_hz=max_hz))
    (row,) = rows_of_traffic(measured_traffic([driver(source_rate_hz=source_hz)]), settings)
    assert (row.min_rate_hz, row.desired_rate_hz) == (floor_hz, desired_hz)


@pytest.mark.parametrize(
    ("available_mib", "budget_mib"), [(1000, 64), (160, 32), (128, 1), (0, 1)], ids=["ample", "short", "none", "empty"]
)
def test_histories_leave_the_host_its_reserve(available_mib, budget_mib):
    """The budget is the configured one, less when memory runs short, and at least 1 MiB."""
    memory = MemoryState(total_bytes=int(1000 * MIB), available_bytes=int(available_mib * MIB))
    settings = ProgramSettings(memory_budget_bytes=64 * MIB, memory_reserve_bytes=128 * MIB)
    assert memory_budget_bytes(memory, settings) == budget_mib * MIB
