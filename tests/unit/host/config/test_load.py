"""The configuration file: its keys, and one clear line for each fault."""

from __future__ import annotations

import os
import re
from pathlib import Path
from threading import Thread

import pytest
import yaml

from arpd.host.config import load as loading
from arpd.host.config.keys import SCHEMA, SECTIONS, flatten, spelled
from arpd.host.config.load import load_settings
from arpd.model.errors import ConfigError
from arpd.model.settings import OnStop, Policy, Preferences, Settings

SHIPPED = Path(__file__).parents[4] / "etc" / "arpd" / "arpd.yaml"
AT_START = ("link.interface", "http.", "relay.")  # keys that are read at start only; `test_reload` tries one of each
FAULT = re.compile(
    r"(?P<file>.+?):(?P<line>[1-9]\d*):(?P<column>[1-9]\d*): (?P<key>[^ ].*?): (?P<wrong>.+); (?P<right>.+)"
)


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


def _written(value, path=""):
    """Yield every key of a file and its value, with the names of lists' items."""
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from _written(inner, f"{path}.{key}".lstrip("."))
    elif isinstance(value, list) and value and isinstance(value[0], dict):
        for item in value:
            yield from _written(item, f"{path}[{item.pop('name')}]")
    else:
        yield path, value


def test_a_file_that_says_everything_becomes_the_settings(load):
    """Every key sets its own value, in base units, and a topic has the defaults of the file."""
    text = """
link: {interface: wlan0, capacity: 8mbit, initial_capacity: 1mbit, headroom: 0.5, packet_overhead: 100us}
program: {backend: closed_form, deadline_slack: 2, memory_budget: 1MiB, memory_reserve: 0B}
governor: {hold: 1s, dwell: 3s, debounce: 250ms}
http: {host: "::1", port: 9000}
graph: {sensing_topics: 11, actuation_topics: 1}
defaults: {weight: 2, min_rate_hz: 2, max_rate_hz: 20, min_depth: 2, max_depth: 50, latency_budget: none}
topics:
  - {name: /camera, max_rate_hz: source, latency_budget: 0.2s, payload: measured, source_rate_hz: measured}
  - {name: /scan, weight: 4, min_rate_hz: 3, payload: 6kB, source_rate_hz: 12.5}
relay:
  link_domain: 77
  robot: robot1.local
  base: 10.0.0.2
  namespace: /r1
  to_base: [/camera/**, /scan]
  to_robot: []
  deny: [/camera/*/raw]
  services: ["/map_server/*"]
  actions: [/go]
  call_timeout: 2s
  groups: [{name: /left, topics: [/left/image, /right/image]}, {name: /depth, topics: [/depth/image, /depth/info]}]
  prefix: /air
  topics: [{name: /camera, overflow: queue, depth: 20}, {name: /scan}]
on_stop: keep
on_lost: baseline
lost_after: 60s
"""
    settings = load(text)
    shown = flatten(settings)
    for key, value in _written(yaml.safe_load(text)):
        assert shown[key] == value, key
    assert (settings.link.capacity_bytes_per_second, settings.link.packet_overhead_s) == (1e6, 1e-4)
    assert (settings.program.memory_budget_bytes, settings.lost_after_s) == (2**20, 60.0)
    camera, scan = settings.topics
    assert (camera.max_rate_hz, camera.latency_budget_s, camera.payload_bytes, camera.weight) == (None, 0.2, None, 2.0)
    assert (scan.max_rate_hz, scan.latency_budget_s, scan.payload_bytes, scan.weight) == (20.0, None, 6000.0, 4.0)


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
    for path, keys in SECTIONS.items():
        for key in keys:
            dotted = ".".join((*path, key))
            if (*path, key) in SECTIONS:
                continue
            if path[-1:] in {("topics",), ("groups",)}:
                assert f"{key}:" in SHIPPED.read_text()
                continue
            value = defaults[dotted]
            shown = f"{value:g}" if isinstance(value, float) else spelled(value)
            reload = "restart" if dotted.startswith(AT_START) else "yes"
            told = rf"# default: {re.escape(shown)} \| range: {_range(keys[key])} \| reload: {reload}"
            assert re.fullmatch(told, documented[dotted]), dotted


def _range(schema):
    """Return an expression for what the manual says of the values that a JSON schema allows."""
    if "$ref" in schema:
        return " \\| ".join(SCHEMA["$defs"][schema["$ref"].rpartition("/")[2]]["enum"])
    bounds = next((each for each in [schema, *schema.get("anyOf", [])] if "minimum" in each), None)
    return rf"{bounds['minimum']:g}\.\.{bounds['maximum']:.12g}.*" if bounds else ".+"


