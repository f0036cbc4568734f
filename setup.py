"""Build arpd as a package of ROS 2: what pyproject.toml has, and the files and executables that ament expects.

colcon runs this file. pip reads pyproject.toml and setup.cfg and needs no more.
"""

from __future__ import annotations

import sys
from pathlib import Path

from setuptools import Distribution, setup

# Executables for `ros2 run arpd NAME` and launch files: the subcommands of arpd, and arpd itself.
COMMANDS = ("run", "relay", "peer", "topics", "check", "solve", "simulate", "status", "top", "doctor")
ROS_FILES = [
    ("share/ament_index/resource_index/packages", ["resource/arpd"]),
    # With --symlink-install, setuptools runs where colcon links the files named here, and reads pyproject.toml there.
    ("share/arpd", ["package.xml", "pyproject.toml", "README.md", "LICENSE", "arpd/ros/fastdds.xml"]),
    ("share/arpd/launch", [str(path) for path in Path("launch").glob("*.launch.py")]),
    ("share/arpd/config", ["etc/arpd/arpd.yaml"]),
]


class RosDistribution(Distribution):
    """The distribution of pyproject.toml with the executables of a package of ROS 2."""

    def parse_config_files(self, *arguments: object, **options: object) -> None:
        """Change what pyproject.toml says, which setuptools allows nowhere else."""
        super().parse_config_files(*arguments, **options)
        self.entry_points["console_scripts"] += [f"{name} = arpd.cli.main:run_executable" for name in COMMANDS]
        # colcon evaluates the printed attributes as literals, and this one is an object.
        self.python_requires = self.metadata.python_requires = None


if "setuptools.build_meta" in sys.modules:
    setup()  # for pip, which would put the executables into bin/
else:
    setup(distclass=RosDistribution, data_files=ROS_FILES)
