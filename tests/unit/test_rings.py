"""The three rings of arpd/README.md: imports point inwards and, inside the pure ring, only to earlier stages."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parents[2] / "arpd"
STAGES = ("model", "estimate", "solve", "govern", "report")  # ring 1, in the order of a tick
ADAPTERS = {"endpoint", "relay", "ros", "host", "web", "sim"}  # ring 2
ENTRY_POINTS = {"daemon", "cli"}  # ring 3
#: Where rclpy may be imported: folders, and modules.
ROS = (
    "arpd.ros",
    "arpd.relay.ends",
    "arpd.relay.main",
    "arpd.endpoint.publisher",
    "arpd.endpoint.writer",
    "arpd.endpoint.writing_thread",
    "arpd.endpoint.node_publishers",
)
TOUCHES_THE_WORLD = {
    "http",
    "os",
    "pathlib",
    "prometheus_client",
    "psutil",
    "rclpy",
    "socket",
    "subprocess",
    "threading",
    "time",
    "yaml",
}
SOLVERS = {"cvxpy", "osqp", "scipy"}
MODULES = sorted(PACKAGE.rglob("*.py"))


def name_of(path):
    return ".".join(("arpd", *path.relative_to(PACKAGE).with_suffix("").parts)).removesuffix(".__init__")


FILES = {name_of(path): path for path in MODULES}


def folder_of(module):
    return [*module.split("."), ""][1]


def has_ros(module):
    """Whether a module stands on the list of those that may import rclpy."""
    return any(module == name or module.startswith(name + ".") for name in ROS)


IN_ORDER = [path for path in MODULES if folder_of(name_of(path)) in STAGES]
PURE = IN_ORDER + [p for p in MODULES if folder_of(name_of(p)) in {"endpoint", "relay"} and not has_ros(name_of(p))]


def imports(path, *, for_types=True):
    """Yield the names that a module imports, at its top or in a function, and those that only its types need."""
    waiting = [ast.parse(path.read_text())]
    for node in waiting:
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
        elif for_types or not (isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"):
            waiting += ast.iter_child_nodes(node)


def imported_modules(path):
    """Names of arpd's own modules that a module imports, for types only or not."""
    return set(imports(path)) & FILES.keys() - {name_of(path), "arpd"}


def ids(path):
    return name_of(path)


@pytest.mark.parametrize("path", PURE, ids=ids)
def test_the_pure_ring_touches_nothing(path):
    """A module of the pure ring imports nothing that touches the world, and a solver library only as a back end."""
    roots = {name.partition(".")[0] for name in imports(path)}
    assert not roots & TOUCHES_THE_WORLD
    assert path.stem in {"osqp_", "cvxpy_"} or not roots & SOLVERS


@pytest.mark.parametrize("path", [p for p in MODULES if not has_ros(name_of(p))], ids=ids)
def test_one_list_says_where_ros_is(path):
    """Nothing but the listed folders and modules imports ROS's packages when it is imported itself."""
    body = [node for node in ast.parse(path.read_text()).body if isinstance(node, ast.Import | ast.ImportFrom)]
    names = [alias.name for node in body if isinstance(node, ast.Import) for alias in node.names]
    names += [node.module or "" for node in body if isinstance(node, ast.ImportFrom)]
    assert not [name for name in names if name.partition(".")[0] == "rclpy"]


def test_the_simulator_runs_without_ros():
    """`arpd simulate` imports no module of ROS, by way of others either."""
    script = "import sys; sys.modules['rclpy'] = None; import arpd.cli.simulate, arpd.daemon.scenario"
    subprocess.run([sys.executable, "-c", script], cwd=PACKAGE.parent, check=True)


@pytest.mark.parametrize("path", IN_ORDER, ids=ids)
def test_a_stage_imports_earlier_stages_only(path):
    """A stage of the tick knows itself and the stages before it."""
    reach = STAGES[: STAGES.index(folder_of(name_of(path))) + 1]
    assert {folder_of(name) for name in imported_modules(path)} <= set(reach)


@pytest.mark.parametrize("path", [p for p in MODULES if folder_of(name_of(p)) in ADAPTERS], ids=ids)
def test_adapters_import_no_entry_point(path):
    """An adapter never imports the daemon or the command line."""
    assert not {folder_of(name) for name in imported_modules(path)} & ENTRY_POINTS


def test_every_module_has_a_ring():
    """A folder that is named in no ring is a decision nobody took."""
    assert {folder_of(name_of(m)) for m in MODULES} - {""} == {*STAGES, *ADAPTERS, *ENTRY_POINTS}


def test_no_module_imports_itself_by_way_of_others():
    """No circle of imports, not even of types."""
    left = {name_of(path): imported_modules(path) for path in MODULES}
    while free := [name for name, needed in left.items() if not needed & left.keys()]:
        for name in free:
            del left[name]
    assert not left


def test_modules_stay_small():
    """No module is longer than 400 lines, and at most ten are shorter than 40."""
    lines = {name_of(m): len(m.read_text().splitlines()) for m in MODULES if m.stem not in {"__init__", "__main__"}}
    assert not {name for name, n in lines.items() if n > 400}
    assert len([name for name, n in lines.items() if n < 40]) <= 10