def test_the_examples_in_the_shipped_file_load(load):
    """The examples in comments load once they are uncommented."""
    blocks = re.findall(r"(?m)^ *#     topics:\n(?:^ *#       .*\n)+", SHIPPED.read_text())
    topics, relayed = (re.sub(r"(?m)^ *#     ", "  ", block) for block in blocks)
    loaded = load(topics)
    camera = loaded.topics[0]
    assert (camera.latency_budget_s, camera.payload_bytes, camera.source_rate_hz) == (0.2, 30_000.0, 30.0)
    assert load(f"relay:\n{relayed}").relay.topic_names == ("/camera/image/compressed",)
    (block,) = re.findall(r"(?m)^ *#     groups:\n(?:^ *#       .*\n)+", SHIPPED.read_text())
    groups = re.sub(r"(?m)^ *#     ", "  ", block)
    (group,) = load(f"relay:\n  link_domain: 77\n  base: 10.0.0.2\n{groups}").relay.groups
    assert (group.name, len(group.topics)) == ("/stereo", 4)


@pytest.mark.parametrize(
    "block", re.findall(r"(?ms)^```yaml\n(.*?)^```", (SHIPPED.parents[2] / "docs" / "configuration.md").read_text())
)
def test_the_examples_in_the_manual_load(load, block):
    """Each example is a whole file without a fault."""
    assert load(block) != Settings()


