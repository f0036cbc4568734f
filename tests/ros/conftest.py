"""Real rclpy for every test: its own context, on this host only, with executors in threads."""

import threading
from contextlib import ExitStack

import pytest

from tests.ros.domain import DOMAIN

rclpy = pytest.importorskip("rclpy", reason="ROS 2 is not installed")


class Ros:
    """Nodes of one test, each with its own executor."""

    def __init__(self, context, stack):
        self.context = context
        self._stack = stack

    def node(self, name, executor=None, **options):
        from rclpy.executors import SingleThreadedExecutor

        from scripts.bench.child import spinning

        node = rclpy.create_node(name, context=self.context, **options)
        chosen = executor or SingleThreadedExecutor(context=self.context)
        chosen.add_node(node)
        self._stack.callback(node.destroy_node)
        self._stack.enter_context(spinning(chosen))
        return node

    def elsewhere(self, domain=DOMAIN):
        """Return a maker of nodes in a participant of its own, as another process has."""
        context = rclpy.Context()
        rclpy.init(context=context, domain_id=domain)
        self._stack.callback(rclpy.try_shutdown, context=context)
        return Ros(context, self._stack)


@pytest.fixture
def ros(monkeypatch):
    monkeypatch.setenv("FASTDDS_BUILTIN_TRANSPORTS", "UDPv4")
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    from arpd.ros.runtime import prepare_environment

    prepare_environment()
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=DOMAIN)
    with ExitStack() as stack:
        yield Ros(context, stack)
    rclpy.try_shutdown(context=context)


@pytest.fixture(scope="module", autouse=True)
def _own_network(network):
    """Keep what a file of tests sends from the other workers."""


@pytest.fixture
def background():
    """Run a function in a thread until the test ends."""
    stopping = threading.Event()
    threads = []

    def start(work):
        thread = threading.Thread(target=work, args=(stopping,), daemon=True)
        thread.start()
        threads.append(thread)

    yield start
    stopping.set()
    for thread in threads:
        thread.join(timeout=5)


@pytest.fixture
def talking(background):
    """Let writers publish until the test ends, at most so many times a second."""

    def start(*writers, rate_hz=100):
        def talk(stopping):
            while not stopping.wait(1 / rate_hz):
                for writer in writers:
                    writer.publish()

        background(talk)

    return start
