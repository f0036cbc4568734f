"""The repository as a package of ROS 2: its manifest, the executables of `ros2 run`, and the launch files."""

import argparse
import ast
import re
import runpy
import sys
import tomllib
from pathlib import Path
from types import ModuleType
from typing import Any
from xml.etree import ElementTree as ET

import pytest

import arpd
from arpd.cli import executables
from arpd.cli import main as cli

REPO = Path(__file__).resolve().parents[2]
MANIFEST = ET.parse(REPO / "package.xml").getroot()
PROJECT = tomllib.loads((REPO / "pyproject.toml").read_text())["project"]
(COMMANDS,) = (set(a.choices) for a in cli._parser()._actions if isinstance(a, argparse._SubParsersAction))


def text(tag):
    return [element.text for element in MANIFEST.iter(tag)]


# -- the manifest


def test_manifest_and_code_have_one_version():
    """Whoever raises one of the two is told of the other."""
    assert text("version") == [arpd.__version__]


def test_the_manifest_names_what_rosdep_can_install():
    """Each python3 key is a requirement of pyproject.toml, too."""
    required = {re.split(r"[^\w-]", name)[0].lower() for name in PROJECT["dependencies"]}
    keys = {key.removeprefix("python3-") for key in text("exec_depend") if key.startswith("python3-")}
    assert {{"yaml": "pyyaml"}.get(key, key) for key in keys} <= required


def test_the_manifest_names_its_licence_files():
    """Each licence leads to its text."""
    assert all((REPO / licence.attrib["file"]).is_file() for licence in MANIFEST.iter("license"))
    assert set(text("license")) == {"Apache-2.0", "MIT"}


# -- executables


def test_every_command_is_an_executable():
    """`ros2 run arpd NAME` works for every subcommand that arpd has."""
    tree = ast.parse((REPO / "setup.py").read_text())
    values = {
        node.targets[0].id: node.value
        for node in tree.body
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name)
    }
    assert set(ast.literal_eval(values["COMMANDS"])) == COMMANDS


@pytest.mark.parametrize(
    ("arguments", "own"),
    [
        (["--config", "a.yaml"], ["--config", "a.yaml"]),
        (["--far", "--ros-args"], ["--far"]),
        (["--ros-args", "-r", "__ns:=/r1", "--", "--far"], ["--far"]),
        (["--ros-args", "-p", "a:=1", "--", "--far", "--ros-args", "--log-level", "debug"], ["--far"]),
        (["--", "x"], ["--", "x"]),
    ],
)
def test_an_executable_leaves_the_arguments_of_ros_to_rclpy(monkeypatch, arguments, own):
    """The name of the executable is the command; what a launch file adds for ROS is no option of arpd."""
    given = []

    def run_command(arguments):
        given.extend(arguments)
        return 69

    monkeypatch.setattr(executables, "run_command", run_command)
    monkeypatch.setattr(sys, "argv", ["/ws/install/arpd/lib/arpd/relay", *arguments])
    assert (executables.main(), given) == (69, ["relay", *own])


# -- launch files


class Action:
    """Keeps what a launch file gives."""

    def __init__(self, *arguments, **options):
        self.arguments = arguments
        self.options = options


@pytest.fixture
def launch(monkeypatch):
    """Load a launch file; ROS's modules of these names are not on PyPI, so others stand for them."""

    class LaunchDescription(Action):
        pass

    class DeclareLaunchArgument(Action):
        pass

    class LaunchConfiguration(Action):
        pass

    class Node(Action):
        pass

    modules: dict[str, list[type]] = {
        "launch": [LaunchDescription],
        "launch.actions": [DeclareLaunchArgument],
        "launch.substitutions": [LaunchConfiguration],
        "launch_ros": [],
        "launch_ros.actions": [Node],
    }
    for name, classes in modules.items():
        module = ModuleType(name)
        for each in classes:
            setattr(module, each.__name__, each)
        monkeypatch.setitem(sys.modules, name, module)

    def load(name, **values):
        """Return the processes that a launch file starts, each as executable and arguments, with values for its own."""
        description: Any = runpy.run_path(str(REPO / "launch" / name))["generate_launch_description"]()
        (entities,) = description.arguments
        declared = {e.arguments[0]: e.options for e in entities if isinstance(e, DeclareLaunchArgument)}
        assert set(values) <= set(declared)
        chosen = {name: options["default_value"] for name, options in declared.items()} | values
        nodes = [entity for entity in entities if isinstance(entity, Node)]
        assert len(nodes) + len(declared) == len(entities)
        assert all(node.options["package"] == "arpd" for node in nodes)
        return [
            (
                node.options["executable"],
                [
                    chosen[part.arguments[0]] if isinstance(part, LaunchConfiguration) else part
                    for part in node.options["arguments"]
                ],
            )
            for node in nodes
        ]

    return load


@pytest.mark.parametrize(
    ("name", "started"),
    [("robot.launch.py", {"run": [], "relay": []}), ("ceddp.launch.py", {"peer": [], "relay": ["--far"]})],
)
def test_a_launch_file_starts_what_its_computer_needs(launch, name, started):
    """The command line of each process is one that arpd accepts, with the values of the launch arguments."""
    options = ["--config", "/a.yaml", "--log-level", "debug"]
    commands = launch(name, config="/a.yaml", log_level="debug")
    assert dict(commands) == {command: [*extra, *options] for command, extra in started.items()}
    for command, arguments in commands:
        parsed = cli._parser().parse_args([command, *arguments])
        assert (parsed.config, parsed.log_level) == (Path("/a.yaml"), "debug")


@pytest.mark.parametrize("name", ["robot.launch.py", "ceddp.launch.py"])
def test_a_launch_file_has_the_defaults_of_the_command_line(launch, name):
    """Without arguments a launch file reads the configuration that `arpd run` reads."""
    for _, arguments in launch(name):
        assert arguments[-4:] == ["--config", str(cli.DEFAULT_CONFIG), "--log-level", "info"]


def test_every_launch_file_is_tested():
    """A launch file more needs a test more."""
    assert {path.name for path in (REPO / "launch").iterdir()} == {"robot.launch.py", "ceddp.launch.py"}
