"""Thousands of swaps on the simulated link: what grows, and whether a subscriber is lost.

Usage: .venv/bin/python scripts/bench/soak.py [--quick] [--swaps N] [--seconds S] [--json FILE] [--plot FILE]

Needs root, as the simulated link does.

One node on the robot publishes 12 topics through AdaptivePublishers, and their depth is set by parameter as soon as
the topic's last swap has ended; one process on the other host reads them all. Memory, threads and open files of both
are noted every hundred swaps and compared with those after the first 500.
"""

from __future__ import annotations

import argparse
import queue
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Sequence

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from arpd.cli.progress import progress
from scripts.bench.child import Child, ChildError, commands, number_of, sample_of, say
from scripts.bench.record import conditions, keep, target
from scripts.bench.soak_report import verdict
from scripts.netns.simlink import SimLink

TOPICS = 12
RATE_HZ = 20.0
DEPTH = 20
PAYLOAD_BYTES = 100
EVERY = 100
SWAPS, QUICK_SWAPS = 10_000, 300
STUCK_S = 20.0
_POLL_S = 0.005


def topic_name(k: int) -> str:
    return f"/soak/t{k}"


class Writers:
    """The 12 publishers and whoever keeps changing their settings."""

    def __init__(self) -> None:
        import rclpy
        from std_msgs.msg import String

        from arpd import AdaptivePublisher
        from arpd.adapters.ros.names import DEPTH as DEPTH_SETTING
        from arpd.adapters.ros.names import parameter_name
        from arpd.apply.endpoint.writer_swap import SwapTiming

        rclpy.init(signal_handler_options=rclpy.SignalHandlerOptions.NO)
        self.node = rclpy.create_node("soak_writer")
        # This link loses nothing; to settle for 3 s would only make the same swaps last longer.
        timing = SwapTiming(settle_s=0.1)
        self.publishers = [
            AdaptivePublisher(self.node, String, topic_name(k), DEPTH, swap_timing=timing) for k in range(TOPICS)
        ]
        self._names = [parameter_name(topic_name(k), DEPTH_SETTING) for k in range(TOPICS)]
        self._asked = [0] * TOPICS
        self._asked_s = [0.0] * TOPICS
        self.sent = 0
        self.is_publishing = True

    def publish(self) -> None:
        """Publish every topic at its rate until told to stop."""
        due_s = time.monotonic()
        while self.is_publishing:
            for publisher in self.publishers:
                publisher.publish(sample_of(self.sent, PAYLOAD_BYTES))
            self.sent += 1
            due_s += 1.0 / RATE_HZ
            time.sleep(max(0.0, due_s - time.monotonic()))

    def results(self) -> dict[str, int]:
        total: dict[str, int] = {}
        for publisher in self.publishers:
            for key, count in publisher.state(generation=0).swaps_by_result.items():
                total[key] = total.get(key, 0) + count
        return total

    def ask(self, most: int) -> int:
        """Set the depth wherever the last swap has ended; return how many were asked for so far."""
        from rclpy.parameter import Parameter

        now_s = time.monotonic()
        for k, publisher in enumerate(self.publishers):
            swaps = publisher.state(generation=0).swaps_by_result
            ended = sum(count for key, count in swaps.items() if key != "undelivered")
            has_sent_nothing = now_s - self._asked_s[k] > STUCK_S
            if (ended >= self._asked[k] or has_sent_nothing) and sum(self._asked) < most:
                self._asked[k] = max(ended, self._asked[k]) + 1
                self._asked_s[k] = now_s
                depth = DEPTH + self._asked[k] % 2
                answer = self.node.set_parameters_atomically([Parameter(self._names[k], value=depth)])
                assert answer.successful, answer.reason
        return sum(self._asked)


def write(most: int) -> None:
    """Swap as often as asked, telling the parent every hundred."""
    from arpd.adapters.ros.relay import best_executor
    from arpd.adapters.ros.runtime import spinning

    writers = Writers()
    told = commands()
    until_s = time.monotonic() + 20.0
    while any(p.get_subscription_count() < 1 for p in writers.publishers) and time.monotonic() < until_s:
        time.sleep(0.05)
    time.sleep(0.5)
    executor = best_executor()
    executor.add_node(writers.node)
    with spinning(executor):
        thread = threading.Thread(target=writers.publish)
        thread.start()
        told_of = 0
        is_over = False
        while not is_over:
            is_over = (asked := writers.ask(most)) >= most
            if asked >= told_of + EVERY or is_over:
                told_of = asked
                say(swaps=asked, results=writers.results())
            with suppress(queue.Empty):
                told.get(timeout=_POLL_S)
                is_over = True
        time.sleep(6.0)  # the last old writer drains for 4 s at most
        writers.is_publishing = False
        thread.join()
        say(done=True, swaps=asked, sent=writers.sent, results=writers.results())
        told.get()


