"""The configuration file: its keys, and one clear line for each fault."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest
import yaml
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from arpd.adapters.config.domain import local_domain
from arpd.adapters.config.load import describe_change, load_settings, needs_restart, restart_only_changes
from arpd.adapters.config.schema import SECTIONS, flatten, spelled
from arpd.model.errors import ConfigError
from arpd.model.settings import (
    Backend,
    FleetRobot,
    FleetSettings,
    GovernorSettings,
    GraphSettings,
    HttpSettings,
    LinkSettings,
    OnLost,
    OnStop,
    Overflow,
    Policy,
    ProgramSettings,
    RelaySettings,
    Settings,
    TopicGroup,
    TopicSettings,
)

SHIPPED = Path(__file__).parents[4] / "etc" / "arpd" / "arpd.yaml"
FAULT = re.compile(
    r"(?P<file>.+?):(?P<line>[1-9]\d*):(?P<column>[1-9]\d*): (?P<key>[^ ].*?): (?P<wrong>.+); (?P<right>.+)"
)
FUZZ = settings(max_examples=120, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


@pytest.fixture
def load(tmp_path):
    path = tmp_path / "arpd.yaml"

    def load(text, interfaces=("lo", "eth0", "wlan0")):
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return load_settings(path, interfaces=lambda: interfaces)

    return load


@pytest.fixture
def faults(load, tmp_path):
    def faults(text):
        with pytest.raises(ConfigError) as refused:
            load(text)
        for fault in refused.value.faults:
            assert FAULT.fullmatch(fault)
            assert "\n" not in fault
        return [fault.removeprefix(f"{tmp_path}/arpd.yaml:") for fault in refused.value.faults]

    return faults


def test_a_file_that_says_everything_becomes_the_settings(load):
    """Every key sets its own attribute, in base units."""
    text = """
link: {interface: wlan0, capacity: 8mbit, initial_capacity: 125kB/s, headroom: 0.5, packet_overhead: 100us, cell: hall}
program: {backend: exact, deadline_slack: 2, memory_budget: 1MiB, memory_reserve: 0B}
governor: {hold: 1s, dwell: 3s, debounce: 250ms}
http: {host: "::1", port: 9000}
graph: {sensing_topics: 11, actuation_topics: 1}
defaults: {weight: 2, min_rate_hz: 2, max_rate_hz: 20, min_depth: 2, max_depth: 50, latency_budget: none}
topics:
  - {name: /camera, max_rate_hz: source, latency_budget: 200ms}
  - {name: /scan, weight: 4, payload: 6kB, source_rate_hz: 12.5}
relay:
  link_domain: 77
  robot: robot1.local
  ceddp: "fd00::2"
  namespace: /r1
  to_ceddp: [/camera/**, /scan]
  to_robot: []
  deny: [/camera/*/raw]
  services: ["/map_server/*"]
  actions: [/go]
  call_timeout: 2s
  groups: [{topics: [/left/image, /right/image]}, {name: /depth, topics: [/depth/image, /depth/info], by: stamp}]
  prefix: /air
  topics: [{name: /camera, overflow: queue, depth: 20}, {name: /scan}]
