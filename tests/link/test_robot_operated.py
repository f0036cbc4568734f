"""A live robot under operation: scrape, reload, kill and stop of its daemon. No test here compares times."""

import signal
import time
import urllib.request

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from arpd.adapters.sim.demo import COMMAND_TOPIC
from scripts.netns.simlink import available
from scripts.robot.run import PREFIX
from scripts.robot.sensors import SENSORS
from tests.link.live_robot import HEAVY, SLOW, is_confirmed, live_robot, received, topics
from tests.waiting import eventually

CAN, WHY = available()
pytestmark = [pytest.mark.link, pytest.mark.ros, pytest.mark.skipif(not CAN, reason=WHY)]


def confirmed(side):
    """Wait until every topic confirms its plan; longer than elsewhere, because other tests run beside this."""
    eventually(lambda: is_confirmed(side), timeout_s=60.0)


def shown(side, condition):
    """Wait until the status fulfils a condition; a daemon that has no time to answer is asked again."""
    eventually(lambda: (status := side.status()) is not None and condition(status), timeout_s=60.0)


@pytest.fixture(scope="module")
def side(tmp_path_factory):
    """Share one robot among all tests, because its start costs more than any of them."""
    with live_robot(tmp_path_factory.mktemp("robot")) as side:
        yield side


def test_metrics_of_a_live_robot_name_every_topic(side):
    """The metrics of a live daemon name every managed topic, and it says that it is healthy and ready."""
    confirmed(side)
    with urllib.request.urlopen(f"{side.url}/metrics", timeout=5) as answer:
        text = answer.read().decode()
    for topic in (*(PREFIX + name for name in SENSORS), COMMAND_TOPIC):
        assert f'topic="{topic}"' in text
    for path in ("/-/healthy", "/-/ready"):
        with urllib.request.urlopen(side.url + path, timeout=5) as answer:
            assert answer.status == 200


def test_a_bad_reload_keeps_the_running_plan(side):
    """A reload of a broken file keeps plan and process; the status shows the fault until a good file clears it."""
    confirmed(side)
    good = side.config.read_text()
    daemon, before = side.processes["run"], side.status()["totals"]
    side.config.write_text(good + "\nlink:\n  headrom: 0.5\n")
    side.signal(signal.SIGHUP, "run")
    shown(side, lambda status: "headrom" in status["config"]["error"])
    shown(side, lambda status: "arpd.yaml:" in status["config"]["error"] and status["totals"]["reloads"]["failed"] == 1)
    confirmed(side)
    after = side.status()["totals"]
    assert after["levels"].get("reload", 0) == before["levels"].get("reload", 0)  # the link may have its own reasons
    assert after["ticks"] > before["ticks"]
    assert daemon.poll() is None

    side.config.write_text(good + "\nlink:\n  headroom: 0.4\n")
    side.signal(signal.SIGHUP, "run")
    shown(side, lambda status: not status["config"]["error"] and status["totals"]["reloads"]["ok"] == 1)
    shown(side, lambda status: status["totals"]["levels"].get("reload", 0) > before["levels"].get("reload", 0))
    confirmed(side)
    shown(side, lambda status: status["level_bytes_per_second"] < 0.45 * status["link"]["capacity_bytes_per_second"])
    side.config.write_text(good)
    side.signal(signal.SIGHUP, "run")
    shown(side, lambda status: status["totals"]["reloads"]["ok"] == 2)


def test_the_daemon_may_die_and_return(side):
    """After kill -9 data flows under the last plan; a new daemon takes over, and a clean stop restores the QoS."""
    confirmed(side)
    side.link.set_rate(SLOW)
    shown(side, lambda status: status["level_bytes_per_second"] < SLOW)
    confirmed(side)
    before = topics(side)
    generation = max(topic["confirmed"]["generation"] for topic in before.values())
    baseline = {name: topic["baseline"] for name, topic in before.items()}

    side.processes["run"].kill()
    side.processes.pop("run").wait()
    assert side.status() is None
    # Its last price may have been that of a full link; five seconds later each topic keeps its DEADLINE all the same.
    time.sleep(8.0)
    assert all(received(side, topic) > 0 for topic in ("/scan/front", "/imu", "/odom"))

    side.start_daemon()
    confirmed(side)  # what runs may be what is planned; the plan itself comes a little later

    def is_taken_over(topic):
        return topic["topic"] not in HEAVY or topic["confirmed"]["generation"] > generation

    shown(side, lambda status: len(status["topics"]) == 12 and all(map(is_taken_over, status["topics"])))
    after = topics(side)
    assert set(after) == set(before)
    assert all(after[name]["offered"] > before[name]["offered"] for name in before)  # the same publishers
    assert {name: topic["baseline"] for name, topic in after.items()} == baseline

    side.stop("run")
    assert side.processes.pop("run").returncode == 0
    assert "every publisher has its original QoS back" in (side.workdir / "run.log").read_text()
