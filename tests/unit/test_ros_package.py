"""The repository as a package of ROS 2: its manifest, the executables of `ros2 run`, and the launch files."""

import argparse
import ast
import re
import runpy
import sys
import tomllib
from pathlib import Path
from unittest.mock import Mock
from xml.etree import ElementTree as ET

import pytest

import arpd
from arpd.cli import main as cli

REPO = Path(__file__).resolve().parents[2]
MANIFEST = ET.parse(REPO / "package.xml").getroot()
PROJECT = tomllib.loads((REPO / "pyproject.toml").read_text())["project"]
(COMMANDS,) = (set(a.choices) for a in cli._parser()._actions if isinstance(a, argparse._SubParsersAction))


def text(tag):
    return [element.text for element in MANIFEST.iter(tag)]


def test_the_manifest_has_the_codes_version_and_requirements():
    """Whoever raises one version is told of the other; each python3 key is a requirement of pyproject.toml, too."""
    assert text("version") == [arpd.__version__]
    required = {re.split(r"[^\w-]", name)[0].lower() for name in PROJECT["dependencies"]}
    keys = {key.removeprefix("python3-") for key in text("exec_depend") if key.startswith("python3-")}
    assert {{"yaml": "pyyaml"}.get(key, key) for key in keys} <= required


def test_every_command_is_an_executable():
    """`ros2 run arpd NAME` works for every subcommand that arpd has."""
    tree = ast.parse((REPO / "setup.py").read_text())
    values = {
        node.targets[0].id: node.value
        for node in tree.body
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name)
    }
    assert set(ast.literal_eval(values["COMMANDS"])) == COMMANDS


@pytest.fixture
def launch(monkeypatch):
    """Return the processes that a launch file starts, each as executable and arguments, with values for its own."""

    def launch(name, **values):
        # ROS's modules of these names are not on PyPI.
        ros = Mock(LaunchConfiguration=lambda name, **_: values.get(name))
        for module in ("launch", "launch.actions", "launch.substitutions", "launch_ros", "launch_ros.actions"):
            monkeypatch.setitem(sys.modules, module, ros)
        runpy.run_path(str(REPO / "launch" / name))["generate_launch_description"]()
        nodes = [made.kwargs for made in ros.Node.call_args_list]
        assert {made.args[0] for made in ros.DeclareLaunchArgument.call_args_list} == set(values)
        assert {node["package"] for node in nodes} == {"arpd"}
        assert all(node["additional_env"].keys() == {"FASTDDS_BUILTIN_TRANSPORTS"} for node in nodes)
        assert len(ros.LaunchDescription.call_args.args[0]) == len(values) + len(nodes)
        return {node["executable"]: node["arguments"] for node in nodes}

    return launch


@pytest.mark.parametrize(
    ("name", "started"),
    [("robot.launch.py", {"run": [], "relay": []}), ("base.launch.py", {"peer": [], "relay": ["--far"]})],
)
def test_a_launch_file_starts_what_its_computer_needs(launch, name, started):
    """The command line of each process is one that arpd accepts, with the values of the launch arguments."""
    options = ["--config", "/a.yaml", "--log-level", "debug"]
    commands = launch(name, config="/a.yaml", log_level="debug")
    assert commands == {command: [*extra, *options] for command, extra in started.items()}
    for command, arguments in commands.items():
        parsed = cli._parser().parse_args([command, *arguments])
        assert (parsed.config, parsed.log_level) == (Path("/a.yaml"), "debug")
