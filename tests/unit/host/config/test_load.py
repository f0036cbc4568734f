"""The configuration file: its keys, and one clear line for each fault."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from hypothesis import HealthCheck, example, given
from hypothesis import strategies as st

from arpd.host.config.keys import SECTIONS, flatten, kinds_of, needs_restart, spelled
from arpd.host.config.load import load_settings
from arpd.model.endpoints import Overflow
from arpd.model.errors import ConfigError
from arpd.model.settings import (
    Backend,
    DefaultPreferences,
    GovernorSettings,
    GraphSettings,
    HttpSettings,
    LinkSettings,
    OnLost,
    OnStop,
    Policy,
    Preferences,
    ProgramSettings,
    RelaySettings,
    RelayTopic,
    Settings,
    TopicGroup,
    TopicSettings,
)
from tests.examples import examples

SHIPPED = Path(__file__).parents[4] / "etc" / "arpd" / "arpd.yaml"
FAULT = re.compile(
    r"(?P<file>.+?):(?P<line>[1-9]\d*):(?P<column>[1-9]\d*): (?P<key>[^ ].*?): (?P<wrong>.+); (?P<right>.+)"
)
FUZZ = examples(60, suppress_health_check=[HealthCheck.function_scoped_fixture])


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
link: {interface: wlan0, capacity: 8mbit, initial_capacity: 125kB/s, headroom: 0.5, packet_overhead: 100us}
program: {backend: closed_form, deadline_slack: 2, memory_budget: 1MiB, memory_reserve: 0B}
governor: {hold: 1s, dwell: 3s, debounce: 250ms}
http: {host: "::1", port: 9000}
graph: {sensing_topics: 11, actuation_topics: 1}
defaults: {weight: 2, min_rate_hz: 2, max_rate_hz: 20, min_depth: 2, max_depth: 50, latency_budget: none}
topics:
  - {name: /camera, max_rate_hz: source, latency_budget: 200ms, payload: measured, source_rate_hz: measured}
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
  groups: [{topics: [/left/image, /right/image]}, {name: /depth, topics: [/depth/image, /depth/info]}]
  prefix: /air
  topics: [{name: /camera, overflow: queue, depth: 20}, {name: /scan}]
on_stop: keep
on_lost: baseline
lost_after: 1min
"""
    shared = {"weight": 2.0, "max_rate_hz": 20.0, "min_depth": 2, "max_depth": 50, "latency_budget_s": None}
    assert load(text) == Settings(
        link=LinkSettings(
            interface="wlan0",
            capacity_bytes_per_second=1e6,
            initial_capacity_bytes_per_second=125e3,
            headroom=0.5,
            packet_overhead_s=1e-4,
        ),
        program=ProgramSettings(
            backend=Backend.CLOSED_FORM, deadline_slack=2.0, memory_budget_bytes=2.0**20, memory_reserve_bytes=0.0
        ),
        governor=GovernorSettings(hold_s=1.0, dwell_s=3.0, debounce_s=0.25),
        http=HttpSettings(host="::1", port=9000),
        graph=GraphSettings(sensing_topics=11, actuation_topics=1),
        defaults=DefaultPreferences(min_rate_hz=2.0, **shared),
        topics=(
            TopicSettings(name="/camera", **shared | {"max_rate_hz": None, "latency_budget_s": 0.2}),
            TopicSettings(
                name="/scan", min_rate_hz=3.0, payload_bytes=6000.0, source_rate_hz=12.5, **shared | {"weight": 4.0}
            ),
        ),
        relay=RelaySettings(
            topics=(RelayTopic(name="/camera", overflow=Overflow.QUEUE, depth=20), RelayTopic(name="/scan")),
            prefix="/air",
            link_domain=77,
            robot="robot1.local",
            base="10.0.0.2",
            namespace="/r1",
            to_base=("/camera/**", "/scan"),
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
        for key, kind in kinds_of(model).items():
            dotted = ".".join((*path, key))
            if path[-1:] in {("topics",), ("groups",)}:
                assert f"{key}:" in SHIPPED.read_text()
                if path == ("topics",) and key not in {"name", *kinds_of(SECTIONS["defaults",])}:
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
    ("link:\n  headroom: much\n", "2:13: link.headroom", "not a number; write 0.05..1"),
    ("http:\n  port: '9464'\n", "2:9: http.port", "not a whole number; write 0..65535"),
    ("http: {port: }", "1:13: http.port", "nothing is not a whole number"),
    ("http: {port: " + "9" * 5000 + "}", "1:14: http.port", "not a whole number"),
    ("defaults: {weight: .inf}", "1:20: defaults.weight", "inf is out of range; write 0.001..1000"),
    ("link: {headroom: 1.5}", "1:18: link.headroom", "1.5 is out of range; write 0.05..1"),
    ("http: {port: -1}", "1:14: http.port", "-1 is out of range; write 0..65535"),
    ("governor: {hold: 2}", "1:18: governor.hold", "2 has no unit"),
    ("link: {capacity: 5parsec}", "1:18: link.capacity", "'parsec' is not a unit"),
    ("link: {capacity: 1bit}", "1:18: link.capacity", "1bit is out of range; write 8kbit..100gbit"),
    ("topics: [{name: /a, payload: 0B}]", "1:30: topics[0].payload", "0B is out of range; write 1B..1GB"),
    ("on_stop: explode", "1:10: on_stop", "write restore or keep"),
    ("program: {policy: fair}", "1:19: program.policy", "write per_topic or uniform"),
    ('on_stop: "\\uD800"', "1:10: on_stop", "write restore or keep"),
    ("link:\n  interface: wlan9\n", "2:14: link.interface", "write auto or one of eth0, lo, wlan0"),
    # keys
    ("link:\n  headrom: 0.9\n", "2:3: link.headrom", "did you mean headroom?"),
    ("\nlinks: {}\n", "2:1: links", "did you mean link?"),
    ("port: 80\n", "1:1: port", "did you mean http.port?"),
    ("defaults: {payload: 1kB}", "1:12: defaults.payload", "did you mean topics.payload?"),
    ("governor: {deadband: 0.1}", "1:12: governor.deadband", "unknown key; known here: hold, dwell, debounce"),
    ("http: {zzz: 1}", "1:8: http.zzz", "host, port, web_config"),
    ("http: {1: 2}", "1:8: http.1", "unknown key"),
    ("http: {[a]: 2}", "1:8: yaml", "a list cannot be a key"),
    ("http:\n", "1:6: http", "has no value"),
    ("http: [1]", "1:7: http", "a list is not a mapping"),
    ("topics: {name: /a}", "1:9: topics", "a mapping is not a list"),
    ("on_stop: keep\nlink: {}\non_stop: keep\n", "3:1: on_stop", "already given on line 1"),
    # topics
    ("topics:\n  - name: /a\n  - name: /b\n  - name: /a\n", "4:11: topics[2].name", "already given on line 2"),
    ("topics:\n  - weight: 1\n", "2:5: topics[0].name", "is missing"),
    ("topics:\n  - name: camera/image\n", "2:11: topics[0].name", "write /camera/image"),
    (
        "topics:\n    - name: /a\n      max_rate_hz: 20.0\n      min_rate_hz: 50.0\n",
        "4:20: topics[0].min_rate_hz",
        "50 is above max_rate_hz 20; lower it or raise max_rate_hz",
    ),
    (
        "defaults: {max_rate_hz: 20}\ntopics:\n- {name: /a, min_rate_hz: 50}",
        "3:27: topics[0].min_rate_hz",
        "50 is above max_rate_hz 20",
    ),
    (
        "topics:\n- {name: /a, max_rate_hz: 0.5}",
        "2:27: topics[0].max_rate_hz",
        "0.5 is below min_rate_hz 1",
    ),
    ("defaults: {min_depth: 9, max_depth: 3}", "1:23: defaults.min_depth", "9 is above max_depth 3"),
    ("topics: [{name: /a/**, payload: 1kB}]", "1:33: topics[0].payload", "belongs to one topic; name it without stars"),
    ("topics: [{name: '/a**'}]", "1:17: topics[0].name", "not an absolute ROS name or a pattern of such"),
    # the relay
    ("relay: {topics: [{name: /link/scan}]}", "1:25: relay.topics[0].name", "write /scan"),
    (
        "relay: {prefix: /a/b, topics: [{name: /a/bc}, {name: /a/b/c/d}]}",
        "1:54: relay.topics[1].name",
        "lies under relay.prefix /a/b, where relayed topics go; write /c/d",
    ),
    ("relay: {topics: [{name: /link}]}", "1:25: relay.topics[0].name", "lies under relay.prefix"),
    (
        f"relay: {{topics: [{{name: /{'a' * 244}}}]}}",
        "1:25: relay.topics[0].name",
        "250 characters long; ROS allows 247",
    ),
    ("relay:\n  link_domain: 77\n", "2:16: relay.link_domain", "give relay.robot or relay.base"),
    ("relay: {robot: 10.0.0.1}", "1:16: relay.robot", "needs relay.link_domain"),
    ("relay:\n  groups:\n  - topics: [/a, /b]\n", "3:3: relay.groups", "needs relay.link_domain"),
    ("relay: {link_domain: 77, robot: 10.0.0.256}", "1:33: relay.robot", "not an address"),
    ("relay: {link_domain: 77, base: fd00::1}", "1:32: relay.base", "no IPv4 address, and arpd's link is IPv4"),
    (ENDS + "namespace: r1}", "1:47: relay.namespace", "write /r1"),
    (ENDS + "namespace: /arpd}", "1:47: relay.namespace", "never crosses the link"),
    (ENDS + "deny: /x}", "1:42: relay.deny", "'/x' is not a list"),
    (ENDS + "to_base: [/a, /b**]}", "1:50: relay.to_base[1]", "'/b**' is not an absolute ROS name or a pattern"),
    (ENDS + "services: [a/**]}", "1:47: relay.services[0]", "write /a/**"),
    (ENDS + "actions: [1]}", "1:46: relay.actions[0]", "1 is not an absolute ROS name"),
    (
        f"relay: {{link_domain: 77, robot: a, deny: [/{'a' * 247}]}}",
        "1:43: relay.deny[0]",
        "248 characters long; ROS allows 247",
    ),
    # groups
    (ENDS + "groups: [{topics: [/left/image, /right/**]}]}", "1:68: relay.groups[0].topics[1]", "is a pattern"),
    (ENDS + "groups: [{topics: [/left/image]}]}", "1:54: relay.groups[0].topics", "fewer than two topics"),
    (ENDS + "groups: [{topics: [/a, /b], by: time}]}", "1:64: relay.groups[0].by", "unknown key"),
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
        ENDS + "groups: [{topics: [/a, /b]},\n{name: /b, topics: [/c, /d]}]}",
        "2:8: relay.groups[1].name",
        "is a topic of the group on line 1",
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
    ("- a", "1:1: file", "is a list"),
    ("link: {}\n---\nhttp: {}\n", "2:1: yaml", "second YAML document"),
    ("link: [1\n", "2:1: yaml", "correct the YAML here"),
    ("a: b\nc: \x07", "2:4: yaml", "control character"),
    (b"link: {}\non_stop: \xff", "2:10: file", "byte 0xff is not UTF-8"),
    ("link: &a {}\n", "1:7: yaml", "anchors, aliases and tags are not allowed"),
    ("link: {}\nhttp: *a\n", "2:7: yaml", "anchors, aliases and tags are not allowed"),
    ("link: !!python/none x\n", "1:7: yaml", "anchors, aliases and tags are not allowed"),
    ("link: " + "[" * 50_000, "1:26: yaml", "more than 20 deep"),
    ("#" * (2**20 + 1), "1:1: file", "larger than 1 MiB"),
    ('on_stop: "\\UFFFFFFFF"', "1:13: yaml", "a number is out of range"),
]


@pytest.mark.parametrize(("text", "place", "words"), ONE_FAULT, ids=[place for _, place, _ in ONE_FAULT])
def test_each_fault_is_one_line_with_its_place_and_the_way_out(faults, text, place, words):
    """A fault names its place, what is wrong and what would be right."""
    (fault,) = faults(text)
    assert fault.startswith(f"{place}: ")
    assert words in fault


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
        ("missing.yaml", "No such file"),
        (".", "Is a directory"),
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


def test_the_link_domain_must_not_be_the_one_of_this_computers_nodes(tmp_path):
    """In the domain of the robot's nodes the two ends would see their own copies."""
    path = tmp_path / "arpd.yaml"
    path.write_text("relay: {link_domain: 7, base: 10.0.0.2}")
    with pytest.raises(ConfigError) as refused:
        load_settings(path, interfaces=None, local_domain=7)
    fault = "1:22: relay.link_domain: 7 is the domain of this computer's own nodes (ROS_DOMAIN_ID); choose another"
    assert refused.value.faults == [f"{path}:{fault}"]
    for other in (0, None):
        assert load_settings(path, interfaces=None, local_domain=other).relay.link_domain == 7


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