def read() -> None:
    """Count what arrives on every topic; what is not newer than all before it is out of order or doubled."""
    import rclpy
    from rclpy.qos import QoSProfile
    from std_msgs.msg import String

    rclpy.init(signal_handler_options=rclpy.SignalHandlerOptions.NO)
    node = rclpy.create_node("soak_reader")
    subscriptions = [
        node.create_subscription(String, topic_name(k), lambda _sample: None, QoSProfile(depth=1000), raw=True)
        for k in range(TOPICS)
    ]
    received, highest, late = [0] * TOPICS, [-1] * TOPICS, [0] * TOPICS
    told = commands()
    say(open=True)
    while True:
        for k, subscription in enumerate(subscriptions):
            handle = subscription.handle
            with handle:
                while (taken := handle.take_message(String, True)) is not None:  # noqa: FBT003 - rclpy's own signature
                    number = number_of(taken[0])
                    received[k] += 1
                    late[k] += number <= highest[k]
                    highest[k] = max(highest[k], number)
        with suppress(queue.Empty):
            if told.get(timeout=_POLL_S) is None:
                return
            say(received=received, highest=highest, late=late, writers=[s.get_publisher_count() for s in subscriptions])


def footprint(pid: int) -> dict[str, int]:
    status = dict(line.split(":", 1) for line in Path(f"/proc/{pid}/status").read_text(encoding="utf-8").splitlines())
    return {
        "rss_bytes": int(status["VmRSS"].split()[0]) * 1024,
        "threads": int(status["Threads"]),
        "files": len(list(Path(f"/proc/{pid}/fd").iterdir())),
    }


def soak(swaps: int, seconds: float) -> dict[str, Any]:
    """Run it, and return what was noted."""
    notes: list[dict[str, Any]] = []
    with SimLink(f"soak-{time.monotonic_ns() % 10**9}") as link, progress("swapping", total=swaps) as shown:
        reader = Child(link, "ceddp", "scripts.bench.soak", "--role", "reader")
        reader.hear()
        writer = Child(link, "robot", "scripts.bench.soak", "--role", "writer", "--swaps", str(swaps))
        started_s = time.monotonic()
        is_stopped = False
        said: dict[str, Any] = {}
        while "done" not in said:
            said = writer.hear(timeout_s=STUCK_S + 40.0)
            elapsed_s = time.monotonic() - started_s
            note = {
                "elapsed_s": elapsed_s,
                "swaps": said["swaps"],
                "results": said["results"],
                "writer": footprint(writer.process.pid),
                "reader": footprint(reader.process.pid),
                **reader.ask(tell=True),
            }
            notes.append(note)
            shown.reach(said["swaps"], f"{said['swaps']} of {swaps}")
            if len(notes) % 5 == 1 or "done" in said:
                print(row(note), flush=True)
            if elapsed_s > seconds and not is_stopped:
                writer.tell(stop=True)
                is_stopped = True
        writer.tell(end=True)
        time.sleep(1.0)
        last = reader.ask(tell=True)
        for child in (writer, reader):
            child.end()
    return {"notes": notes, "sent": said["sent"], **last}


def row(note: dict[str, Any]) -> str:
    writer, reader = note["writer"], note["reader"]
    return (
        f"{note['elapsed_s']:>7.0f}{note['swaps']:>8}"
        f"{writer['rss_bytes'] / 2**20:>9.2f}{writer['threads']:>5}{writer['files']:>5}"
        f"{reader['rss_bytes'] / 2**20:>9.2f}{reader['threads']:>5}{reader['files']:>5}"
        f"{min(note['received']):>10}{sum(note['late']):>6}  "
        + " ".join(f"{count} {key}" for key, count in sorted(note["results"].items()))
    )


def draw(notes: Sequence[dict[str, Any]], target: Path) -> None:
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(figsize=(8, 4), layout="constrained")
    for name in ("writer", "reader"):
        axes.plot([note["swaps"] for note in notes], [note[name]["rss_bytes"] / 2**20 for note in notes], label=name)
    axes.set_xlabel("swaps")
    axes.set_ylabel("resident memory (MiB)")
    axes.grid(visible=True, alpha=0.3)
    axes.legend()
    figure.savefig(target, dpi=110)
    plt.close(figure)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--swaps", type=int, default=SWAPS, metavar="N", help="default %(default)s")
    parser.add_argument("--quick", action="store_true", help=f"{QUICK_SWAPS} swaps, some ten seconds")
    parser.add_argument("--seconds", type=float, default=3600.0, metavar="S", help="stop earlier after this long")
    parser.add_argument("--json", type=Path, metavar="FILE", help="default results/soak.json")
    parser.add_argument("--plot", type=Path, metavar="FILE", help="default results/soak.png")
    parser.add_argument("--role", choices=("writer", "reader"), help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.role == "writer":
        write(options.swaps)
    elif options.role == "reader":
        read()
    else:
        print(f"{'':>15}{'writer':^19}{'reader':^19}")
        print(f"{'s':>7}{'swaps':>8}" + 2 * f"{'MiB':>9}{'thr':>5}{'fds':>5}" + f"{'received':>10}{'late':>6}  swaps")
        noted = conditions()
        try:
            document = soak(QUICK_SWAPS if options.quick else options.swaps, options.seconds)
        except ChildError as error:
            sys.exit(f"soak: {error}")
        print("\n".join(["", *verdict(document)]))
        keep({"conditions": noted, **document}, target(options.json, "soak.json", is_partial=options.quick))
        if plot := target(options.plot, "soak.png", is_partial=options.quick):
            draw(document["notes"], plot)
            print(plot)
        if not min(document["received"]):
            sys.exit("soak: nothing arrived on some topic")


if __name__ == "__main__":
    main()