ENDS = "relay: {link_domain: 77, robot: a, "
# The file, the place of its one fault and the key there, and what the fault says besides.
ONE_FAULT = [
    # values
    ("http:\n  port: many\n", "2:9: http.port", "many does not fit; it should be a valid integer"),
    ("http: {port: " + "9" * 5000 + "}", "1:14: http.port", "as an integer"),
    ("link: {headroom: 1.5}", "1:18: link.headroom", "1.5 does not fit; it should be less than or equal to 1"),
    ("governor: {hold: 2}", "1:18: governor.hold", "'2' has no unit"),
    ("governor: {hold: 2h}", "1:18: governor.hold", "2h is out of range; write 0s..1h"),
    ("link: {capacity: }", "1:17: link.capacity", "has no value; write one, or leave the key out"),
    ("link: {capacity: 5parsec}", "1:18: link.capacity", "'parsec' is not a unit"),
    ("on_stop: explode", "1:10: on_stop", "explode does not fit; it should be 'restore' or 'keep'"),
    ('on_stop: "\\uD800"', "1:10: on_stop", "\\ud800 does not fit; it should be a valid string"),
    ("link:\n  interface: wlan9\n", "2:14: link.interface", "write auto or one of eth0, lo, wlan0"),
    ("link: {interface: ../lo}", "1:19: link.interface", "'../lo' is empty, too long, or has a character that cannot"),
    ("http: {host: ''}", "1:14: http.host", "'' is empty"),
    ("http: {host: 'robot:99'}", "1:14: http.host", "'robot:99' is empty, too long, or has a character that cannot"),
    # keys
    ("link:\n  headrom: 0.9\n", "2:3: link.headrom", "did you mean headroom?"),
    ("port: 80\n", "1:1: port", "did you mean http.port?"),
    ("governor: {deadband: 0.1}", "1:12: governor.deadband", "unknown key; known here: hold, dwell, debounce"),
    ("http: {1: 2}", "1:8: http.1", "unknown key"),
    ("http: {[a]: 2}", "1:8: yaml", "a key cannot be a list"),
    ("http:\n", "1:6: http", "is not a mapping; give it keys (host, port, web_config)"),
    ("on_stop: keep\nlink: {}\non_stop: keep\n", "3:1: on_stop", "already given on line 1"),
    # topics
    ("topics:\n  - name: /a\n  - name: /b\n  - name: /a\n", "4:11: topics[2].name", "already given on line 2"),
    ("topics:\n  - weight: 1\n", "2:5: topics[0].name", "is missing"),
    ("topics:\n  - name: camera/image\n", "2:11: topics[0].name", "write /camera/image"),
    (
        "topics:\n    - name: /a\n      max_rate_hz: 20.0\n      min_rate_hz: 50.0\n",
        "4:20: topics[0].min_rate_hz",
        "min_rate_hz 50 is above max_rate_hz 20; lower min_rate_hz or raise max_rate_hz",
    ),
    ("topics: [{name: /a/**, payload: 1kB}]", "1:33: topics[0].payload", "belongs to one topic; name it without stars"),
    # the relay
    ("relay: {prefix: /arpd}", "1:17: relay.prefix", "holds arpd's own topics; write one such as /robot1"),
    ("relay: {topics: [{name: /link/scan}]}", "1:25: relay.topics[0].name", "write /scan"),
    (
        "relay: {prefix: /a/b, topics: [{name: /a/bc}, {name: /a/b/c/d}]}",
        "1:54: relay.topics[1].name",
        "lies under relay.prefix /a/b, where relayed topics go; write /c/d",
    ),
    ("relay:\n  link_domain: 77\n", "2:16: relay.link_domain", "give relay.robot or relay.base"),
    ("relay: {robot: 10.0.0.1}", "1:16: relay.robot", "needs relay.link_domain"),
    ("relay: {link_domain: 77, robot: 10.0.0.1, base: 10.0.0.1}", "1:49: relay.base", "is relay.robot, too"),
    ("relay: {link_domain: 77, robot: 127.0.1.1, base: b}", "1:33: relay.robot", "127.0.1.1 is every computer's own"),
    ("relay: {link_domain: 77, base: localhost}", "1:32: relay.base", "localhost is every computer's own"),
    ("relay: {link_domain: 77, robot: a, base: localhost}", "1:42: relay.base", "write the address on the link"),
    ("relay: {link_domain: 77, robot: 10.0.0.256}", "1:33: relay.robot", "not an address"),
    ("relay: {link_domain: 77, robot: a..local}", "1:33: relay.robot", "'a..local' is not an address; write"),
    ("relay: {link_domain: 77, robot: 0.0.0.0}", "1:33: relay.robot", "'0.0.0.0' is not an address"),
    ("relay: {link_domain: 77, robot: 239.0.0.1}", "1:33: relay.robot", "'239.0.0.1' is not an address"),
    ("relay: {link_domain: 77, robot: 255.255.255.255}", "1:33: relay.robot", "'255.255.255.255' is not an address"),
    ("relay: {link_domain: 77, base: fd00::1}", "1:32: relay.base", "no IPv4 address, and arpd's link is IPv4"),
    (ENDS + "namespace: /_r1}", "1:47: relay.namespace", "never crosses the link"),
    (ENDS + "deny: /x}", "1:42: relay.deny", "is not a list"),
    (ENDS + "to_base: [/a, /b**]}", "1:50: relay.to_base[1]", "'/b**' is not an absolute ROS name or a pattern"),
    (
        f"relay: {{link_domain: 77, robot: a, deny: [/{'a' * 247}]}}",
        "1:43: relay.deny[0]",
        "248 characters long; ROS allows 247",
    ),
    # groups
    (ENDS + "groups: [{topics: [/a, /b, /right/**]}]}", "1:63: relay.groups[0].topics[2]", "is a pattern"),
    (ENDS + "groups: [{topics: [/left/image]}]}", "1:54: relay.groups[0].topics", "has too few items; give it 2"),
    (
        "relay:\n  link_domain: 77\n  robot: a\n  groups:\n  - topics: [/a, /b]\n  - topics: [/c, /a]\n",
        "6:18: relay.groups[1].topics[1]",
        "already given on line 5",
    ),
    (
        ENDS + "groups: [{name: /g, topics: [/a, /b]},\n{name: /g, topics: [/c, /d]}]}",
        "2:8: relay.groups[1].name",
        "already given on line 1",
    ),
    (
        ENDS + "groups: [{topics: [/a, /b]}], topics: [{name: /a, depth: 3},\n  {name: /b, depth: 3}]}\n",
        "2:10: relay.topics[1].name",
        "is in group /a",
    ),
    (
        ENDS + "groups: [{name: /g, topics: [/a, /b]}]}\ntopics:\n- name: /g\n- name: /a\n",
        "4:9: topics[1].name",
        "is in group /g",
    ),
    # YAML
    ("", "1:1: file", "is empty"),
    ("link: {}\n---\nhttp: {}\n", "2:1: yaml", "found another document"),
    ("link: [1\n", "2:1: yaml", "correct the YAML here"),
    ("a: b\nc: \x07", "2:4: yaml", "a character here is not allowed"),
    (b"link: {}\non_stop: \xff", "2:10: yaml", "is not UTF-8"),
    ("link:\n\theadroom: 0.5\n", "2:1: yaml", "indent with spaces, not with tabs"),
    ("link: &a {}\n", "1:7: yaml", "anchors, aliases and tags are not allowed"),
    ("#" * (2**19 + 1), "1:1: file", "larger than 512 KiB"),
    ('on_stop: "\\UFFFFFFFF"', "1:13: yaml", "a number out of range"),
]