fleet: {airtime: 0.6, robots: [{domain: 11, name: rover, weight: 2}, {domain: 12, address: 10.0.0.2}]}
on_stop: keep
on_lost: baseline
lost_after: 1min
"""
    default_topic = TopicSettings(
        weight=2.0, min_rate_hz=2.0, max_rate_hz=20.0, min_depth=2, max_depth=50, latency_budget_s=None
    )
    assert load(text) == Settings(
        link=LinkSettings(
            interface="wlan0",
            capacity_bytes_per_second=1e6,
            initial_capacity_bytes_per_second=125e3,
            headroom=0.5,
            packet_overhead_s=1e-4,
            cell="hall",
        ),
        program=ProgramSettings(
            backend=Backend.EXACT, deadline_slack=2.0, memory_budget_bytes=2.0**20, memory_reserve_bytes=0.0
        ),
        governor=GovernorSettings(hold_s=1.0, dwell_s=3.0, debounce_s=0.25),
        http=HttpSettings(host="::1", port=9000),
        graph=GraphSettings(sensing_topics=11, actuation_topics=1),
        default_topic=default_topic,
        topics={
            "/camera": replace(default_topic, max_rate_hz=None, latency_budget_s=0.2),
            "/scan": replace(default_topic, weight=4.0, payload_bytes=6000.0, source_rate_hz=12.5),
        },
        relay=RelaySettings(
            topics=("/camera", "/scan"),
            prefix="/air",
            overflow={"/camera": Overflow.QUEUE},
            depths={"/camera": 20},
            link_domain=77,
            robot="robot1.local",
            ceddp="fd00::2",
            namespace="/r1",
            to_ceddp=("/camera/**", "/scan"),
            to_robot=(),
            deny=("/camera/*/raw",),
            services=("/map_server/*",),
            actions=("/go",),
            groups=(
                TopicGroup(name="/left/image", topics=("/left/image", "/right/image")),
                TopicGroup(name="/depth", topics=("/depth/image", "/depth/info")),
            ),
            call_timeout_s=2.0,
        ),
        fleet=FleetSettings(
            airtime=0.6,
            robots=(
                FleetRobot(domain_id=11, name="rover", weight=2.0),
                FleetRobot(domain_id=12, name="robot-12", address="10.0.0.2"),
            ),
        ),
        on_stop=OnStop.KEEP,
        on_lost=OnLost.BASELINE,
        lost_after_s=60.0,
    )


@pytest.mark.parametrize("text", ["link: {interface: auto}", "{}", "on_stop: restore", "\ufefftopics: []"])
def test_what_the_file_leaves_out_is_at_its_default(load, text):
    """Every key is optional."""
    assert load(text) == Settings()


def test_the_shipped_file_is_the_defaults():
    """The file as shipped changes nothing."""
    assert load_settings(SHIPPED, interfaces=lambda: ["lo"]) == Settings()


def test_the_shipped_file_documents_every_key():
    """A comment above each key names its true default, range and reload behaviour."""
    documented, section, comment = {}, "", ""
    for line in SHIPPED.read_text().splitlines():
        if match := re.fullmatch(r"( *)(\w+):.*", line):
            section = match[2] if not match[1] else section
            documented[f"{section}.{match[2]}" if match[1] else match[2]] = comment
        elif line.lstrip().startswith("# default:"):
            comment = line.strip()
    defaults = flatten(Settings())
    for path, model in SECTIONS.items():
        for key, kind in model.kinds().items():
            dotted = ".".join((*path, key))
            if path[-1:] in {("topics",), ("groups",), ("robots",)}:
                assert f"{key}:" in SHIPPED.read_text()
                if path == ("topics",) and key not in {"name", *SECTIONS["defaults",].kinds()}:
                    described = rf"(?m)^#   {key} .* default: measured \| range: {re.escape(kind.range)}$"
                    assert re.search(described, SHIPPED.read_text()), dotted
                continue
            value = defaults[dotted]
            shown = f"{value:g}" if isinstance(value, float) else spelled(value)
            reload = "restart" if needs_restart(dotted) else "yes"
            assert documented[dotted] == f"# default: {shown} | range: {kind.range} | reload: {reload}", dotted


def test_the_examples_in_the_shipped_file_load(load):
    """The examples in comments load once they are uncommented."""
    blocks = re.findall(r"(?m)^ *#     topics:\n(?:^ *#       .*\n)+", SHIPPED.read_text())
    topics, relayed = (re.sub(r"(?m)^ *#     ", "  ", block) for block in blocks)
    camera = load(topics).topics["/link/camera/image/compressed"]
    assert (camera.latency_budget_s, camera.payload_bytes, camera.source_rate_hz) == (0.2, 30_000.0, 30.0)
    assert load(f"relay:\n{relayed}").relay.topics == ("/camera/image/compressed",)
    (block,) = re.findall(r"(?m)^ *#     groups:\n(?:^ *#       .*\n)+", SHIPPED.read_text())
    groups = re.sub(r"(?m)^ *#     ", "  ", block)
    (group,) = load(f"relay:\n  link_domain: 77\n  ceddp: 10.0.0.2\n{groups}").relay.groups
    assert (group.name, len(group.topics)) == ("/stereo", 4)
    (block,) = re.findall(r"(?m)^ *#     robots:\n(?:^ *#       .*\n)+", SHIPPED.read_text())
    robots = re.sub(r"(?m)^ *#     ", "  ", block)
    (rover,) = load(f"fleet:\n{robots}").fleet.robots
    assert rover == FleetRobot(domain_id=11, name="rover", weight=2.0, address="10.0.0.1")


@pytest.mark.parametrize(
    "block", re.findall(r"(?ms)^```yaml\n(.*?)^```", (SHIPPED.parents[2] / "docs" / "configuration.md").read_text())
)
def test_the_examples_in_the_manual_load(load, block):
    """Each example is a whole file without a fault."""
    assert load(block) != Settings()


ONE_FAULT = {
    "wrong type": ("link:\n  headroom: much\n", "2:13: link.headroom: 'much' is not a number; write 0.05..1"),
    "text for a count": ("http:\n  port: '9464'\n", "2:9: http.port: '9464' is not a whole number; write 0..65535"),
    "bool for a count": ("http:\n  port: true\n", "2:9: http.port: true is not a whole number; write 0..65535"),
    "bool for a number": ("link: {headroom: true}\n", "1:18: link.headroom: true is not a number; write 0.05..1"),
    "fraction for a count": ("http: {port: 80.5}", "1:14: http.port: 80.5 is not a whole number; write 0..65535"),
    "null": ("http: {port: }", "1:13: http.port: nothing is not a whole number; write 0..65535"),
    "nan": ("link: {headroom: .nan}", "1:18: link.headroom: nan is not a finite number; write 0.05..1"),
    "infinite": ("defaults: {weight: .inf}", "1:20: defaults.weight: inf is not a finite number; write 0.001..1000"),
    "out of range": ("link: {headroom: 1.5}", "1:18: link.headroom: 1.5 is above 1; write 0.05..1"),
    "below range": ("http: {port: -1}", "1:14: http.port: -1 is below 0; write 0..65535"),
    "no unit": ("governor: {hold: 2}", "1:18: governor.hold: 2 has no unit; write a duration like 500ms"),
    "unknown unit": (
        "link: {capacity: 5parsec}",
        "1:18: link.capacity: 'parsec' is not a unit of a rate; write it like 20mbit or 125kB/s",
    ),
    "quantity out of range": (
        "link: {capacity: 1bit}",
        "1:18: link.capacity: 1bit is out of range; write 8kbit..100gbit or auto",
    ),
    "relayed output": (
        "relay: {topics: [{name: /link/scan}]}",
        "1:25: relay.topics[0].name: '/link/scan' lies under relay.prefix /link, where relayed topics go; write /scan",
    ),
    "relayed output under a prefix": (
        "relay: {prefix: /a/b, topics: [{name: /a/bc}, {name: /a/b/c/d}]}",
        "1:54: relay.topics[1].name: '/a/b/c/d' lies under relay.prefix /a/b, where relayed topics go; write /c/d",
    ),
    "relayed prefix": (
        "relay: {topics: [{name: /link}]}",
        "1:25: relay.topics[0].name: '/link' is relay.prefix itself; name a topic, or change prefix",
    ),
    "link domain out of range": (
        "relay: {link_domain: 233, robot: a}",
        "1:22: relay.link_domain: 233 is above 232; write 0..232 or none",
    ),
    "two ends that cannot find each other": (
        "relay:\n  link_domain: 77\n",
        (
            "2:16: relay.link_domain: needs the address of one end, or nobody would find the other; "
            "give relay.robot or relay.ceddp"
        ),
    ),
    "a key of two ends": (
        "relay: {robot: 10.0.0.1}",
        "1:16: relay.robot: needs relay.link_domain; give that a number, or remove this key",
    ),
    "nothing to the robot of one end": (
        "relay: {to_robot: []}",
        "1:19: relay.to_robot: needs relay.link_domain; give that a number, or remove this key",
    ),
    "groups of one end": (
        "relay:\n  groups:\n  - topics: [/a, /b]\n",
        "3:3: relay.groups: needs relay.link_domain; give that a number, or remove this key",
    ),
    "no address": (
        "relay: {link_domain: 77, robot: 10.0.0.256}",
        "1:33: relay.robot: '10.0.0.256' is not an address; write an IP address, a host name or none",
    ),
    "relative namespace": (
        "relay: {link_domain: 77, robot: a, namespace: r1}",
        "1:47: relay.namespace: 'r1' is not an absolute ROS name; write /r1",
    ),
    "namespace of arpd": (
        "relay: {link_domain: 77, robot: a, namespace: /arpd}",
        "1:47: relay.namespace: '/arpd' is a name that never crosses the link; write one such as /robot1",
    ),
    "text for a list": (
        "relay: {link_domain: 77, robot: a, deny: /x}",
        "1:42: relay.deny: '/x' is not a list; write a list of names and patterns such as [/scan, /camera/**]",
    ),
    "bad pattern": (
        "relay: {link_domain: 77, robot: a, to_ceddp: [/a, /b**]}",
        (
            "1:51: relay.to_ceddp[1]: '/b**' is not a pattern of absolute ROS names; "
            "write a name such as /scan or a pattern such as /camera/**"
        ),
    ),
    "relative pattern": (
        "relay: {link_domain: 77, robot: a, services: [a/**]}",
        "1:47: relay.services[0]: 'a/**' is not a pattern of absolute ROS names; write /a/**",
    ),
    "number for a pattern": (
        "relay: {link_domain: 77, robot: a, actions: [1]}",
        "1:46: relay.actions[0]: 1 is not a pattern; write a name such as /scan or a pattern such as /camera/**",
    ),
    "long pattern": (
        f"relay: {{link_domain: 77, robot: a, deny: [/{'a' * 247}]}}",
        "1:43: relay.deny[0]: is 248 characters long; ROS allows 247",
    ),
    "pattern in a group": (
        "relay: {link_domain: 77, robot: a, groups: [{topics: [/left/image, /right/**]}]}",
        "1:68: relay.groups[0].topics[1]: '/right/**' is a pattern; name each topic of the group",
    ),
    "group of one": (
        "relay: {link_domain: 77, robot: a, groups: [{topics: [/left/image]}]}",
        "1:54: relay.groups[0].topics: has one topic; name at least two, or remove the group",
    ),
    "group of none": (
        "relay: {link_domain: 77, robot: a, groups: [{topics: []}]}",
        "1:54: relay.groups[0].topics: has no topic; name at least two, or remove the group",
    ),
    "mapping for groups": (
        "relay: {link_domain: 77, robot: a, groups: {topics: [/a, /b]}}",
        "1:44: relay.groups: a mapping is not a list; write items with `- topics:`, or [] for none",
    ),
    "group by another feature": (
        "relay: {link_domain: 77, robot: a, groups: [{topics: [/a, /b], by: time}]}",
        "1:68: relay.groups[0].by: 'time' is not one of the choices; write stamp",
    ),
    "topic of two groups": (
        "relay:\n  link_domain: 77\n  robot: a\n  groups:\n  - topics: [/a, /b]\n  - topics: [/c, /a]\n",
        "6:18: relay.groups[1].topics[1]: '/a' is already in a group on line 5; keep one of the two",
    ),
    "name of two groups": (
        (
            "relay:\n  link_domain: 77\n  robot: a\n  groups:\n"
            "  - {name: /g, topics: [/a, /b]}\n  - {name: /g, topics: [/c, /d]}\n"
        ),
        "6:12: relay.groups[1].name: '/g' is already given on line 5; keep one of the two",
    ),
    "group named like another's topic": (
        "relay:\n  link_domain: 77\n  robot: a\n  groups:\n  - {topics: [/a, /b]}\n  - {name: /b, topics: [/c, /d]}\n",
        "6:12: relay.groups[1].name: '/b' is a topic of the group on line 5; choose another name",
    ),
    "settings of a grouped topic": (
        (
            "relay:\n  link_domain: 77\n  robot: a\n  groups:\n  - topics: [/left/image, /right/image]\n"
            "  topics:\n  - {name: /left/image, depth: 3}\n  - {name: /right/image, depth: 3}\n"
        ),
        "8:12: relay.topics[1].name: '/right/image' is in group /left/image; set this for the group",
    ),
    "preferences of a grouped topic": (
        (
            "relay: {link_domain: 77, robot: a, groups: [{name: /g, topics: [/a, /b]}, {name: /d, topics: [/c, /d]}]}\n"
            "topics:\n- name: /g\n- name: /d\n- name: /a\n  weight: 2\n"
        ),
        "5:9: topics[2].name: '/a' is in group /g; set this for the group",
    ),
    "long name on the CEDDP": (
        f"relay: {{link_domain: 77, robot: a, namespace: /r1, topics: [{{name: /{'a' * 244}}}]}}",
        "1:68: relay.topics[0].name: with relay.namespace is 248 characters long; ROS allows 247",
    ),
    "robot without a domain": (
        "fleet:\n  robots:\n  - name: rover\n",
        "3:5: fleet.robots[0].domain: is missing; give every item one",
    ),
    "robot of no domain": (
        "fleet: {robots: [{domain: 233}]}",
        "1:27: fleet.robots[0].domain: 233 is above 232; write 0..232",
    ),
    "robot of no weight": (
        "fleet: {robots: [{domain: 1, weight: 0}]}",
        "1:38: fleet.robots[0].weight: 0 is below 0.001; write 0.001..1000",
    ),
    "robot with a bad name": (
        "fleet: {robots: [{domain: 1, name: a b}]}",
        "1:36: fleet.robots[0].name: 'a b' is not a robot's name; write up to 32 letters, digits and . _ -",
    ),
    "two robots in a domain": (
        "fleet:\n  robots:\n  - domain: 11\n  - {domain: 11, name: rover}\n",
        "4:14: fleet.robots[1].domain: 11 is already given on line 3; each robot needs a domain of its own",
    ),
    "two robots of a name": (
        "fleet:\n  robots:\n  - domain: 11\n  - {domain: 12, name: robot-11}\n",
        ("4:24: fleet.robots[1].name: 'robot-11' is already the name of the robot on line 3; choose another name"),
    ),
    "robots in a mapping": (
        "fleet: {robots: {domain: 1}}",
        "1:17: fleet.robots: a mapping is not a list; write items with `- domain:`, or [] for none",
    ),
    "all of the time and more": ("fleet: {airtime: 1.5}", "1:18: fleet.airtime: 1.5 is above 1; write 0.05..1"),
    "unknown choice": ("on_stop: explode", "1:10: on_stop: 'explode' is not one of the choices; write restore or keep"),
    "near key": ("link:\n  headrom: 0.9\n", "2:3: link.headrom: is not a key arpd knows; did you mean headroom?"),
    "near section": ("\nlinks: {}\n", "2:1: links: is not a key arpd knows; did you mean link?"),
    "removed key": (
        "governor: {deadband: 0.1}",
        (
            "1:12: governor.deadband: was removed: DEPTH and DEADLINE now move in classes, within 1 % of the link; "
            "delete this line"
        ),
    ),
    "misplaced key": ("port: 80\n", "1:1: port: is not a key arpd knows; did you mean http.port?"),
    "an assumption for all topics": (
        "defaults: {payload: 1kB}",
        "1:12: defaults.payload: is not a key arpd knows; did you mean topics.payload?",
    ),
    "size without a unit": (
        "topics: [{name: /a, payload: 30}]",
        "1:30: topics[0].payload: 30 has no unit; write a size like 64MiB",
    ),
    "no size": (
        "topics: [{name: /a, payload: 0B}]",
        "1:30: topics[0].payload: 0B is out of range; write 1B..1GB or measured",
    ),
    "no source rate": (
        "topics: [{name: /a, source_rate_hz: 0}]",
        "1:37: topics[0].source_rate_hz: 0 is below 0.001; write 0.001..100000 or measured",
    ),
    "far key": ("http: {zzz: 1}", "1:8: http.zzz: is not a key arpd knows; known here: host, port, web_config"),
    "key without a name": (
        "http: {'': 2}",
        "1:8: http.'': is not a key arpd knows; known here: host, port, web_config",
    ),
    "number for a key": ("http: {1: 2}", "1:8: http: has a number for a key; write a name"),
    "empty section": ("http:\n", "1:6: http: has no value; give it keys (host, port, web_config) or leave it out"),
    "list for a section": (
        "http: [1]",
        "1:7: http: a list is not a mapping; give it keys (host, port, web_config) or leave it out",
    ),
    "mapping for a list": (
        "topics: {name: /a}",
        "1:9: topics: a mapping is not a list; write items with `- name:`, or [] for none",
    ),
    "duplicate key": (
        "on_stop: keep\nlink: {}\non_stop: keep\n",
        "3:1: on_stop: is already given on line 1; keep one of the two",
    ),
    "duplicate topic": (
        "topics:\n  - name: /a\n  - name: /b\n  - name: /a\n",
        "4:11: topics[2].name: '/a' is already given on line 2; keep one of the two",
    ),
    "duplicate relayed topic": (
        "relay:\n  topics:\n  - name: /a\n  - name: /a\n",
        "4:11: relay.topics[1].name: '/a' is already given on line 3; keep one of the two",
    ),
    "nameless topic": ("topics:\n  - weight: 1\n", "2:5: topics[0].name: is missing; give every item one"),
    "relative name": (
        "topics:\n  - name: camera/image\n",
        "2:11: topics[0].name: 'camera/image' is not an absolute ROS name; write /camera/image",
    ),
    "bad name": (
        "topics: [{name: /1a}]",
        "1:17: topics[0].name: '/1a' is not an absolute ROS name; write an absolute ROS name such as /camera/image",
    ),
    "minimum above maximum": (
        "topics:\n    - name: /a\n      max_rate_hz: 20.0\n      min_rate_hz: 50.0\n",
        "4:20: topics[0].min_rate_hz: 50.0 is above max_rate_hz 20.0; lower it or raise max_rate_hz",
    ),
    "minimum above the default's maximum": (
        "defaults: {max_rate_hz: 20}\ntopics:\n- {name: /a, min_rate_hz: 50}",
        "3:27: topics[0].min_rate_hz: 50.0 is above max_rate_hz 20.0 (the default); lower it or raise max_rate_hz",
    ),
    "maximum below the default minimum": (
        "topics:\n- {name: /a, max_rate_hz: 0.5}",
        "2:27: topics[0].max_rate_hz: 0.5 is below min_rate_hz 1.0 (the default); raise it or lower min_rate_hz",
    ),
    "depths crossed": (
        "defaults: {min_depth: 9, max_depth: 3}",
        "1:23: defaults.min_depth: 9 is above max_depth 3; lower it or raise max_depth",
    ),
    "no such interface": (
        "link:\n  interface: wlan9\n",
        "2:14: link.interface: 'wlan9' does not exist on this host; write auto or one of eth0, lo, wlan0",
    ),
    "empty": ("", "1:1: file: is empty; a minimal one is `link: {interface: auto}`"),
    "only comments": ("# nothing\n---\n", "1:1: file: is empty; a minimal one is `link: {interface: auto}`"),
    "a list": ("- a", "1:1: file: is a list, not a mapping of keys; a minimal one is `link: {interface: auto}`"),
    "two documents": ("link: {}\n---\nhttp: {}\n", "2:1: yaml: holds a second YAML document; keep one"),
    "broken": ("link: [1\n", "2:1: yaml: expected ',' or ']', but got '<stream end>'; correct the YAML here"),
    "control character": ("a: b\nc: \x07", "2:4: yaml: a control character is not allowed here; remove it"),
    "not UTF-8": (b"link: {}\non_stop: \xff", "2:10: file: byte 0xff is not UTF-8; save it as UTF-8"),
    "anchor": ("link: &a {}\n", "1:7: yaml: anchor &a is not allowed; remove it"),
    "alias": ("link: {}\nhttp: *a\n", "2:7: yaml: alias *a is not allowed; write the value out"),
    "tag": ("link: !!python/none x\n", "1:7: yaml: tag tag:yaml.org,2002:python/none is not allowed; remove it"),
    "deep": ("link: " + "[" * 50_000, "1:26: yaml: is nested more than 20 deep; remove levels"),
    "too large": ("#" * (2**20 + 1), "1:1: file: is larger than 1 MiB; shorten it or name another file"),
    "escape out of range": ('on_stop: "\\UFFFFFFFF"', "1:13: yaml: a number is out of range; correct the YAML here"),
    "lone surrogate": (
        'on_stop: "\\uD800"',
        "1:10: on_stop: '\\ud800' is not one of the choices; write restore or keep",
    ),
    "huge number": ("http: {port: " + "9" * 5000 + "}", "1:14: http.port: inf is not a whole number; write 0..65535"),
}


@pytest.mark.parametrize(("text", "fault"), ONE_FAULT.values(), ids=ONE_FAULT)
def test_each_fault_is_one_line_with_its_place_and_the_way_out(faults, text, fault):
    """A fault names its place, what is wrong and what would be right."""
    assert faults(text) == [fault]


def test_an_alias_bomb_is_refused_before_it_expands(faults):
    """Reading ends at the first anchor."""
    bomb = "a: &a [x]\n" + "".join(
        f"{chr(98 + n)}: &{chr(98 + n)} [{', '.join(['*' + chr(97 + n)] * 9)}]\n" for n in range(20)
    )
    assert faults(bomb) == ["1:4: yaml: anchor &a is not allowed; remove it"]


def test_all_faults_are_reported_at_once_in_the_order_of_the_file(faults):
    """One run of `arpd check` shows every fault; a faulty value hides no other."""
    text = """\
