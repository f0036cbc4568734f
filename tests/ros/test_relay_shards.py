"""The process of a relay with more topics than one DDS participant should carry."""

import json
import os
import re
import signal
import socket
from contextlib import closing
from types import SimpleNamespace

import pytest
from sensor_msgs.msg import Image
from std_msgs.msg import String

from arpd import AdaptivePublisher
from arpd.model.settings import RelaySettings, RelayTopic
from arpd.relay.ends.prefix import Participants, Prefixed
from tests.ros.ends_world import listen
from tests.ros.world import DOMAIN

TOPICS = tuple(f"/t{k}" for k in range(110))
NODES = ("/big_relay", "/big_relay_2")


@pytest.fixture
def notices():
    """Return a socket that receives what the relay tells systemd."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as heard:
        heard.bind(f"\0arpd-test-{os.getpid()}-shards")
        heard.settimeout(60.0)
        yield heard


@pytest.fixture
def relay(arpd, notices, tmp_path):
    """Start a relay of all topics."""
    config = tmp_path / "arpd.yaml"
    config.write_text(json.dumps({"relay": {"topics": [{"name": topic} for topic in TOPICS]}}))
    environment = {"NOTIFY_SOCKET": "@" + notices.getsockname()[1:].decode(), "WATCHDOG_USEC": "20000000"}
    return arpd("relay", "--config", config, "--node-name", "big_relay", **environment)


def until(notices, text):
    """Wait for a notice to systemd."""
    while notices.recv(1 << 20).decode() != text:
        pass


def test_shards_carry_all_topics_as_one_relay(ros, relay, notices, tmp_path, eventually):
    """Two nodes carry 110 topics; status, watchdog and stop are those of one process, and none carries twice."""
    until(notices, "READY=1")
    source, far = ros.node("source"), ros.node("far")
    received = [listen(far, f"/link{topic}", 10) for topic in TOPICS]
    publishers = [source.create_publisher(String, topic, 10) for topic in TOPICS]
    until(notices, f"STATUS=relaying {len(TOPICS)} of {len(TOPICS)} topics")

    def writers(topic):
        return [f"/{each.node_name}" for each in far.get_publishers_info_by_topic(topic)]

    def carriers():
        found = [writers(f"/link{topic}") for topic in TOPICS]
        return {*map(len, found)} == {1} and {name for (name,) in found}

    eventually("each topic has one of the two carriers", lambda: carriers() == set(NODES))
    eventually("each topic has one reader", lambda: all(each.get_subscription_count() == 1 for each in publishers))

    def all_arrive():
        for publisher in publishers:
            publisher.publish(String(data="x"))
        return all(received)

    eventually("a sample of each topic arrives", all_arrive)
    eventually("each node announces its publishers", lambda: {*writers("/arpd/publishers")} == set(NODES))
    until(notices, "WATCHDOG=1")
    relay.send_signal(signal.SIGTERM)
    until(notices, "STOPPING=1")
    assert relay.wait(60) == 0
    log = (tmp_path / "log").read_text()
    assert not re.search("Traceback|Error|failed", log), log


def test_a_topic_of_large_samples_has_a_participant_of_its_own(ros, stack, monkeypatch, eventually):
    """Images and what else has octets leave by another node than the rest, so that nothing waits behind them."""
    monkeypatch.setenv("ROS_DOMAIN_ID", str(DOMAIN))
    # A relay carries what other processes publish.
    source, far, kinds = ros.elsewhere().node("source"), ros.node("far"), {"/image": Image, "/chatter": String}
    publishers = [source.create_publisher(kind, topic, 10) for topic, kind in kinds.items()]
    heard = [listen(far, f"/link{topic}", 10, kind) for topic, kind in kinds.items()]
    node = ros.node("mixed")
    settings = RelaySettings(topics=(RelayTopic(name="/image"), RelayTopic(name="/chatter")))
    relay = stack.enter_context(closing(Prefixed(node, settings, tell=lambda _status: None)))

    def carriers():
        relay.look()
        found = [far.get_publishers_info_by_topic(topic) for topic in ("/link/image", "/link/chatter")]
        return [info.node_name for infos in found for info in infos]

    eventually("each has its carrier", lambda: carriers() == ["mixed_2", "mixed"])

    def both_arrive():
        relay.look()
        publishers[0].publish(Image(data=bytes(300_000)))
        publishers[1].publish(String(data="x"))
        return all(heard)

    eventually("both arrive", both_arrive)


def test_topics_of_large_samples_that_share_a_participant_are_named(ros, stack, monkeypatch, eventually):
    """Two such topics more than there may be participants for them are named, and so is the one they join."""
    monkeypatch.setenv("ROS_DOMAIN_ID", str(DOMAIN))
    monkeypatch.setattr("arpd.relay.ends.prefix._MOST_LARGE", 1)
    participants, warnings = stack.enter_context(closing(Participants(ros.node("crowded")))), []
    (node,) = {participants.of(topic, is_large=True) for topic in TOPICS[:3]}
    logger = SimpleNamespace(warning=lambda words, **_throttle: warnings.append(words))
    monkeypatch.setattr(node, "get_logger", lambda: logger)
    publishers = [AdaptivePublisher(node, Image, topic, 10) for topic in TOPICS[:3]]
    for publisher in publishers:
        publisher.pass_on(Image(data=bytes(300_000)))

    def named():
        return [words.split()[0] for words in warnings if "wait inside Fast DDS" in words]

    eventually("each is named once", lambda: named() == [*TOPICS[:3]])
