"""ROS 2 as an interpreter of this computer sees it, tried in a process of its own, which may crash."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from arpd.model.quantities import printable

if TYPE_CHECKING:
    from collections.abc import Callable

_ROS = Path("/opt/ros")
SYSTEM_PYTHON = Path("/usr/bin/python3")
_TIMEOUT_S = 20.0
_MOST_FAULT = 160
# Each line tells all that is known so far. The message has a fixed array, which numpy holds.
_PROBE = """
import importlib.util, json, sys
facts = {}
def tell(**more):
    facts.update(more)
    print(json.dumps(facts), flush=True)
if sys.prefix != sys.base_prefix:
    tell(venv=sys.prefix)
try:
    import numpy
    tell(numpy=numpy.__version__, numpy_file=numpy.__file__)
except ImportError:
    pass
try:
    found = importlib.util.find_spec("rclpy")
    tell(rclpy=found.origin if found else "")
    import rclpy
    from rclpy.utilities import get_rmw_implementation_identifier
    tell(rmw=get_rmw_implementation_identifier())
    from rclpy.serialization import serialize_message
    from unique_identifier_msgs.msg import UUID
    serialize_message(UUID())
    tell(works=True)
except BaseException as error:
    tell(fault=f"{type(error).__name__}: {error}")
"""


@dataclass(frozen=True, kw_only=True, slots=True)
class PythonRos:
    """ROS as one Python sees it.

    Parameters
    ----------
    python : path of the interpreter
    rclpy : file of rclpy, which may not work, empty = there is none
    numpy, numpy_file : version and file of numpy, empty = there is none
    venv : folder of the virtual environment, empty = the interpreter has none
    rmw : identifier of the middleware, empty = not known
    fault : why ROS does not work there, empty if it does
    silence : why the interpreter did not answer at all, empty if it did
    """

    python: str
    rclpy: str = ""
    numpy: str = ""
    numpy_file: str = ""
    venv: str = ""
    rmw: str = ""
    fault: str = ""
    silence: str = ""


def _run(python: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(  # noqa: S603 - an interpreter of this computer and a constant
        [python, "-c", _PROBE], capture_output=True, text=True, check=False, timeout=_TIMEOUT_S, cwd="/"
    )


def read_ros(
    python: str = sys.executable, *, run: Callable[[str], subprocess.CompletedProcess[str]] = _run
) -> PythonRos:
    """Return what an interpreter finds, in the environment of this process.

    Parameters
    ----------
    run : lets the interpreter try; its output has a JSON object in each line, and the last one counts
    """
    try:
        done = run(python)
    except (OSError, subprocess.SubprocessError) as error:
        return PythonRos(
            python=python, silence=f"{python} did not answer ({printable(str(error), longest=_MOST_FAULT)})"
        )
    facts = _last(done.stdout)
    found = {each.name: str(facts.get(each.name) or "") for each in fields(PythonRos)}
    fault = found["fault"]
    if not fault and not facts.get("works"):
        said = [line for line in done.stderr.splitlines() if line.strip()]
        fault = ": ".join([f"it ended with status {done.returncode}", *said[-1:]])
    found |= {"python": python, "fault": printable(" ".join(fault.split()), longest=_MOST_FAULT)}
    return PythonRos(**found)


def installed_distros(folder: Path = _ROS) -> list[str]:
    """Return the names of the ROS distributions under /opt/ros."""
    try:
        return sorted(path.name for path in folder.iterdir() if (path / "setup.bash").exists())
    except OSError:
        return []


def _last(output: str) -> dict[str, Any]:
    try:
        found = json.loads(output.splitlines()[-1])
    except (IndexError, ValueError):
        return {}
    return found if isinstance(found, dict) else {}
