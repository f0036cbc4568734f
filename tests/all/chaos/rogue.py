"""A process that floods arpd's topics with false messages, until it is killed."""

import json
import random
import sys
import time

import rclpy
from rclpy.qos import QoSProfile, QoSReliabilityPolicy
from rclpy.serialization import serialize_message
from std_msgs.msg import Float64MultiArray, UInt8MultiArray

from arpd.model.endpoints import MOST_PUBLISHERS
from arpd.model.plan import PlanAnswer
from arpd.model.probing import PeerReport, Train
from arpd.ros.cdr import wrap
from arpd.ros.documents import expand, pack
from arpd.ros.names import PRICE_TOPIC, PUBLISHERS_TOPIC, REPORT_TOPIC
from arpd.ros.node_snapshot import LIKELY, LONGEST_SNAPSHOT, MOST_BYTES, encode_snapshot
from arpd.ros.probe_messages import encode_report
from tests.sample_publishers import publisher

BATCHES_HZ = 50.0
WRITERS = 12
honest_topic = sys.argv[1]
draw = random.Random(1)
HUGE = {"payload_bytes": 2.0**30, "source_rate_hz": 1e5}


def snapshot(node, *topics):
    states = [publisher(node, topic, **HUGE) for topic in topics]
    return encode_snapshot(node, states, answer=PlanAnswer(generation=2**53))


def report(name, number):
    trains = (Train(payload_bytes=1_000_000, duration_s=1e-4, packets=24),)
    message = PeerReport(
        peer=name, received_at_s=0.0, interval_s=0.1, rx_bytes=10**9, rx_packets=9, trains=trains, last_probe=number
    )
    return wrap(encode_report(message))


def spoilt(data):
    data = bytearray(data)
    for _ in range(4):
        data[draw.randrange(4, len(data))] = draw.randrange(256)
    return bytes(data)


# Invented nodes, and a real one with topics that it does not write.
snapshots = [snapshot(f"/rogue{k}", f"/invented{k}") for k in range(300)]
snapshots += [snapshot("/rogue", *(f"/own{k}" for k in range(250))), snapshot("/rogue", honest_topic)]
crowd = json.loads(expand(snapshots[-2], most_bytes=MOST_BYTES, likely=LIKELY))
long = {name: (MOST_PUBLISHERS // 250 + 1) * values for name, values in crowd["publishers"].items()}
snapshots += [pack({**crowd, "publishers": long}, likely=LIKELY), b"{}"]
snapshots = [wrap(data) for data in snapshots]
snapshots += [spoilt(draw.choice(snapshots)) for _ in range(100)]
crowds = [wrap(snapshot(f"/crowd{k}", *(f"/of{k}/t{number}" for number in range(250)))) for k in range(WRITERS)]
large = wrap(bytes(LONGEST_SNAPSHOT + 1))
reports = [report("base", draw.randrange(2**32)) for _ in range(50)] + [report(f"liar{k}", k) for k in range(50)]
reports += [spoilt(data) for data in reports]
prices = [serialize_message(Float64MultiArray(data=numbers)) for numbers in ([1.0], 1000 * [1.0])]
reports.append(wrap(bytes(4000)))

rclpy.init()
node = rclpy.create_node("rogue")
qos = QoSProfile(depth=1000, reliability=QoSReliabilityPolicy.BEST_EFFORT)
to_daemon, *to_fill = (node.create_publisher(UInt8MultiArray, PUBLISHERS_TOPIC, qos) for _ in range(1 + WRITERS))
to_reports = node.create_publisher(UInt8MultiArray, REPORT_TOPIC, qos)
to_daemons = node.create_publisher(Float64MultiArray, PRICE_TOPIC, qos)
due_s = time.monotonic()
batch = 0
while True:
    batch += 1
    for data in draw.choices(snapshots, k=35):
        to_daemon.publish(data)
    for data in draw.choices(reports, k=5):
        to_reports.publish(data)
    if batch % 5 == 0:
        to_daemons.publish(draw.choice(prices))
    if batch % 25 == 1:
        for writer, data in zip(to_fill, crowds, strict=True):
            writer.publish(data)
    if batch % 5 == 1:
        to_daemon.publish(large)
    due_s = max(due_s + 1 / BATCHES_HZ, time.monotonic())
    time.sleep(max(0.0, due_s - time.monotonic()))
