"""The three rings of DESIGN §3: an import points inwards only."""

import ast
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parents[2] / "arpd"
DOMAIN = {
    "admission",
    "chronicle",
    "deadlines",
    "demand",
    "diagnosis",
    "endpoint_story",
    "distribution",
    "durations",
    "endpoints",
    "errors",
    "event",
    "estimator",
    "estimator_belief",
    "estimator_peers",
    "estimator_tuning",
    "flicker",
    "flow",
    "foreign",
    "governor",
    "handover",
    "hearing",
    "history",
    "incumbent",
    "interface",
    "lease",
    "link_story",
    "local_queue",
    "memory",
    "model",
    "narration",
    "offline",
    "ordering",
    "pacing",
    "paper",
    "peers",
    "planner",
    "plan_story",
    "probe_loss",
    "probe_schedule",
    "probing",
    "program",
    "publishers",
    "quantities",
    "queue_gauge",
    "readers",
    "receiver",
    "refusal",
    "rounding",
    "routes",
    "settings",
    "snapshot",
    "swap",
    "topics",
    "trains",
    "world",
    "wire",
    "writer",
    "solvers",
    "sample_rate",
    "slow_start",
    "swap_ledger",
    "standing",
}
ENTRY_POINTS = {
    "cli",
    "cli_allocation",
    "cli_columns",
    "cli_comparison",
    "cli_daemon",
    "cli_document",
    "cli_events",
    "cli_frame",
    "cli_live",
    "cli_plot",
    "cli_progress",
    "cli_simulate",
    "cli_solve",
    "cli_sparkline",
    "cli_status",
    "cli_tables",
    "cli_terminal",
    "cli_top",
    "cli_topics",
    "cli_verdict",
    "daemon",
    "supervisor",
    "__main__",
}
FORBIDDEN_IN_DOMAIN = {
    "http",
    "os",
    "pathlib",
    "prometheus_client",
    "psutil",
    "pydantic",
    "rclpy",
    "socket",
    "subprocess",
    "threading",
    "time",
    "yaml",
}
MODULES = sorted(PACKAGE.rglob("*.py"))


def part(path):
    relative = path.relative_to(PACKAGE)
    return relative.parts[0].removesuffix(".py")


def imports(path):
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.module


@pytest.mark.parametrize("path", [m for m in MODULES if part(m) in DOMAIN], ids=lambda p: p.name)
def test_domain_is_pure(path):
    """The domain ring imports no adapter, no entry point, and nothing that touches the world."""
    for name in imports(path):
        root, _, rest = name.partition(".")
        assert root not in FORBIDDEN_IN_DOMAIN, f"{path.name} imports {name}"
        if root == "arpd":
            assert rest.split(".")[0] in DOMAIN, f"{path.name} imports {name}, which is further out"


@pytest.mark.parametrize(
    "path", [m for m in MODULES if part(m) not in DOMAIN | ENTRY_POINTS | {"sim", "__init__"}], ids=lambda p: p.name
)
def test_adapters_do_not_import_entry_points(path):
    """An adapter never imports the daemon or the command line."""
    for name in imports(path):
        root, _, rest = name.partition(".")
        assert root != "arpd" or rest.split(".")[0] not in ENTRY_POINTS, f"{path.name} imports {name}"


def test_every_module_has_a_ring():
    """A module that is named in no ring is a decision nobody took."""
    adapters = {
        "config",
        "config_rules",
        "config_values",
        "config_schema",
        "config_source",
        "garbage",
        "host",
        "journal",
        "logs",
        "ros",
        "sim",
        "status_file",
        "sweep_plot",
        "systemd",
        "version",
        "web",
    }
    assert {part(m) for m in MODULES} - {"__init__"} <= DOMAIN | ENTRY_POINTS | adapters


def test_modules_stay_small():
    """No module is longer than 400 lines."""
    long = {m.name: n for m in MODULES if (n := len(m.read_text().splitlines())) > 400}
    assert not long
