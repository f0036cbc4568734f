"""The half of arpd that a robot's nodes import needs the standard library and ROS 2; one line says what is missing."""

import re
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest

import arpd
from tests.unit.test_rings import FILES, imports

REPO = Path(__file__).resolve().parents[2]
ENDPOINT = [f"arpd.endpoint.{path.stem}" for path in (REPO / "arpd/endpoint").glob("[!_]*.py")]
DEPENDS = {str(depend.text) for depend in ET.parse(REPO / "package.xml").iter("exec_depend")}


def reach(*modules):
    """Modules of arpd that these import, directly or not, and the foreign packages of each."""
    found, waiting = {}, [*modules]
    while waiting:
        if (module := waiting.pop()) in found:
            continue
        names = set(imports(FILES[module], for_types=False))
        found[module] = {name.partition(".")[0] for name in names} - {"arpd"}
        parents = {module.rpartition(".")[0]} - {"", "arpd"}  # arpd itself imports the publisher on demand
        waiting += parents | names & FILES.keys() - {"arpd"}
    return found


def test_a_publisher_needs_the_standard_library_and_packages_of_ros_alone():
    """No module of arpd.endpoint, or that they reach, imports anything that package.xml does not name."""
    found = reach(*ENDPOINT)
    allowed = sys.stdlib_module_names | {name for name in DEPENDS if not name.startswith("python3-")}
    assert {module: foreign for module, packages in found.items() if (foreign := packages - allowed)} == {}
    assert len(found) > 20
    assert {"rclpy", "rcl_interfaces", "std_msgs"} <= set().union(*found.values())


@pytest.fixture
def python(tmp_path):
    """Run code in a process that finds only arpd and the given packages beside the standard library."""

    def python(code, **packages):
        for name, text in packages.items():
            (tmp_path / name).mkdir()
            (tmp_path / name / "__init__.py").write_text(text)
        return subprocess.run(
            [sys.executable, "-I", "-S", "-c", f"import sys; sys.path[:0] = sys.argv[1:]\n{code}", tmp_path, REPO],
            capture_output=True,
            text=True,
            check=False,
        )

    return python


@pytest.mark.parametrize(
    ("packages", "missing", "way_out"),
    [
        ({}, "needs rcl(py|_interfaces), which", "first run: source /opt/ros/jazzy/setup.bash"),
        ({"rclpy": "import numpy"}, "needs numpy, which", "--system-site-packages"),
        ({"rclpy": "import rcl_interfaces.msg"}, "needs rcl_interfaces, which", "apt install ros-jazzy-rcl-interfaces"),
        (
            {"rclpy": "raise ImportError('no _rclpy\\nhere', name='rclpy._rclpy')"},
            "cannot load rclpy into",
            "(no _rclpy here); source /opt/ros/jazzy/setup.bash",
        ),
    ],
    ids=["no ROS", "rclpy without numpy", "no messages", "ROS for another Python"],
)
def test_an_import_without_ros_names_what_is_missing_and_the_way_out(python, packages, missing, way_out):
    """One line at the end of a short traceback, instead of the depths of arpd."""
    messages = {} if "rcl_interfaces" in missing or not packages else {"rcl_interfaces": "import rclpy"}
    done = python("from arpd import AdaptivePublisher", **packages, **messages)
    *traceback, last = done.stderr.splitlines()
    assert re.match(rf"ImportError: arpd\.AdaptivePublisher {missing} {re.escape(sys.executable)} ", last), last
    assert way_out in last
    assert len(traceback) <= 6


def test_an_old_python_is_told_so(python):
    """Python 3.10 cannot run arpd; where a link makes the package importable, no pip has checked that."""
    done = python("sys.version_info = (3, 10, 12)\nfrom arpd import AdaptivePublisher")
    last = done.stderr.splitlines()[-1]
    assert last == f"ImportError: arpd.AdaptivePublisher needs Python 3.11 or newer; {sys.executable} is Python 3.10"


def test_import_arpd_loads_nothing_slow(python):
    """`import arpd` loads no other module of arpd, and its version needs no metadata."""
    done = python("import arpd\nprint(arpd.__version__, *[m for m in sys.modules if m[:4] in {'arpd', 'impo'}])")
    assert done.stdout == f"{arpd.__version__} arpd\n", done.stderr


@pytest.mark.parametrize(
    ("command", "packages", "missing", "way_out"),
    [
        ("run", {}, "pydantic cannot be imported by", "scripts/deb"),
        ("relay", {}, "pydantic cannot be imported by", "scripts/deb"),
        ("peer", {}, "pydantic cannot be imported by", "scripts/deb"),
        ("check", {"pydantic": ""}, "pydantic cannot be imported by", "cannot import name"),
        ("check", {"pydantic": "import std_msgs"}, "std_msgs cannot be imported by", "/opt/ros/jazzy/setup.bash"),
    ],
)
def test_a_command_without_its_packages_ends_in_one_line(python, command, packages, missing, way_out):
    """`ros2 run arpd run` in a colcon workspace has the library alone; it exits 69."""
    done = python(f"from arpd.cli.main import main\nsys.exit(main(['{command}']))", **packages)
    assert (done.returncode, done.stdout) == (69, "")
    (line,) = done.stderr.splitlines()
    assert line.startswith(f"arpd: {missing} {sys.executable} ")
    assert way_out in line
