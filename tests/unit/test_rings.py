"""The three rings of arpd/README.md: imports point inwards and, inside the pure ring, only to earlier stages."""

import ast
import subprocess
import sys
from pathlib import Path

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
WORLD = {"http", "os", "pathlib", "psutil", "rclpy", "socket", "subprocess", "threading", "time", "yaml"}
LIBRARIES = {"cvxpy", "osqp", "prometheus_client", "scipy"}
FILES = {
    ".".join(("arpd", *path.relative_to(PACKAGE).with_suffix("").parts)).removesuffix(".__init__"): path
    for path in sorted(PACKAGE.rglob("*.py"))
}


def imports(path, *, for_types=True, in_functions=True):
    """Yield the names that a module imports, at its top or in a function, and those that only its types need."""
    waiting = [ast.parse(path.read_text())]
    for node in waiting:
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.FunctionDef | ast.Lambda) and not in_functions:
            continue
        elif for_types or not (isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"):
            waiting += ast.iter_child_nodes(node)


def packages(module, **which):
    """Return the packages that a module imports."""
    return {name.partition(".")[0] for name in imports(FILES[module], **which)}


def folder_of(module):
    return [*module.split("."), ""][1]


def of(*folders):
    """Return the modules in folders of the package."""
    return [module for module in FILES if folder_of(module) in folders]


def has_ros(module):
    """Return whether a module stands on the list of those that may import rclpy."""
    return any(module == name or module.startswith(name + ".") for name in ROS)


#: By module: arpd's own modules that it imports, for types only or not.
KNOWS = {module: set(imports(path)) & FILES.keys() - {module, "arpd"} for module, path in FILES.items()}


def test_the_pure_ring_touches_nothing():
    """A module of the pure ring imports nothing that touches the world, and a solver library only as a back end."""
    pure = [module for module in of(*STAGES, "endpoint", "relay") if module in of(*STAGES) or not has_ros(module)]
    touched = {module: packages(module) & (WORLD | LIBRARIES) for module in pure}
    assert {module: names for module, names in touched.items() if names} == {
        "arpd.solve.cvxpy_": {"cvxpy"},
        "arpd.solve.osqp_": {"osqp", "scipy"},
    }


def test_one_list_says_where_ros_is():
    """Nothing but the listed folders and modules imports ROS's packages when it is imported itself."""
    others = [module for module in FILES if not has_ros(module)]
    assert not [module for module in others if "rclpy" in packages(module, for_types=False, in_functions=False)]


def test_the_simulator_runs_without_ros():
    """`arpd simulate` imports no module of ROS, by way of others either."""
    script = "import sys; sys.modules['rclpy'] = None; import arpd.cli.simulate, arpd.daemon.scenario"
    subprocess.run([sys.executable, "-c", script], cwd=PACKAGE.parent, check=True)


def test_a_stage_imports_earlier_stages_only_and_an_adapter_no_entry_point():
    """A stage of the tick knows itself and those before it, an adapter neither the daemon nor the command line."""
    reach = {stage: {*STAGES[: place + 1]} for place, stage in enumerate(STAGES)}
    reach |= {adapter: {*STAGES, *ADAPTERS, ""} for adapter in ADAPTERS}
    known = {module: {folder_of(name) for name in KNOWS[module]} for module in of(*reach)}
    assert not [module for module, folders in known.items() if not folders <= reach[folder_of(module)]]


def test_every_module_has_a_ring():
    """A folder that is named in no ring is a decision nobody took."""
    assert {folder_of(module) for module in FILES} - {""} == {*STAGES, *ADAPTERS, *ENTRY_POINTS}


def test_no_module_imports_itself_by_way_of_others():
    """No circle of imports, not even of types."""
    left = dict(KNOWS)
    while free := [name for name, needed in left.items() if not needed & left.keys()]:
        for name in free:
            del left[name]
    assert not left


def test_modules_stay_small():
    """No module is longer than 400 lines, and at most ten are shorter than 40."""
    lines = {m: len(p.read_text().splitlines()) for m, p in FILES.items() if p.stem not in {"__init__", "__main__"}}
    assert not {name for name, n in lines.items() if n > 400}
    assert len([name for name, n in lines.items() if n < 40]) <= 10
