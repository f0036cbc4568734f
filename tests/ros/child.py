"""A script of this folder as a process of its own."""

import os
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

from tests.ros.domain import DOMAIN

HERE = Path(__file__).parent


@contextmanager
def child(script, *arguments):
    """Yield the process, in the ROS domain of this one and with pipes; it ends with the block."""
    process = subprocess.Popen(
        [sys.executable, HERE / script, *map(str, arguments)],
        env={**os.environ, "ROS_DOMAIN_ID": str(DOMAIN), "PYTHONPATH": str(HERE.parents[1])},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        yield process
    finally:
        process.kill()
        process.wait()
