"""Reloads: each key comes into force or waits for a restart, and a file counts whole or not at all."""

from __future__ import annotations

import json
from functools import cache
from typing import Any
from unittest.mock import Mock

import pytest

from arpd.daemon import tick
from arpd.daemon.tick import Daemon
from arpd.host.config.keys import SECTIONS, flatten
from arpd.host.config.load import load_settings
from arpd.model.observation import MemoryState
from arpd.report.situation import status_line
from arpd.solve import backends
from tests.golden.sample import status_of
from tests.sample_publishers import publisher
from tests.unit.daemon.world import World
from tests.unit.host.config.test_load import AT_START

DT_S = 1.0
COURSE_S = 60.0
TOPICS: list[dict[str, Any]] = [{"name": "/b", "weight": 3}, {"name": "/a"}]
RELAY = {"topics": [{"name": "/scan"}]}
# Bit rate of the radio from a time on (s, bytes/s); without it the first estimate stays.
RADIO = ((6.0, 2.2e6), (20.0, 0.8e6), (38.0, 3e6))
LATE_S = 15.0  # a third topic comes

# Every key that is read again, and one of each section that is not: its new value, and other keys that make it matter.
CHANGES: dict[str, tuple[Any, dict[str, Any]]] = {
    "link.interface": ("wlan7", {}),
    "link.capacity": ("4mbit", {}),
    "link.initial_capacity": ("4mbit", {}),
    "link.headroom": (0.5, {}),
    "link.packet_overhead": ("2ms", {}),
    "program.policy": ("uniform", {}),
    "program.backend": ("closed_form", {}),
    "program.deadline_slack": (3, {}),
    "program.memory_budget": ("64KiB", {}),
    "program.memory_reserve": ("511.5MiB", {"defaults": {"latency_budget": "none"}}),
    "governor.hold": ("12s", {}),
    "governor.dwell": ("20s", {}),
    "governor.debounce": ("5s", {}),
    "http.port": (1234, {}),
    "graph.sensing_topics": (7, {}),
    "graph.actuation_topics": (7, {}),
    "defaults.weight": (9, {}),
    "defaults.min_rate_hz": (9, {}),
    "defaults.max_rate_hz": (5, {}),
    "defaults.min_depth": (150, {}),
    "defaults.max_depth": (3, {}),
    "defaults.latency_budget": ("100ms", {}),
    "topics.name": ("/c", {}),
    "topics.weight": (9, {}),
    "topics.min_rate_hz": (9, {}),
    "topics.max_rate_hz": (5, {}),
    "topics.min_depth": (150, {}),
    "topics.max_depth": (3, {}),
    "topics.latency_budget": ("100ms", {}),
    "topics.payload": ("1kB", {}),
    "topics.source_rate_hz": (9, {}),
    "relay.link_domain": (78, {"relay": {"link_domain": 77, "robot": "10.0.0.1"}}),
    "on_stop": ("keep", {}),
    "on_lost": ("baseline", {}),
    "lost_after": ("9s", {"on_lost": "baseline"}),
}
# In force, but without effect on the daemon: `arpd solve` reads them.
OFFLINE = {"topics.payload", "topics.source_rate_hz"}
FREE = sorted(key for key in CHANGES if not key.startswith(AT_START))
BOUND = sorted(key for key in CHANGES if key.startswith(AT_START))


class Robot(World):
    """Two topics, and later a third, over a link whose radio has a bit rate."""

    def __init__(self):
        super().__init__(deaf={"/n"}, sensing_topics=2, actuation_topics=0, peers=0)
        self.sees["memory"] = MemoryState(total_bytes=2**30, available_bytes=2**29)

    def observe(self, now_s):
        sizes = {"/a": 200.0, "/b": 20_000.0} | ({"/c": 4000.0} if now_s >= LATE_S else {})
        self.publishers = {
            name: publisher("/n", name, payload_bytes=size, source_rate_hz=200.0, remote_readers=1)
            for name, size in sizes.items()
        }
        self.sees["radio_bytes_per_second"] = next((rate for at_s, rate in reversed(RADIO) if now_s >= at_s), None)
        return super().observe(now_s)


def document(key=None):
    """Return the configuration in which a key is going to change."""
    extra = json.loads(json.dumps(CHANGES[key][1])) if key else {}
    topics = [{**topic} for topic in TOPICS]
    return {"link": {"initial_capacity": "16mbit"}, "topics": topics, "relay": json.loads(json.dumps(RELAY)), **extra}


