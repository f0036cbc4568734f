"""The figures of one turn of the paper's experiment: latency per sample, loss, and whether the machine kept up."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from scripts.bench.paper_cells import SENSORS

if TYPE_CHECKING:
    from scripts.bench.paper_cells import Configuration

    Numbers = np.ndarray[Any, np.dtype[np.int64]]
    Seconds = np.ndarray[Any, np.dtype[np.float64]]

REACHED_RATIO = 0.95  # of the rate asked for; less needs a cause
BUSY_RATIO = 0.95  # of the time on a core or waiting for one: the thread has no time left


def summary(
    configuration: Configuration,
    seconds: float,
    sensors: list[dict[str, Any]],
    arrived: dict[str, Any],
    actuated: dict[str, Any],
) -> dict[str, Any]:
    """Return the figures of one turn.

    Parameters
    ----------
    seconds : time that the sensors should publish (s)
    sensors : answers of the processes of sensors: ``sensors`` with the file of times, ``spent``
    arrived : answer of the planner: ``arrived`` per sensor, ``commands``, ``spent``
    actuated : answer of the actuator: files of numbers and times
    """
    left = {sensor["index"]: _read(sensor["left"]) for process in sensors for sensor in process["sensors"]}
    sensing = [_delays(each, left[index]) for index, each in enumerate(arrived["arrived"])]
    commands, received = _first(actuated)
    begun = np.array([left[number % SENSORS][number] for number in commands], dtype=np.int64)
    published = sum(map(len, left.values()))
    asked = sum(len(range(index, len(moments), SENSORS)) for index, moments in left.items())
    answered = len(np.unique(_read(arrived["commands"])))
    lost = published - sum(map(len, sensing)) + answered - len(commands)
    return {
        **_reached(configuration, seconds, sensors, published),
        **_effort(configuration, seconds, sensors, arrived["spent"]),
        "published": published + answered,
        "lost": lost,
        "sensing": {
            "count": sum(map(len, sensing)),
            "lost_ratio": 1.0 - sum(map(len, sensing)) / published if published else None,
            **latency(np.concatenate(sensing)),
        },
        "end_to_end": {
            "count": len(commands),
            "lost_ratio": 1.0 - len(commands) / asked if asked else None,
            **latency((received - begun) / 1e9),
        },
    }


def live_summary(
    configuration: Configuration,
    seconds: float,
    sensors: list[dict[str, Any]],
    arrived: dict[str, Any],
    actuated: dict[str, Any],
) -> dict[str, Any]:
    """Return the figures of one turn under arpd.

    What pacing withholds is not lost: it was never sent. On the eleven topics of sensing only samples of the measured
    time count; lost commands are those of the whole turn, warm-up included.

    Parameters
    ----------
    sensors : as in `summary`; beside its file each sensor has the ``first`` sample of the measured time, and the number
        of samples ``sent`` since
    arrived : answer of the planner: ``arrived`` per sensor, commands ``sent``, ``spent``
    actuated : answer of the actuator: files of numbers and times
    """
    every = {sensor["index"]: sensor for process in sensors for sensor in process["sensors"]}
    left = {index: _read(sensor["left"]) for index, sensor in every.items()}
    first = np.array([every[index]["first"] for index in range(SENSORS)])
    sensing = [_delays(each, left[index], since=first[index]) for index, each in enumerate(arrived["arrived"])]
    commands, received = _first(actuated)
    numbers, indices = np.divmod(commands, SENSORS)
    is_measured = numbers >= first[indices]
    begun = np.array([left[i][n] for n, i in zip(numbers, indices, strict=True)], dtype=np.int64)
    offered = sum(len(left[index]) - sensor["first"] for index, sensor in every.items())
    sent = sum(sensor["sent"] for sensor in every.values())
    came = sum(map(len, sensing))
    lost_commands = arrived["sent"] - len(commands)
    return {
        **_reached(configuration, seconds, sensors, offered),
        **_effort(configuration, seconds, sensors, arrived["spent"]),
        "published": sent + arrived["sent"],
        "lost": sent - came + lost_commands,
        "withheld_ratio": 1.0 - sent / offered if offered else None,
        "sensing": {
            "count": came,
            "lost_ratio": 1.0 - came / sent if sent else None,
            **latency(np.concatenate(sensing)),
        },
        "end_to_end": {
            "count": int(is_measured.sum()),
            "lost_ratio": lost_commands / arrived["sent"] if arrived["sent"] else None,
            **latency((received - begun)[is_measured] / 1e9),
        },
    }


def latency(values_s: Seconds) -> dict[str, float | None]:
    """Return mean and percentiles (s); None where nothing arrived."""
    if not len(values_s):
        return dict.fromkeys(("mean_s", "p50_s", "p95_s", "p99_s"))
    p50, p95, p99 = np.percentile(values_s, (50, 95, 99))
    return {"mean_s": float(values_s.mean()), "p50_s": float(p50), "p95_s": float(p95), "p99_s": float(p99)}


def _reached(
    configuration: Configuration, seconds: float, sensors: list[dict[str, Any]], published: int
) -> dict[str, Any]:
    """Return the reached share of the rate, and the share of the sensors' time that publish() slept in a call."""
    spent = [process["spent"] for process in sensors]
    blocked_s = sum(max(0.0, each["publish_s"] - each["cpu_s"] - each["core_wait_s"]) for each in spent)
    return {
        "reached_ratio": published / wanted(configuration, seconds, SENSORS),
        "blocked_ratio": blocked_s / sum(each["wall_s"] for each in spent),
    }


