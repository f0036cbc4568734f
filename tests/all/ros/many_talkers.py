"""Nodes with many AdaptivePublishers each, in one process; they publish until their standard input ends."""

import sys
import threading
import time

import rclpy
from rclpy.executors import SingleThreadedExecutor
from std_msgs.msg import String

from arpd import AdaptivePublisher
from arpd.ros.runtime import prepare_environment

HZ = 1.0


def spin(executor):
    while True:
        executor.spin_once(timeout_sec=1.0)


def main():
    nodes, topics = map(int, sys.argv[1:])
    prepare_environment()
    publishers = []
    for number in range(nodes):
        context = rclpy.Context()
        rclpy.init(context=context)
        node = rclpy.create_node(f"talker{number}", context=context)
        executor = SingleThreadedExecutor(context=context)
        executor.add_node(node)
        threading.Thread(target=spin, args=(executor,), daemon=True).start()
        begun_s = time.process_time()
        publishers += [AdaptivePublisher(node, String, f"/many/t{number}_{topic}", 10) for topic in range(topics)]
        print(f"{topics} publishers in {time.process_time() - begun_s:.2f} s of CPU", flush=True)
    print("ready", flush=True)
    threading.Thread(target=lambda: sys.stdin.read() or sys.exit(), daemon=True).start()
    sample = String(data="x" * 100)
    while True:
        begun_s = time.monotonic()
        for publisher in publishers:
            publisher.publish(sample)
        time.sleep(max(0.0, begun_s + 1 / HZ - time.monotonic()))


main()
