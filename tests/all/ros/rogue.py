"""A process that floods arpd's topics with false messages, from its first line of input until it is killed."""

import random
import sys
import time

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.qos import QoSProfile, QoSReliabilityPolicy
from rclpy.serialization import serialize_message
from std_msgs.msg import UInt8MultiArray

from arpd.adapters.ros.announcement import to_status
from arpd.adapters.ros.counters import encode_counters, row_of
from arpd.adapters.ros.daemons import to_status as heartbeat_to_status
from arpd.adapters.ros.names import COUNTERS_TOPIC, DAEMONS_TOPIC, PUBLISHERS_TOPIC, REPORT_TOPIC
from arpd.adapters.ros.plan_message import PlanAnswer
from arpd.adapters.ros.probe_messages import encode_report
from arpd.model.probing import PeerReport, Train
from arpd.observe.leader import LEAST_STARTED_NS, DaemonHeartbeat
from tests.sample_publishers import publisher

BATCHES_HZ = 50.0
honest_node, honest_topic = sys.argv[1:]
draw = random.Random(1)
HUGE = {"payload_bytes": 2.0**30, "source_rate_hz": 1e5, "generation": 2**53}


def announcement(*statuses):
    return serialize_message(DiagnosticArray(status=list(statuses)))


def counters(node, rows):
    data = encode_counters(node, rows, incarnation=1, answer=PlanAnswer(generation=2**53), lease_s=0.0)
    return serialize_message(UInt8MultiArray(data=data))


def report(name, number):
    trains = (Train(payload_bytes=1_000_000, duration_s=8e-6, packets=24),)
    message = PeerReport(
        peer=name, received_at_s=0.0, interval_s=0.1, rx_bytes=2**32 - 1, rx_packets=9, trains=trains, last_probe=number
    )
    return serialize_message(encode_report(message))


def spoilt(data):
    data = bytearray(data)
    for _ in range(4):
        data[draw.randrange(4, len(data))] = draw.randrange(256)
    return bytes(data)


writers = [announcement(to_status(publisher(f"/rogue{k}", f"/invented{k}", **HUGE))) for k in range(3000)]
# A real node, with topics that it does not write, and with too many of them.
own = [
    announcement(*(to_status(publisher("/rogue", f"/own{k}", **HUGE)) for k in range(of, of + 100)))
    for of in range(900)[::100]
]
own += [announcement(*(to_status(publisher("/rogue", f"/many{k}")) for k in range(300)))]
own += [announcement(to_status(publisher("/rogue", honest_topic, **HUGE)))]  # another node writes this topic
own += [announcement(DiagnosticStatus(name="/rogue: /t", values=[KeyValue(key="node", value="/rogue")]))]
own += [announcement(to_status(publisher("/rogue", "/x")), to_status(publisher(honest_node, honest_topic, **HUGE)))]
own += [spoilt(own[0]) for _ in range(20)]
long = announcement(DiagnosticStatus(name="/rogue: /t", message="x" * 600_000))
reports = [report("ceddp", draw.randrange(2**32)) for _ in range(50)] + [report(f"liar{k}", k) for k in range(50)]
reports += [spoilt(data) for data in reports]
# Numbers of nodes that are not there, of too many publishers, and of publishers that nobody announced.
nothing = row_of(1, 0, told=publisher("/n", "/t"), now=publisher("/n", "/t", offered=9))
numbers = [counters(f"/rogue{k}", [nothing]) for k in range(300)]
numbers += [counters("/rogue", [nothing] * 300), counters("/rogue", [nothing] * 3), counters("no name", [])]
numbers += [spoilt(numbers[-2]) for _ in range(20)] + [serialize_message(UInt8MultiArray(data=bytes(40_000)))]
heartbeat = announcement(heartbeat_to_status(DaemonHeartbeat(started_ns=LEAST_STARTED_NS, token="0" * 32, host="liar")))
heartbeats = [heartbeat, spoilt(heartbeat), announcement(DiagnosticStatus(name="arpd on " + "x" * 4000))]
reports.append(serialize_message(UInt8MultiArray(data=bytes(4000))))

rclpy.init()
node = rclpy.create_node("rogue")
qos = QoSProfile(depth=1000, reliability=QoSReliabilityPolicy.BEST_EFFORT)
to_publishers = node.create_publisher(DiagnosticArray, PUBLISHERS_TOPIC, 1000)
to_reports = node.create_publisher(UInt8MultiArray, REPORT_TOPIC, qos)
to_counters = node.create_publisher(UInt8MultiArray, COUNTERS_TOPIC, qos)
to_daemons = node.create_publisher(DiagnosticArray, DAEMONS_TOPIC, 10)
sys.stdin.readline()
due_s = time.monotonic()
batch = 0
while True:
    batch += 1
    for data in draw.choices(writers, k=25):
        to_publishers.publish(data)
    to_publishers.publish(draw.choice(own))
    for data in draw.choices(numbers, k=10):
        to_counters.publish(data)
    for data in draw.choices(reports, k=5):
        to_reports.publish(data)
    if batch % 5 == 0:
        to_daemons.publish(heartbeats[batch // 5 % 3])
    if batch % 25 == 0:
        to_publishers.publish(long)
    due_s = max(due_s + 1 / BATCHES_HZ, time.monotonic())
    time.sleep(max(0.0, due_s - time.monotonic()))
