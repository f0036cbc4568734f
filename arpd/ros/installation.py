"""ROS 2 as an interpreter of this computer sees it, tried in a process of its own, which may crash."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from arpd.model.quantities import printable

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
    tell(rclpy=(found and found.origin) or "")
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
    """ROS as one Python sees it; an empty text is what is not there, or not known.

    Parameters
    ----------
    python : path of the interpreter
    rclpy : file of rclpy, which may not work
    numpy, numpy_file : version and file of numpy
    venv : folder of the virtual environment
    rmw : identifier of the middleware
    fault : why ROS does not work there
    silence : why the interpreter did not answer at all
    """

    python: str
    rclpy: str = ""
    numpy: str = ""
    numpy_file: str = ""
    venv: str = ""
    rmw: str = ""
    fault: str = ""
    silence: str = ""


def read_ros(python: str = sys.executable) -> PythonRos:
    """Return what an interpreter finds, in the environment of this process."""
    command = [python, "-c", _PROBE]
    try:
        done = subprocess.run(  # noqa: S603 - an interpreter of this computer and a constant
            command, capture_output=True, text=True, check=False, timeout=_TIMEOUT_S, cwd="/"
        )
    except (OSError, subprocess.SubprocessError) as error:
        why = printable(str(error), longest=_MOST_FAULT)
        return PythonRos(python=python, silence=f"{python} did not answer ({why})")
    return understood(python, done)


def understood(python: str, done: subprocess.CompletedProcess[str]) -> PythonRos:
    """Return what an interpreter has printed: an object of JSON in each line, of which the last one counts."""
    try:
        facts = dict(json.loads(done.stdout.splitlines()[-1]))
    except (IndexError, TypeError, ValueError):
        facts = {}
    if not facts.pop("works", False) and not facts.get("fault"):
        said = [line for line in done.stderr.splitlines() if line.strip()]
        facts["fault"] = ": ".join([f"it ended with status {done.returncode}", *said[-1:]])
    fault = printable(" ".join(facts.pop("fault", "").split()), longest=_MOST_FAULT)
    return PythonRos(python=python, fault=fault, **facts)


def installed_distros(folder: Path = _ROS) -> list[str]:
    """Return the names of the ROS distributions under /opt/ros."""
    try:
        return sorted(path.name for path in folder.iterdir() if (path / "setup.bash").exists())
    except OSError:
        return []