def _effort(
    configuration: Configuration, seconds: float, sensors: list[dict[str, Any]], planner: dict[str, float]
) -> dict[str, Any]:
    """Return the processor time of sensors and planner, and the process whose lack of it makes the turn void."""
    spent = [process["spent"] for process in sensors]
    return {
        "void": _void(configuration, seconds, sensors, planner),
        "sensors_cpu": sum(each["process_cpu_s"] for each in spent) / seconds,
        "planner_cpu": planner["process_cpu_s"] / planner["wall_s"],
        "sensors_core_wait": sum(each["core_wait_s"] for each in spent) / seconds,
        "planner_core_wait": planner["core_wait_s"] / planner["wall_s"],
    }


def wanted(configuration: Configuration, seconds: float, sensors: int) -> float:
    """Return the number of samples that so many sensors should publish."""
    return configuration.deadline_hz * seconds * sensors


def _void(
    configuration: Configuration, seconds: float, sensors: list[dict[str, Any]], planner: dict[str, float]
) -> str:
    """Return the process whose lack of CPU time makes the turn void; empty if none.

    A process of sensors below its rate had enough time if all samples would have fitted into it, at the time on a core
    and waiting for one that a sample took. Then publish() blocked, which is the middleware's answer to a full link.
    Otherwise this machine cannot generate that load.
    """
    for process in sensors:
        published = sum(len(_read(sensor["left"])) - sensor.get("first", 0) for sensor in process["sensors"])
        should = wanted(configuration, seconds, len(process["sensors"]))
        busy_s = process["spent"]["cpu_s"] + process["spent"]["core_wait_s"]
        if published < REACHED_RATIO * should and (not published or should * busy_s / published > seconds):
            return "generator"
    if planner["cpu_s"] + planner["core_wait_s"] > BUSY_RATIO * planner["wall_s"]:
        return "planner"
    return ""


def _read(path: str) -> Numbers:
    return np.fromfile(path, dtype=np.int64)


def _first(files: dict[str, str]) -> tuple[Numbers, Numbers]:
    """Return the numbers that arrived, each once, and the time of each first arrival (ns)."""
    numbers, at = np.unique(_read(files["numbers"]), return_index=True)
    return numbers, _read(files["received"])[at]


def _delays(files: dict[str, str], left: Numbers, *, since: int = 0) -> Seconds:
    """Return the latencies of the samples from a number on (s)."""
    numbers, received = _first(files)
    is_measured = numbers >= since
    delays: Seconds = (received - left[numbers])[is_measured] / 1e9
    return delays
