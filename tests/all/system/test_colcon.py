"""A colcon workspace with arpd and a user's package: it builds, `ros2 run` finds arpd, and the node is planned for."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")
pytest.importorskip("colcon_ros", reason="colcon is not installed: pip install colcon-ros colcon-bash")

from scripts.netns.simlink import SimLink, available
from tests.waiting import eventually

pytestmark = pytest.mark.ros

REPO = Path(__file__).parents[3]
COLCON = Path(sys.executable).with_name("colcon")
FILES = ("LICENSE", "README.md", "etc/arpd/arpd.yaml", "package.xml", "pyproject.toml", "setup.cfg", "setup.py")
FOLDERS = ("arpd", "launch", "resource")
CAN, WHY = available()
TOPIC = "/greeting"
DEPTH = 100
# A user's package, as `ros2 pkg create --build-type ament_python` makes it.
MY_ROBOT = {
    "package.xml": """\
<?xml version="1.0"?>
<package format="3">
  <name>my_robot</name>
  <version>0.0.0</version>
  <description>A robot</description>
  <maintainer email="me@example.org">Me</maintainer>
  <license>Apache-2.0</license>
  <exec_depend>arpd</exec_depend>
  <exec_depend>std_msgs</exec_depend>
  <export><build_type>ament_python</build_type></export>
</package>
""",
    "setup.cfg": "[develop]\nscript_dir=$base/lib/my_robot\n[install]\ninstall_scripts=$base/lib/my_robot\n",
    "setup.py": """\
from setuptools import setup

setup(
    name="my_robot",
    version="0.0.0",
    packages=["my_robot"],
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/my_robot"]),
        ("share/my_robot", ["package.xml"]),
    ],
    entry_points={"console_scripts": ["greeter = my_robot.nodes:greet", "listener = my_robot.nodes:listen"]},
)
""",
    "resource/my_robot": "",
    "my_robot/__init__.py": "",
    "my_robot/nodes.py": f"""\
import rclpy
from rclpy.node import Node
from std_msgs.msg import String

import arpd
from arpd import AdaptivePublisher


class Greeter(Node):
    def __init__(self):
        super().__init__("greeter")
        self.pub = AdaptivePublisher(self, String, "{TOPIC}", 10)
        self.create_timer(0.05, lambda: self.pub.publish(String(data="hello")))


class Listener(Node):
    def __init__(self):
        super().__init__("listener")
        self.create_subscription(String, "{TOPIC}", lambda message: print(message.data, flush=True), 10)


def greet():
    print(arpd.__file__, flush=True)
    rclpy.init()
    rclpy.spin(Greeter())


def listen():
    rclpy.init()
    rclpy.spin(Listener())
""",
}


def copy_of_the_checkout(folder):
    for name in FOLDERS:
        shutil.copytree(REPO / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in FILES:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(REPO / name, folder / name)


class Workspace:
    """A workspace with both packages, and commands in a shell that has sourced it."""

    def __init__(self, folder):
        self.folder = folder
        copy_of_the_checkout(folder / "src/arpd")
        for name, text in MY_ROBOT.items():
            path = folder / "src/my_robot" / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text)
        self.environment = {
            **{name: value for name, value in os.environ.items() if not name.startswith(("FASTDDS_", "FASTRTPS_"))},
            "COLCON_HOME": str(folder / "colcon"),
            "PATH": f"{COLCON.parent}:{os.environ['PATH']}",
            "PYTHONDONTWRITEBYTECODE": "1",
            "ROS_LOG_DIR": str(folder / "roslog"),
        }
        self.environment.pop("PYTHONPATH", None)

    def build(self, *options):
        """Build both packages, and return what colcon says."""
        built = subprocess.run(
            [COLCON, "build", *options],
            cwd=self.folder,
            env=self.environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            check=False,
        )
        assert built.returncode == 0, built.stdout
        return built.stdout

    def executable(self, package, name):
        """Return the file that `ros2 run PACKAGE NAME` runs."""
        return self.folder / "install" / package / "lib" / package / name

    def sourced(self, *argv):
        """Return the command line of a program in a shell that has sourced the workspace."""
        return ["bash", "-c", '. install/setup.bash && exec "$@"', "bash", *map(str, argv)]

    def run(self, *argv, **environment):
        return subprocess.run(
            self.sourced(*argv),
            cwd=self.folder,
            env=self.environment | environment,
            capture_output=True,
            text=True,
            check=False,
        )


@pytest.fixture(scope="module", params=[(), ("--symlink-install",)], ids=["copied", "linked"])
def workspace(request, tmp_path_factory):
    """Build it once for each way of installing."""
    workspace = Workspace(tmp_path_factory.mktemp("ws"))
    workspace.told = workspace.build(*request.param)
    return workspace


def test_the_share_of_the_package_has_what_ros_looks_for(workspace):
    """Marker, manifest, launch files and profile are where ament and a user look for them."""
    ask = "from ament_index_python import get_package_share_directory as share; print(share('arpd'))"
    share = Path(workspace.run(sys.executable, "-c", ask).stdout.strip())
    assert share == workspace.folder / "install/arpd/share/arpd"
    for name, source in (
        ("package.xml", "package.xml"),
        ("launch/robot.launch.py", "launch/robot.launch.py"),
        ("launch/base.launch.py", "launch/base.launch.py"),
        ("fastdds.xml", "arpd/ros/fastdds.xml"),
        ("config/arpd.yaml", "etc/arpd/arpd.yaml"),
    ):
        assert (share / name).read_bytes() == (REPO / source).read_bytes()


@pytest.mark.link
@pytest.mark.skipif(not CAN, reason=WHY)
def test_the_users_node_is_planned_for(workspace):
    """The node runs with the workspace's arpd; the workspace's daemon and peer find it, and its QoS changes live."""
    config = workspace.folder / "arpd.yaml"
    config.write_text(f'{{"defaults": {{"min_depth": {DEPTH}, "max_depth": {DEPTH}, "latency_budget": "none"}}}}')
    profile = {"FASTRTPS_DEFAULT_PROFILES_FILE": str(workspace.folder / "install/arpd/share/arpd/fastdds.xml")}
    logs = {name: workspace.folder / f"{name}.log" for name in ("greeter", "listener")}
    with (
        SimLink(f"colcon-{os.getpid()}") as link,
        logs["greeter"].open("w") as greets,
        logs["listener"].open("w") as hears,
    ):

        def start(host, *argv, log=subprocess.DEVNULL, **environment):
            options = {"cwd": workspace.folder, "stdout": log, "stderr": subprocess.STDOUT}
            return link.popen(host, workspace.sourced(*argv), env=workspace.environment | environment, **options)

        def depth():
            status = start("robot", workspace.executable("arpd", "status"), "--json", log=subprocess.PIPE)
            told, _ = status.communicate()
            topics = json.loads(told)["topics"] if told.startswith(b"{") else []  # else there is no daemon yet
            return next((topic["confirmed"]["depth"] for topic in topics if topic["topic"] == TOPIC), None)

        start("robot", workspace.executable("my_robot", "greeter"), log=greets, **profile)
        start("base", workspace.executable("my_robot", "listener"), log=hears, **profile)
        start("base", workspace.executable("arpd", "peer"), "--ros-args")
        start("robot", workspace.executable("arpd", "run"), "--config", config, "--ros-args")
        eventually("the plan is in force", lambda: depth() == DEPTH)
        (imported,) = logs["greeter"].read_text().splitlines()
        assert Path(imported).is_relative_to(workspace.folder)
        assert set(logs["listener"].read_text().splitlines()) == {"hello"}
