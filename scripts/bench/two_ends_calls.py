"""Service calls and actions across the two ends, for `two_ends.py`: plain rclpy, a server and a caller.

The parent speaks to each in lines of JSON (`scripts.bench.child`).
"""

from __future__ import annotations

import queue
import sys
import time
from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from scripts.bench.child import answer, commands
from scripts.bench.node import plain_node

if TYPE_CHECKING:
    from collections.abc import Sequence

SERVICE, ACTION = "/count", "/fibonacci"
CALLS, GOALS = 1000, 100
CALL_FAILED_S = 12.0  # relay.call_timeout and what its answer takes
GOAL_FAILED_S = 40.0  # three calls of a service
_SPIN_S = 0.02
_FEEDBACKS, _WORK_S = 3, 0.1


@dataclass(slots=True)
class Call:
    """One call as its caller sees it."""

    begun_s: float
    answers: int = 0
    is_wrong: bool = False
    has_failed: bool = False
    took_s: float = 0.0

    def note(self, *, is_right: bool) -> None:
        self.answers += 1
        self.is_wrong = self.is_wrong or not is_right
        self.took_s = time.monotonic() - self.begun_s


def serve() -> None:
    """Answer calls and goals, and count the times that each ran."""
    from rclpy.action import ActionServer
    from rclpy.callback_groups import ReentrantCallbackGroup
    from rclpy.executors import MultiThreadedExecutor
    from test_msgs.action import Fibonacci
    from test_msgs.srv import BasicTypes

    node = plain_node("server")
    calls: Counter[int] = Counter()
    goals: Counter[int] = Counter()

    def on_call(request: Any, response: Any) -> Any:
        calls[request.int64_value] += 1
        response.int64_value = request.int64_value
        return response

    def on_goal(goal: Any) -> Any:
        number = goal.request.order
        goals[number] += 1
        for _ in range(_FEEDBACKS):
            goal.publish_feedback(Fibonacci.Feedback(sequence=[number]))
            time.sleep(_WORK_S)
        goal.succeed()
        return Fibonacci.Result(sequence=[number])

    group = ReentrantCallbackGroup()
    node.create_service(BasicTypes, SERVICE, on_call, callback_group=group)
    server = ActionServer(node, Fibonacci, ACTION, on_goal, callback_group=group)
    executor = MultiThreadedExecutor(4)
    executor.add_node(node)
    orders = commands()
    answer(open=True)
    while (order := _next(orders)) is not None:
        if order:
            answer(calls=dict(calls), goals=dict(goals))
        executor.spin_once(timeout_sec=_SPIN_S)
    server.destroy()


class Caller:
    """Spreads the calls and the goals over a time, and notes what becomes of each."""

    def __init__(self, node: Any, over_s: float) -> None:
        from action_msgs.msg import GoalStatus
        from rclpy.action import ActionClient
        from test_msgs.action import Fibonacci
        from test_msgs.srv import BasicTypes

        self._succeeded = GoalStatus.STATUS_SUCCEEDED
        self._over_s = over_s
        self._request, self._goal = BasicTypes.Request, Fibonacci.Goal
        self._client = node.create_client(BasicTypes, SERVICE)
        self._action_client = ActionClient(node, Fibonacci, ACTION)
        self.calls: dict[int, Call] = {}
        self.goals: dict[int, Call] = {}

    def is_ready(self) -> bool:
        return bool(self._client.service_is_ready() and self._action_client.server_is_ready())

    def step(self, elapsed_s: float) -> None:
        """Make what is due, and note what has failed."""
        share = min(1.0, elapsed_s / self._over_s)
        while len(self.calls) < CALLS * share:
            self._call(len(self.calls))
        while len(self.goals) < GOALS * share:
            self._send_goal(len(self.goals))
        for made, failed_s in ((self.calls, CALL_FAILED_S), (self.goals, GOAL_FAILED_S)):
            for one in made.values():
                one.has_failed = one.has_failed or (not one.answers and time.monotonic() - one.begun_s > failed_s)

    def document(self) -> dict[str, Any]:
        return {
            "calls": {number: _document(one) for number, one in self.calls.items()},
            "goals": {number: _document(one) for number, one in self.goals.items()},
        }

    def _call(self, number: int) -> None:
        noted = self.calls[number] = Call(time.monotonic())
        self._client.call_async(self._request(int64_value=number)).add_done_callback(
            lambda future: noted.note(is_right=future.result().int64_value == number)
        )

    def _send_goal(self, number: int) -> None:
        noted = self.goals[number] = Call(time.monotonic())

        def on_result(future: Any) -> None:
            if future.result().status == self._succeeded:
                noted.note(is_right=list(future.result().result.sequence) == [number])
            else:
                noted.has_failed = True

        def on_accepted(future: Any) -> None:
            if future.result().accepted:
                future.result().get_result_async().add_done_callback(on_result)
            else:
                noted.has_failed = True

        self._action_client.send_goal_async(self._goal(order=number)).add_done_callback(on_accepted)


