"""A colcon workspace with arpd: it builds, `ros2 run` finds arpd, and a user's node in it is planned for."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("colcon_ros", reason="colcon is not installed: pip install colcon-ros colcon-bash")

from tests.all.link.hosts import NEEDS_LINK, NODE, REPO
from tests.waiting import eventually

pytestmark = NEEDS_LINK

COLCON = Path(sys.executable).with_name("colcon")
OTHERS = (".*", "__pycache__", "docs", "scripts", "systemd", "tests")
TOPIC = "/greeting"
DEPTH = 100


class Workspace:
    """A workspace, and commands in a shell that has sourced it."""

    def __init__(self, folder):
        self.folder = folder
        shutil.copytree(REPO, folder / "src/arpd", ignore=shutil.ignore_patterns(*OTHERS))
        kept = (name for name in os.environ if not name.startswith(("FASTDDS_", "FASTRTPS_", "PYTHONPATH")))
        self.environment = {
            **{name: os.environ[name] for name in kept},
            "COLCON_HOME": str(folder / "colcon"),
            "PATH": f"{COLCON.parent}:{os.environ['PATH']}",
            "PYTHONDONTWRITEBYTECODE": "1",
            "ROS_LOG_DIR": str(folder / "roslog"),
        }

    def sourced(self, *argv):
        """Return the command line of a program in a shell that has sourced the workspace."""
        return ["bash", "-c", f'. {self.folder}/install/setup.bash && exec "$@"', "bash", *map(str, argv)]

    def arpd(self, name, *argv):
        """Return the command line of `ros2 run arpd NAME`."""
        return self.sourced(self.folder / "install/arpd/lib/arpd" / name, *argv)

    def run(self, *argv):
        """Run a program to its end; return its output."""
        done = subprocess.run(argv, cwd=self.folder, env=self.environment, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout


@pytest.fixture(scope="module", params=[(), ("--symlink-install",)], ids=["copied", "linked"])
def workspace(request, tmp_path_factory):
    """Build it once for each way of installing."""
    workspace = Workspace(tmp_path_factory.mktemp("ws"))
    workspace.run(COLCON, "build", *request.param)
    return workspace


def test_the_share_of_the_package_has_what_ros_looks_for(workspace):
    """Marker, manifest, launch files and profile are where ament and a user look for them."""
    ask = "from ament_index_python import get_package_share_directory as share; print(share('arpd'))"
    share = Path(workspace.run(*workspace.sourced(sys.executable, "-c", ask)).strip())
    assert share == workspace.folder / "install/arpd/share/arpd"
    for name, source in (
        ("package.xml", "package.xml"),
        ("launch/robot.launch.py", "launch/robot.launch.py"),
        ("launch/base.launch.py", "launch/base.launch.py"),
        ("fastdds.xml", "arpd/ros/fastdds.xml"),
        ("config/arpd.yaml", "etc/arpd/arpd.yaml"),
    ):
        assert (share / name).read_bytes() == (REPO / source).read_bytes()


def test_the_users_node_is_planned_for(workspace, hosts):
    """The node runs with the workspace's arpd; the workspace's daemon and peer find it, and its QoS changes live."""
    (hosts.folder / "arpd.yaml").write_text(
        f'{{"defaults": {{"min_depth": {DEPTH}, "max_depth": {DEPTH}, "latency_budget": "none"}}}}'
    )
    hosts.node("base", "listener", f"read:{TOPIC}:std_msgs/String")
    hosts.environment = workspace.environment
    profile = {"FASTRTPS_DEFAULT_PROFILES_FILE": f"{workspace.folder}/install/arpd/share/arpd/fastdds.xml"}
    greeter = workspace.sourced(sys.executable, NODE, "greeter", f"adapt:{TOPIC}:std_msgs/String")
    hosts.start("robot", "greeter", *greeter, **profile)
    hosts.start("base", "peer", *workspace.arpd("peer", "--ros-args"))
    hosts.start("robot", "run", *workspace.arpd("run", "--config", "arpd.yaml", "--ros-args"))

    def depth():
        told, _, _ = hosts.call("robot", *workspace.arpd("status", "--json"))
        topics = json.loads(told)["topics"] if told.startswith("{") else []  # else there is no daemon yet
        return next((topic["confirmed"]["depth"] for topic in topics if topic["topic"] == TOPIC), None)

    eventually("the plan is in force", lambda: depth() == DEPTH)
    assert Path(hosts.text("greeter").splitlines()[0]).is_relative_to(workspace.folder)
    assert TOPIC in hosts.text("listener")