link: {interface: wlan9, headroom: much}
topics:
  - {name: /a, min_rate_hz: x, max_rate_hz: 0.1}
  - {name: /a, bogus: 1}
link: {}
defaults: {min_depth: 5, max_depth: 2}
"""
    assert [fault.split(": ")[:2] for fault in faults(text)] == [
        ["1:19", "link.interface"],
        ["1:36", "link.headroom"],
        ["3:29", "topics[0].min_rate_hz"],
        ["4:12", "topics[1].name"],
        ["4:16", "topics[1].bogus"],
        ["5:1", "link"],
        ["6:23", "defaults.min_depth"],
    ]


@pytest.mark.parametrize(
    ("path", "wrong"),
    [
        ("missing.yaml", "does not exist"),
        (".", "is a directory"),
        ("arpd.yaml/x", "cannot be read"),
        ("a\0b", "cannot be read"),
    ],
)
def test_a_file_that_cannot_be_read_is_one_line(tmp_path, path, wrong):
    """Any bad path is one fault instead of a traceback."""
    (tmp_path / "arpd.yaml").write_text("{}")
    with pytest.raises(ConfigError) as refused:
        load_settings(tmp_path / path, interfaces=None)
    assert len(refused.value.faults) == 1
    assert wrong in refused.value.faults[0]
    assert "\n" not in refused.value.faults[0]


def test_interfaces_are_not_checked_where_they_are_not_known(tmp_path):
    """A robot's file can be checked on another computer."""
    (tmp_path / "arpd.yaml").write_text("link: {interface: wlan9}")
    assert load_settings(tmp_path / "arpd.yaml", interfaces=None).link.interface == "wlan9"