def changed(key):
    """Return the configuration with this one key changed."""
    wanted = document(key)
    *path, last = key.split(".")
    at = wanted
    for step in path:
        at = at.setdefault(step, {})
        at = at[0] if isinstance(at, list) else at
    at[last] = CHANGES[key][0]
    return wanted


@pytest.fixture(scope="module")
def load(tmp_path_factory):
    """Load a configuration from a file, as the daemon does."""
    path = tmp_path_factory.mktemp("reload") / "arpd.yaml"

    @cache
    def read(text):
        path.write_text(text)
        return load_settings(path, interfaces=None)

    return lambda data: read(json.dumps(data))  # JSON is YAML


def course(settings, *, reload=None):
    """Return a daemon's decisions and transitions, tick by tick, and its action on a stop."""
    world = Robot()
    now_s = 0.0
    daemon: Any = Daemon(world, settings, clock=lambda: now_s)
    if reload is not None:
        assert daemon.reload(lambda: reload)
    done = []
    while now_s < COURSE_S:
        decision = daemon.tick(now_s)
        seen = daemon.snapshot
        done.append(
            (
                decision.allowed,
                decision.plan,
                seen.link.capacity_bytes_per_second,
                seen.observation.sensing_topics,
                seen.observation.actuation_topics,
                seen.allocation.backend,
                world.lease_s,
            )
        )
        now_s += DT_S
    return done, world.sent, daemon.settings.on_stop


@pytest.fixture(scope="module")
def untouched(load):
    """Return the course of a daemon without a reload, by key; most keys share a file."""
    known = {}

    def of(key):
        text = json.dumps(document(key))
        if text not in known:
            known[text] = course(load(document(key)))
        return known[text]

    return of


def test_every_key_is_tried():
    """The tests below cover every key that is read again, and every section that is not."""
    keys = {".".join((*path, name)) for path, section in SECTIONS.items() for name in section}
    keys -= {".".join(path) for path in SECTIONS}
    assert {key for key in keys if not key.startswith(AT_START)} == set(FREE)
    assert all(any(key.startswith(start) for key in BOUND) for start in AT_START)


@pytest.mark.parametrize("key", FREE)
def test_a_reloaded_key_is_in_force(load, untouched, key):
    """After a reload the daemon acts, tick for tick, as one that started with the new value, and not as before."""
    old, new = load(document(key)), load(changed(key))
    reloaded = course(old, reload=new)
    assert reloaded == course(new)
    assert (reloaded == untouched(key)) == (key in OFFLINE)


@pytest.mark.parametrize("key", BOUND)
def test_a_key_that_needs_a_restart_is_not_in_force(load, caplog, key):
    """The daemon keeps the value in force, and names the key in log, status and metrics."""
    old, new = load(document(key)), load(changed(key))
    daemon: Any = Daemon(Robot(), old, clock=lambda: 0.0)
    assert daemon.reload(lambda: new)
    assert daemon.settings == old
    differing = {name for name in flatten(old) | flatten(new) if flatten(old).get(name) != flatten(new).get(name)}
    waiting = [record.message for record in caplog.records if "takes effect after a restart" in record.message]
    assert {message.partition(": ")[0] for message in waiting} == differing
    daemon.tick(0.0)
    assert set(daemon.snapshot.keys_awaiting_restart) == differing
    assert "restart needed: the file's " in status_line(daemon.snapshot)


# -- whole or not at all


def daemon_of(settings):
    return Daemon(Robot(), settings, clock=lambda: 0.0)


def test_a_part_that_breaks_leaves_the_old_configuration_whole(load, monkeypatch):
    """When no program can be made of the new settings, every part continues with the old ones."""
    old, new = load(document()), load(changed("graph.sensing_topics") | changed("link.headroom"))
    now_s = 0.0
    daemon: Any = Daemon(Robot(), old, clock=lambda: now_s)
    with monkeypatch.context() as broken:
        broken.setattr(tick, "Program", Mock(side_effect=RuntimeError("broken")))
        with pytest.raises(RuntimeError, match="broken"):
            daemon.reload(lambda: new)
    assert daemon.settings is old
    undisturbed, _, _ = course(old)
    for allowed, plan, *_, sensing, _, _, _ in undisturbed[:20]:
        decision = daemon.tick(now_s)
        assert (decision.allowed, decision.plan) == (allowed, plan)
        assert daemon.snapshot.observation.sensing_topics == sensing
        now_s += DT_S


