"""A live robot under operation: scrape, kill and stop of its daemon."""

import time
import urllib.request

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from tests.all.link.hosts import NEEDS_LINK
from tests.all.link.live_robot import HEAVY, SLOW, TOPICS, is_confirmed, live_robot, newest_s, topics
from tests.waiting import eventually

pytestmark = NEEDS_LINK
PRICE_LASTS_S = 5.0


def confirmed(world):
    eventually("every topic confirms its plan", lambda: is_confirmed(world))


def shown(world, what, condition):
    """Wait until the status fulfils a condition; a daemon that has no time to answer is asked again."""
    eventually(what, lambda: (status := world.status()) is not None and condition(status))


@pytest.fixture(scope="module")
def live(tmp_path_factory):
    """Share one robot among all tests, because its start costs more than any of them."""
    with live_robot(tmp_path_factory.mktemp("robot")) as live:
        yield live


def test_metrics_of_a_live_robot_name_every_topic(live):
    """The metrics of a live daemon name every managed topic, and it says that it is healthy and ready."""
    world, url = live
    confirmed(world)
    with urllib.request.urlopen(f"{url}/metrics", timeout=30) as answer:
        text = answer.read().decode()
    for topic in TOPICS:
        assert f'topic="{topic}"' in text
    for path in ("/-/healthy", "/-/ready"):
        with urllib.request.urlopen(url + path, timeout=30) as answer:
            assert answer.status == 200


def test_the_daemon_may_die_and_return(live):
    """After kill -9 data flows under the last plan; a new daemon takes over, and a clean stop restores the QoS."""
    world, _ = live
    confirmed(world)
    world.link.set_rate(SLOW)
    shown(world, "the plan is for the slow link", lambda status: status["level_bytes_per_second"] < SLOW)
    confirmed(world)
    before = topics(world)
    generation = max(topic["confirmed"]["generation"] for topic in before.values())
    baseline = {name: topic["baseline"] for name, topic in before.items()}

    world.daemons["run"].kill()
    world.daemons.pop("run").wait()
    assert world.status() is None
    # Its last price may have been that of a full link; when it is over each topic keeps its DEADLINE all the same.
    over_s = time.monotonic() + PRICE_LASTS_S + 3.0
    eventually(
        "data arrives without a daemon",
        lambda: (
            time.monotonic() > over_s
            and all(newest_s(world, topic) < 1.0 for topic in ("/scan/front", "/imu", "/odom"))
        ),
    )

    world.start_daemon("run")
    confirmed(world)  # what runs may be what is planned; the plan itself comes a little later

    def is_taken_over(topic):
        return topic["topic"] not in HEAVY or topic["confirmed"]["generation"] > generation

    shown(
        world,
        "the new daemon takes all topics over",
        lambda status: len(status["topics"]) == 12 and all(map(is_taken_over, status["topics"])),
    )
    after = topics(world)
    assert set(after) == set(before)
    assert all(after[name]["offered"] > before[name]["offered"] for name in before)  # the same publishers
    assert {name: topic["baseline"] for name, topic in after.items()} == baseline

    daemon = world.daemons.pop("run")
    daemon.terminate()
    assert daemon.wait(timeout=30) == 0
    assert "every publisher has its original QoS back" in (world.workdir / "run.log").read_text()