def test_names_that_grow_too_long_with_the_relay_prefix_are_refused(faults):
    """ROS would refuse the publisher only at run time."""
    name = "/" + "a" * 244
    fault = f"1:25: relay.topics[0].name: with its prefix is {len(name) + 5} characters long; ROS allows 247"
    assert faults(f"relay: {{topics: [{{name: {name}}}]}}") == [fault]


def test_the_link_domain_must_not_be_the_one_of_this_computers_nodes(tmp_path):
    """In the domain of the robot's nodes the two ends would see their own copies."""
    path = tmp_path / "arpd.yaml"
    path.write_text("relay: {link_domain: 7, ceddp: 10.0.0.2}")
    with pytest.raises(ConfigError) as refused:
        load_settings(path, interfaces=None, local_domain=7)
    fault = "1:22: relay.link_domain: 7 is the domain of this computer's own nodes (ROS_DOMAIN_ID); choose another"
    assert refused.value.faults == [f"{path}:{fault}"]
    for other in (0, None):
        assert load_settings(path, interfaces=None, local_domain=other).relay.link_domain == 7


@pytest.mark.parametrize(
    ("environment", "domain"),
    [
        ({}, 0),
        ({"ROS_DOMAIN_ID": ""}, 0),
        ({"ROS_DOMAIN_ID": "42"}, 42),
        ({"ROS_DOMAIN_ID": "0x10"}, 16),
        ({"ROS_DOMAIN_ID": "x"}, None),
    ],
)
def test_the_domain_of_this_computers_nodes(environment, domain):
    """The local domain is the one that rcl reads from the environment."""
    assert local_domain(environment) == domain