def unusable(path):
    """Spoil a configuration file in one way after the other, and name each."""
    path.unlink()
    yield "No such file"
    path.write_text(json.dumps(document())[:-40])
    yield "yaml: "
    path.write_text("links: {}")
    yield f"{path}:1:1: links"
    path.write_bytes(b"")
    yield "is empty"


def test_a_file_that_cannot_be_used_changes_nothing(tmp_path, caplog):
    """Log, status and metrics name each fault while the old settings stay, until a good file is loaded."""
    path = tmp_path / "arpd.yaml"
    path.write_text(json.dumps(document()))
    daemon = daemon_of(load_settings(path, interfaces=None))
    old = daemon.settings
    for why in unusable(path):
        assert not daemon.reload(lambda: load_settings(path, interfaces=None))
        daemon.tick(0.0)
        assert daemon.settings is old
        assert why in daemon.snapshot.config_error
        assert f"reload refused: {path}" in status_line(daemon.snapshot)
        assert caplog.records[-1].message == daemon.snapshot.config_error
        assert daemon.snapshot.events[-1].kind == "reload_refused"
    path.unlink()
    path.write_text(json.dumps(changed("on_stop")))
    assert daemon.reload(lambda: load_settings(path, interfaces=None))
    daemon.tick(0.0)
    assert (daemon.settings.on_stop, daemon.snapshot.config_error) == ("keep", "")


def test_what_changed_is_logged(load, caplog):
    """Each changed key has a line, keys that wait for a restart are named, and an unchanged file makes no plan."""
    caplog.set_level("INFO")
    settings, now_s = load(document()), 0.0
    daemon: Any = Daemon(Robot(), settings, clock=lambda: now_s, wall_clock=lambda: 1.7e9 + now_s)
    while daemon.tick(now_s).plan.generation == 0:
        now_s += DT_S
    wanted = changed("http.port") | {"on_stop": "keep", "program": {"deadline_slack": 2}}
    assert daemon.reload(lambda: load(wanted))
    told = "\n".join(record.message for record in caplog.records[-3:])
    for change in ("program.deadline_slack: 1.25 -> 2.0", "on_stop: restore -> keep", "http.port: 9464 -> 1234"):
        assert change in told
    assert daemon.tick(now_s + DT_S).reason == "reload"
    assert daemon.reload(lambda: load(wanted))
    assert daemon.tick(now_s + 2 * DT_S).reason == ""
    assert daemon.snapshot.keys_awaiting_restart == ("http.port",)
    assert daemon.snapshot.config_loaded_at_s == 1.7e9 + now_s
    assert daemon.reload(lambda: load(document()))
    daemon.tick(now_s + 3 * DT_S)
    assert daemon.snapshot.keys_awaiting_restart == ()


def test_a_file_whose_name_is_no_text_is_shown_all_the_same(load):
    """The status names it, in JSON, which has UTF-8 alone."""
    daemon: Any = Daemon(Robot(), load(document()), config_path="/etc/\udcff.yaml", clock=lambda: 0.0)
    daemon.tick(0.0)
    assert status_of(daemon.snapshot, now_s=0.0)["config_path"] == r"/etc/\udcff.yaml"


@pytest.mark.parametrize("broken", [ModuleNotFoundError("No module named 'cvxpy'"), AttributeError("np.float_")])
def test_a_solver_that_is_not_installed_is_no_reason_not_to_govern(load, monkeypatch, caplog, broken):
    """The closed form answers at a start and at a reload, whatever importing the solver raises, and the log says so."""
    monkeypatch.setattr(backends, "import_module", Mock(side_effect=broken))
    cvxpy = load({"program": {"backend": "cvxpy"}})
    reloaded = daemon_of(load(document()))
    assert reloaded.reload(lambda: cvxpy)
    for daemon in (daemon_of(cvxpy), reloaded):
        now_s = 0.0
        while daemon.tick(now_s).plan.generation == 0:
            now_s += DT_S
        assert daemon.snapshot.allocation.backend == "closed_form"
    assert caplog.text.count("program.backend: cvxpy cannot be used") == 2
