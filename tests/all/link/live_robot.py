"""A robot for tests, by default the demo's: live, with AdaptivePublishers and arpd, over a real link."""

from contextlib import ExitStack, contextmanager
from dataclasses import replace

from scripts.bench.robots import demo_robot
from scripts.bench.sides import SIDES
from scripts.bench.world import world_of
from scripts.robot.proxy import HTTP_PORT, window
from tests.waiting import eventually

FAST, SLOW = 20e6 / 8, 5e6 / 8
TOPICS = {topic.name for topic in demo_robot().topics}
# 5 Mbit/s cannot carry these topics at the source's rate; the others keep their rates and their deadlines.
HEAVY = {"/camera/image/compressed", "/points", "/scan/front", "/scan/rear"}
_AT_MOST_S = 3600.0


@contextmanager
def live_robot(workdir, robot=None, **options):
    """Yield the world of the publishing robot and a URL of its daemon."""
    side = replace(SIDES["adaptive"], warm_up_s=0.0)
    with (
        world_of(robot or demo_robot(), side, rate=FAST, logs=workdir, **options) as world,
        ExitStack() as stack,
        window(world.link.robot, HTTP_PORT) as url,
    ):
        assert world.start(stack) == []
        world.begin(_AT_MOST_S)
        yield world, url


def confirmed(world):
    """Return what each topic's publisher has confirmed; a daemon that has no time to answer is asked again."""
    status = eventually("the daemon answers", world.status)
    return {topic["topic"]: topic["confirmed"] for topic in status["topics"]}


def is_confirmed(world):
    """Return whether every topic is planned and confirmed."""
    status = world.status()
    return status is not None and (
        len(status["topics"]) == status["plan"]["topics"] == status["plan"]["confirmed"] == len(world.robot.topics)
    )