def test_two_ends_carry_topics_under_any_name(load):
    """The prefix means nothing to two ends, so its rules do not hold."""
    loaded = load("relay: {link_domain: 77, ceddp: a, topics: [{name: /link}, {name: /link/scan}]}")
    assert loaded.relay.topics == ("/link", "/link/scan")


@pytest.mark.parametrize("address", ["10.0.0.2", "'fd00::2'", "robot", "robot-1.local", "a_b"])
def test_an_end_has_an_address_or_a_host_name(load, address):
    """Both kinds of IP addresses and any host name are fine."""
    assert load(f"relay: {{link_domain: 77, robot: {address}}}").relay.robot == address.strip("'")


def test_a_change_of_a_list_is_described_and_needs_a_restart():
    """Lists read as in the file."""
    old = Settings()
    group = TopicGroup(name="/left/image", topics=("/left/image", "/right/image"))
    relay = RelaySettings(
        link_domain=77, ceddp="a", deny=("/x", "/y/**"), to_robot=(), namespace="/r1", groups=(group,)
    )
    new = Settings(relay=relay)
    assert describe_change(old, new) == [
        "relay.link_domain: none -> 77",
        "relay.ceddp: none -> a",
        "relay.namespace: none -> /r1",
        "relay.to_robot: [/**] -> []",
        "relay.deny: [] -> [/x, /y/**]",
        "relay.groups[/left/image].topics: absent -> [/left/image, /right/image]",
        "relay.groups[/left/image].by: absent -> stamp",
    ]
    assert restart_only_changes(old, new) == [line.partition(":")[0] for line in describe_change(old, new)]