def call(over_s: float) -> None:
    """Make the calls and the goals as the parent says."""
    from rclpy.executors import SingleThreadedExecutor

    node = plain_node("caller")
    caller = Caller(node, over_s)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    orders = commands()
    answer(open=True)
    begun_s = float("inf")
    while (order := _next(orders)) is not None:
        match order.get("do"):
            case "ready":
                answer(ready=caller.is_ready())
            case "begin":
                begun_s = time.monotonic()
                answer(begun=True)
            case "report":
                answer(**caller.document())
        caller.step(time.monotonic() - begun_s)
        executor.spin_once(timeout_sec=_SPIN_S)


def _document(one: Call) -> dict[str, Any]:
    return {
        "begun_s": one.begun_s,
        "answers": one.answers,
        "is_wrong": one.is_wrong,
        "has_failed": one.has_failed,
        "took_s": one.took_s,
    }


def _next(orders: Any) -> dict[str, Any] | None:
    """Return the parent's next order, empty if there is none, None if the parent is gone."""
    try:
        return orders.get_nowait()  # type: ignore[no-any-return]
    except queue.Empty:
        return {}


def summary(
    made: dict[str, dict[str, Any]], ran: dict[str, int], deaf: Sequence[tuple[float, float]] = ()
) -> dict[str, Any]:
    """Return the calls by what became of them.

    Parameters
    ----------
    made : each call as its caller saw it, by its number
    ran : times that each ran at the server, by its number
    deaf : begin and end of the times in which the ends did not hear each other (monotonic s)
    """
    failed = [one for one in made.values() if one["has_failed"]]
    answered = {number: one for number, one in made.items() if one["answers"]}
    took = sorted(one["took_s"] for one in answered.values())
    return {
        "made": len(made),
        "answered": len(answered),
        "failed": len(failed),
        "failed_meanwhile": sum(
            any(begin_s < one["begun_s"] + one["took_s"] and one["begun_s"] < over_s for begin_s, over_s in deaf)
            for one in failed
        ),
        "both": sum(one["has_failed"] for one in answered.values()),
        "neither": sum(not one["answers"] and not one["has_failed"] for one in made.values()),
        "answered_twice": sum(one["answers"] > 1 for one in answered.values()),
        "wrong": sum(one["is_wrong"] for one in answered.values()),
        "ran_twice": sum(many > 1 for many in ran.values()),
        "answered_but_never_ran": sum(number not in ran for number in answered),
        "failed_but_ran": sum(one["has_failed"] and number in ran for number, one in made.items()),
        "median_s": took[len(took) // 2] if took else None,
        "longest_s": took[-1] if took else None,
    }


if __name__ == "__main__":
    if sys.argv[1] == "serve":
        serve()
    else:
        call(float(sys.argv[2]))