@pytest.mark.parametrize(("text", "place", "words"), ONE_FAULT, ids=[place for _, place, _ in ONE_FAULT])
def test_each_fault_is_one_line_with_its_place_and_the_way_out(faults, text, place, words):
    """A fault names its place, what is wrong and what would be right."""
    (fault,) = faults(text)
    assert fault.startswith(f"{place}: ")
    assert words in fault


@pytest.mark.parametrize(
    ("text", "places"),
    [
        (
            """\
link: {interface: wlan9, headroom: much}
topics:
  - {name: /a, min_rate_hz: x}
  - {name: /a, bogus: 1}
  - {weight: 1}
""",
            ["1:36: link.headroom", "3:29: topics[0].min_rate_hz", "4:16: topics[1].bogus", "5:5: topics[2].name"],
        ),
        (
            """\
link: {interface: wlan9}
topics: [{name: /a, max_rate_hz: 0.1}, {name: /a}]
defaults: {min_depth: 5, max_depth: 2}
""",
            ["1:19: link.interface", "2:34: topics[0].max_rate_hz", "2:47: topics[1].name", "3:23: defaults.min_depth"],
        ),
    ],
)
def test_all_faults_are_reported_at_once_in_the_order_of_the_file(faults, text, places):
    """One run of `arpd check` shows every wrong key and value, and if there is none, every rule that is broken."""
    assert [": ".join(fault.split(": ")[:2]) for fault in faults(text)] == places


def test_deep_nesting_is_one_fault(faults):
    """PyYAML composes recursively."""
    (fault,) = faults("link: " + "[" * 50_000)
    assert "yaml: is nested too deeply" in fault


def test_a_fifo_is_read_as_a_file_and_holds_nobody_up(tmp_path):
    """A shell's `<(command)` is read to its end; without a writer the daemon would never reload again."""
    fifo = tmp_path / "arpd.yaml"
    os.mkfifo(fifo)
    with pytest.raises(ConfigError, match="is empty"):
        load_settings(fifo, interfaces=None)
    writer = Thread(target=fifo.write_text, args=("on_stop: keep\n",))
    writer.start()
    # What the shell names is open at both ends.
    with fifo.open("rb") as opened:
        assert load_settings(Path(f"/dev/fd/{opened.fileno()}"), interfaces=None).on_stop is OnStop.KEEP
    writer.join()


def test_the_policy_is_one_of_two(load):
    """The link is divided per topic unless the file says uniform; then no topic has preferences of its own."""
    assert load("program: {backend: closed_form}").program.policy is Policy.PER_TOPIC
    loaded = load("program: {policy: uniform}\ndefaults: {weight: 2}\ntopics: [{name: /a, weight: 9}]")
    assert loaded.program.policy is Policy.UNIFORM
    assert loaded.topic("/a") == loaded.topic("/b") == Preferences(weight=2.0)


def test_the_most_specific_entry_holds_for_a_topic(load):
    """A pattern sets weight, floor and cap of all it matches; the entry with the most characters besides stars wins."""
    settings = load("""
defaults: {max_depth: 7, min_rate_hz: 2}
topics:
  - {name: /camera/**, weight: 2, max_rate_hz: 5}
  - {name: /**, weight: 3}
  - {name: /camera/left/image, weight: 4, min_rate_hz: 1}
  - {name: /camera/*/image, weight: 5}
  - {name: /camera/*, weight: 6}
""")
    weights = {
        "/camera/left/image": 4,
        "/camera/right/image": 5,
        "/camera/right/info": 2,
        "/camera/info": 6,
        "/camera": 3,
        "/x/camera/info": 3,
    }
    assert {name: settings.topic(name).weight for name in weights} == weights
    info, own = settings.topic("/camera/right/info"), settings.topic("/camera/left/image")
    assert (info.max_rate_hz, info.max_depth, info.min_rate_hz, own.min_rate_hz) == (5.0, 7, None, 1.0)
    assert load("topics: [{name: /a/*, weight: 2}]").topic("/b") == Preferences()


@pytest.mark.parametrize(
    ("lines", "domain"),
    [
        ("", 0),
        ("ROS_DOMAIN_ID=7", 7),
        (" ROS_DOMAIN_ID = '77'", 77),
        ("ROS_DOMAIN_ID=010", 8),
        ("ROS_DOMAIN_ID=x", None),
    ],
)
def test_the_domain_of_the_units_is_read_as_systemd_and_rcl_do(monkeypatch, tmp_path, lines, domain):
    """With spaces, which an environment file may have, and by the bases of strtoul(3)."""
    monkeypatch.delenv("ROS_DOMAIN_ID", raising=False)
    monkeypatch.setattr(loading, "OF_UNITS", tmp_path / "default")
    (tmp_path / "default").write_text(f"# comment\n{lines}\n")
    assert loading.domain_of_units() == domain