def test_what_a_topic_is_assumed_to_publish_is_its_own_and_may_be_left_to_measurement(load):
    """`measured` equals leaving the key out, and no other topic inherits the assumed values."""
    text = (
        "topics: [{name: /a, payload: 1kB, source_rate_hz: 5}, {name: /b, payload: measured, source_rate_hz: measured}]"
    )
    loaded = load(text)
    assert loaded.topics["/a"] == TopicSettings(payload_bytes=1000.0, source_rate_hz=5.0)
    assert loaded.topics["/b"] == loaded.topic("/c") == TopicSettings()


def test_a_change_of_what_is_assumed_is_described_and_needs_no_restart():
    """A reload applies the assumed values."""
    old = Settings(topics={"/a": TopicSettings()})
    new = Settings(topics={"/a": TopicSettings(payload_bytes=30_000.0, source_rate_hz=30.0)})
    assert describe_change(old, new) == [
        "topics[/a].payload: measured -> 30kB",
        "topics[/a].source_rate_hz: measured -> 30.0",
    ]
    assert restart_only_changes(old, new) == []


@pytest.mark.parametrize("text", ["defaults: {weight: 010}", "defaults: {weight: 1e1}", "defaults: {weight: 10.}"])
def test_numbers_are_those_of_yaml_1_2(load, text):
    """A leading zero is not octal, and an exponent needs no point."""
    assert load(text).default_topic.weight == 10.0


def test_a_change_is_described_in_the_words_of_the_file():
    """A reload logs the keys that it changed and those that wait for a restart."""
    old = Settings(topics={"/a": TopicSettings()})
    new = replace(
        old,
        link=replace(old.link, capacity_bytes_per_second=1e6, interface="wlan0"),
        http=replace(old.http, port=1),
        relay=RelaySettings(topics=("/scan",)),
        topics={"/a": TopicSettings(latency_budget_s=None)},
        on_stop=OnStop.KEEP,
    )
    assert describe_change(old, new) == [
        "link.interface: auto -> wlan0",
        "link.capacity: auto -> 8mbit",
        "http.port: 9464 -> 1",
        "topics[/a].latency_budget: 1s -> none",
        "on_stop: restore -> keep",
        "relay.topics[/scan].overflow: absent -> latest",
        "relay.topics[/scan].depth: absent -> 10",
    ]
    assert restart_only_changes(old, new) == [
        "link.interface",
        "http.port",
        "relay.topics[/scan].overflow",
        "relay.topics[/scan].depth",
    ]
    assert describe_change(new, new) == []


def _check_any(load, text):
    faults = ["a.yaml:1:1: none: was found; that is right"]
    try:
        assert isinstance(load(text), Settings)
    except ConfigError as error:
        faults = error.faults
    assert faults
    assert all(FAULT.fullmatch(fault) for fault in faults)


_YAML_BITS = st.sampled_from(
    [
        *"[]{}'\"|>#?~\t\n\x85é-",
        *("link", "topics", "name", ": ", ":\n", "  ", "- ", ", ", "&a", "*a", "!!str ", "---\n"),
        *("...\n", "%TAG ! x\n", '"\\U99999999"', "/a", "20mbit", "1e400", "<<"),
    ]
)


@FUZZ
@given(
    st.binary(max_size=200)
    | st.text(max_size=200).map(lambda text: text.encode("utf-8", "surrogatepass"))
    | st.lists(_YAML_BITS, max_size=40).map("".join)
)
@example(b'"\\xFFFF": &')
@example(b"? [a]\n: b")
@example(b"%YAML 1." + b"9" * 5000 + b"\n---\na: 1")
def test_any_file_is_settings_or_faults(load, raw):
    """Any bytes, text or heap of YAML loads or raises ConfigError."""
    _check_any(load, raw)


_KEYS = st.sampled_from(sorted({key for model in SECTIONS.values() for key in model.model_fields})) | st.text(
    max_size=5
)
_LEAVES = (
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats()
    | st.text(max_size=10)
    | st.sampled_from(
        ["auto", "source", "none", "20mbit", "64MiB", "5s", "/a", "/a/b", "osqp", "keep", "latest", 1, 0.5, 10]
    )
)
_TREES = st.recursive(
    _LEAVES, lambda inner: st.lists(inner, max_size=4) | st.dictionaries(_KEYS, inner, max_size=6), max_leaves=25
)


@FUZZ
@given(st.dictionaries(_KEYS, _TREES, max_size=6) | _TREES)
def test_any_structure_is_settings_or_faults(load, tree):
    """A value of any shape at any key loads or is a fault."""
    _check_any(load, yaml.safe_dump(tree, allow_unicode=True))


_VALID = st.fixed_dictionaries(
    {},
    optional={
        "link": st.fixed_dictionaries({}, optional={"headroom": st.floats(0.05, 1), "capacity": st.just("20mbit")}),
        "program": st.fixed_dictionaries({}, optional={"backend": st.sampled_from(["osqp", "exact"])}),
        "topics": st.lists(
            st.fixed_dictionaries(
                {"name": st.from_regex(r"(/[a-z]{1,4}){1,2}", fullmatch=True)},
                optional={"weight": st.floats(0.001, 1000), "max_depth": st.integers(1, 5000)},
            ),
            max_size=4,
            unique_by=lambda topic: topic["name"],
        ),
    },
)


@FUZZ
@given(_VALID)
def test_what_is_within_the_ranges_loads_and_keeps_its_values(load, tree):
    """A file with valid values loads."""
    loaded = load(yaml.safe_dump(tree))
    assert list(loaded.topics) == [topic["name"] for topic in tree.get("topics", [])]
    for topic in tree.get("topics", []):
        assert loaded.topics[topic["name"]].weight == topic.get("weight", 1.0)


def test_the_policy_is_one_of_two(load, faults):
    """The link is divided per topic unless the file says uniform; then no topic has preferences of its own."""
    assert load("program: {backend: exact}").program.policy is Policy.PER_TOPIC
    loaded = load("program: {policy: uniform}\ndefaults: {weight: 2}\ntopics: [{name: /a, weight: 9}]")
    assert loaded.program.policy is Policy.UNIFORM
    assert loaded.topic("/a") == loaded.topic("/b") == TopicSettings(weight=2.0)
    assert faults("program: {policy: fair}") == [
        "1:19: program.policy: 'fair' is not one of the choices; write per_topic or uniform"
    ]
