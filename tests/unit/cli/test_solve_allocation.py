"""`arpd solve --config`: the daemon's plan, offline."""

from __future__ import annotations

import json
import re
import struct
import subprocess
import sys
from functools import partial
from itertools import pairwise
from pathlib import Path

import pytest

from arpd.adapters.config.load import load_settings
from arpd.govern.what_if import spread
from arpd.report.status import status_document

REPO = Path(__file__).parents[3]
ROBOT = REPO / "scripts" / "robot" / "arpd.yaml"
MBIT = 125_000.0  # bytes
SMALL = """\
program: {backend: exact}
topics:
  - {name: /scan, payload: 6kB, source_rate_hz: 20}
  - {name: /camera, payload: 30kB, source_rate_hz: 30, weight: 2, min_rate_hz: 2, max_rate_hz: 15}
  - {name: /cmd_vel, payload: 76B, source_rate_hz: 20, weight: 10, min_rate_hz: 20}
"""
YIELDING = {"/link/scan/front", "/link/scan/rear", "/link/points", "/link/camera/image/compressed"}


@pytest.fixture
def solve(run):
    """Run ``arpd solve``."""
    return partial(run, "solve")


@pytest.fixture
def allocation(solve):
    """Run ``arpd solve --json`` and return its document, topics by name."""

    def allocation(*arguments):
        code, out, _ = solve(*arguments, "--json")
        assert code == 0
        document = json.loads(out)
        return document, {row["topic"]: row for row in document["topics"]}

    return allocation


@pytest.fixture
def status(tmp_path):
    """Save a status document, as ``arpd status --json > robot.json`` does."""

    def status(*rows, **document):
        path = tmp_path / "robot.json"
        path.write_text(json.dumps({"api_version": "v1", "topics": list(rows), **document}))
        return path

    return status


def measured(topic="/scan", **fields):
    return {
        "topic": topic,
        "node": "/driver",
        "direction": "sensing",
        "payload_bytes": 6000.0,
        "source_rate_hz": 20.0,
        "remote_readers": 1,
        "requested_deadline_ns": None,
        **fields,
    }


def test_the_table_says_what_each_topic_gets_and_what_holds_it_back(solve, config):
    """Each row has desired rate, rate, DEADLINE, DEPTH and what binds them; the last row is the total."""
    assert solve("--config", config(), "--capacity", "2mbit") == (
        0,
        """\
link     2 Mbit/s, of which 85 % may be planned for 3 topics
program  optimal, bound by link, solved by exact
memory   455 KiB of 64 MiB when every history is full

                  payload  Rmax floor desired  rate  rate link DEADLINE DEPTH  bound by
topic      weight       B    Hz    Hz      Hz    Hz     %    %       ms        rate      depth
/camera         2   30000 7.146     2      15 3.826  25.5 53.5      375     8  link      latency
/cmd_vel       10      76 426.6    20      20    20 100.0  4.7    93.75    16  desired   latency
/scan           1    6000 34.41     1      20 9.211  46.1 26.8    187.5    16  link      latency
total of 3                                 55 33.04       85.0             40
""",
        "",
    )


def test_the_sweep_says_how_the_rates_move(solve, config):
    """Each capacity has a column with marks for desired rate and floor; sentences say what gave way."""
    assert solve("--config", config(), "--sweep", "50kbit:50mbit", "--points", 4) == (
        0,
        """\
link     50 kbit/s to 50 Mbit/s, of which 85 % may be planned for 3 topics

                    floor desired   rate (Hz) at a capacity (bit/s) of
topic        weight    Hz      Hz    50k    500k      5M     50M
/camera           2     2      15  paused   1.18!   10.7      15=
/cmd_vel         10    20      20   9.07!     20=     20=     20=
/scan             1     1      20  paused  paused     20=     20=
link used, %                        85.0    85.0    85.0    10.9
bound by                             link    link    link desired
degraded                             yes     yes       -       -

= has all it desires    _ at its floor    ! below its floor    paused: no rate

what gave way
  50k   rate floor of weight 1 given up; rate floor of weight 2 given up; rate floor of weight 10 cut to 45%
  500k  rate floor of weight 1 given up; rate floor of weight 2 cut to 59%
""",
        "",
    )


def test_a_link_that_carries_nothing_pauses_everything(solve, config):
    """Capacity 0 is an answer, not an error."""
    code, out, err = solve("--config", config(), "--capacity", "0mbit")
    assert (code, err) == (0, "")
    assert "gave way: the link has no capacity: every topic is paused" in out
    assert out.count(" paused ") == 3
    assert out.count(" none ") == 3


def test_json_is_in_base_units(allocation, config):
    """Every key names its unit; the DEADLINE is the one that a publisher offers, slack included."""
    document, topics = allocation("--config", config(), "--capacity", "2mbit")
    assert document["capacity_bytes_per_second"] == 2 * MBIT
    assert document["level_bytes_per_second"] == pytest.approx(0.85 * 2 * MBIT)
    assert (document["status"], document["binding"], document["backend"]) == ("optimal", "link", "exact")
    assert document["share"] == pytest.approx(0.85)
    assert (document["memory_budget_bytes"], document["left_out"]) == (64 * 2**20, [])
    assert list(topics) == ["/camera", "/cmd_vel", "/scan"]
    assert topics["/cmd_vel"] == {
        "topic": "/cmd_vel",
        "weight": 10.0,
        "payload_bytes": 76.0,
        "source_rate_hz": 20.0,
        "copies": 1,
        "wire_bytes": 586.0,
        "max_rate_hz": pytest.approx(2 * MBIT / 586.0),
        "min_rate_hz": 20.0,
        "desired_rate_hz": 20.0,
        "rate_hz": 20.0,
        "optimal_rate_hz": 20.0,
        "share": pytest.approx(20.0 * 586.0 / (2 * MBIT)),
        "deadline_ns": 93_750_000,
        "depth": 16,
        "optimal_depth": pytest.approx(19.0),
        "rate_binding": "desired_rate",
        "depth_binding": "latency_budget",
    }
    assert topics["/camera"]["desired_rate_hz"] == 15.0
    _, topics = allocation("--config", config(), "--capacity", "0bit")
    assert topics["/cmd_vel"]["rate_hz"] == 0.0
    assert topics["/cmd_vel"]["deadline_ns"] is None


def test_a_sweeps_json_is_a_list_of_allocations(solve, config):
    """Each capacity has one, and both ends are exact."""
    code, out, _ = solve("--config", config(), "--sweep", "0.5mbit:54mbit", "--json")
    documents = json.loads(out)
    assert code == 0
    assert len(documents) == 8
    assert documents[0]["capacity_bytes_per_second"] == 0.5 * MBIT
    assert documents[-1]["capacity_bytes_per_second"] == 54 * MBIT
    shares = [document["share"] for document in documents]
    assert all(share <= 0.85 + 1e-9 for share in shares)


def test_a_sweep_has_equal_ratios_and_exact_ends():
    """A logarithmic axis gets evenly spaced points."""
    points = spread(0.1, 100.0, 4)
    assert (points[0], points[-1]) == (0.1, 100.0)
    assert [b / a for a, b in pairwise(points)] == pytest.approx([10.0] * 3)
    assert spread(1.0, 3.0, 2) == (1.0, 3.0)


@pytest.mark.parametrize("asked", [("--capacity", "5mbit"), ("--sweep", "10kbit:1gbit", "--points", "20")])
def test_tables_fit_a_line_of_120_columns(solve, config, asked):
    """Long names keep their ends, and capacities that do not fit go below."""
    long = "".join(
        f"  - {{name: /robot/{'very/' * 20}long/camera_{i}, payload: 123456B, source_rate_hz: 1234.5, weight: 12.75}}\n"
        for i in range(2)
    )
    for path in (ROBOT, config(f"topics:\n{long}")):
        code, out, _ = solve("--config", path, *asked)
        assert code == 0
        assert max(map(len, out.splitlines())) <= 120
    assert "long/camera_0 " in out
    assert "…" in out


def test_the_back_end_is_the_files_unless_the_option_says_another(allocation, config):
    """Without the option it is the daemon's back end."""
    path = config()
    assert allocation("--config", path, "--capacity", "2mbit")[0]["backend"] == "exact"
    assert allocation("--config", path, "--capacity", "2mbit", "--backend", "osqp")[0]["backend"] == "osqp"


def test_headroom_and_overhead_are_the_files(allocation, config):
    """The program is the daemon's."""
    path = config(f"link: {{headroom: 0.5, packet_overhead: 1ms}}\n{SMALL}")
    document, topics = allocation("--config", path, "--capacity", "2mbit")
    assert document["share"] == pytest.approx(0.5)
    assert topics["/cmd_vel"]["max_rate_hz"] == pytest.approx(1.0 / (586.0 / (2 * MBIT) + 3 * 0.001))


def test_topics_of_which_nothing_is_known_are_left_out_and_named(solve, config):
    """These are entries without both keys and relayed topics without an entry; the note goes to stderr."""
    path = config(f"{SMALL}  - {{name: /odd, payload: 1kB}}\nrelay: {{topics: [{{name: /gps}}]}}\n")
    code, out, err = solve("--config", path, "--capacity", "2mbit")
    assert code == 0
    assert "for 3 topics" in out
    assert err == (
        f"arpd: left out: /link/gps, /odd; {path} does not say both their payload and their source_rate_hz "
        "(or measure them: --status)\n"
    )
    assert json.loads(solve("--config", path, "--capacity", "2mbit", "--json")[1])["left_out"] == ["/link/gps", "/odd"]


def test_a_saved_status_says_what_topics_publish(allocation, config, status):
    """A measurement replaces an assumption; desired rates stay the configuration's."""
    path = status(
        measured("/scan", payload_bytes=500.0, source_rate_hz=40.0),
        measured("/scan", node="/other", payload_bytes=400.0, remote_readers=2),
        measured("/new", direction="actuation"),
    )
    document, topics = allocation("--config", config(), "--status", path, "--capacity", "54mbit")
    assert list(topics) == ["/camera", "/cmd_vel", "/new", "/scan"]
    assert (topics["/scan"]["payload_bytes"], topics["/scan"]["source_rate_hz"], topics["/scan"]["copies"]) == (
        500.0,
        40.0,
        3,
    )
    assert topics["/camera"]["payload_bytes"] == 30_000.0
    assert topics["/new"]["weight"] == 1.0
    assert document["left_out"] == []


def test_topics_of_two_ends_have_no_prefix(solve, config):
    """A relay with two ends carries a topic under its own name."""
    path = config(
        "relay: {link_domain: 77, ceddp: a, topics: [{name: /gps}, {name: /scan}]}\n"
        "topics: [{name: /scan, payload: 6kB, source_rate_hz: 10}]"
    )
    assert json.loads(solve("--config", path, "--capacity", "2mbit", "--json")[1])["left_out"] == ["/gps"]


def test_what_the_status_cannot_say_is_assumed_or_left_out(solve, config, status):
    """A topic without a reader across the link, or without a message so far, has no measurement."""
    path = status(
        measured("/scan", direction="local"),
        measured("/quiet", payload_bytes=0.0),
        measured("/here", direction="local"),
    )
    code, out, err = solve("--config", config(), "--status", path, "--capacity", "5mbit", "--json")
    assert code == 0
    assert {row["topic"] for row in json.loads(out)["topics"]} == {"/camera", "/cmd_vel", "/scan"}
    assert err.startswith(f"arpd: left out: /here, /quiet; {path} has no traffic of these topics across the link, and ")


def test_the_deadline_is_no_longer_than_a_reader_requests(allocation, config, status):
    """A longer offer would lose the reader."""
    path = status(measured("/scan", requested_deadline_ns=30_000_000))
    _, topics = allocation("--config", config(), "--status", path, "--capacity", "5mbit")
    assert topics["/scan"]["deadline_ns"] == 30_000_000


def test_a_real_status_document_is_understood(allocation, config, tmp_path, sample_snapshot):
    """The command reads what the daemon serves."""
    path = tmp_path / "robot.json"
    path.write_text(json.dumps(status_document(sample_snapshot)))
    _, topics = allocation("--config", config("{}"), "--status", path, "--capacity", "5mbit")
    crossing = {p.topic for p in sample_snapshot.observation.publishers if p.direction != "local"}
    assert set(topics) == {p.topic for p in sample_snapshot.observation.publishers if p.topic in crossing}


@pytest.mark.parametrize(
    ("text", "wrong"),
    [
        ("", "is empty"),
        ("<html>", "is not JSON"),
        ("\udcff", "is not JSON"),
        ("[" * 100_000, "is not JSON"),
        ("[]", "is not a status of arpd"),
        ('{"topics": []}', "is not a status of arpd"),
        ('{"api_version": "v1", "ready": false}', "was saved before the daemon was ready"),
        ('{"api_version": "v1", "topics": {}}', "topics: is not a list"),
        ('{"api_version": "v1", "topics": [1]}', "topics[0]: is not a publisher"),
        (json.dumps({"api_version": "v1", "topics": [measured(), {}]}), "topics[1].direction: null is not text"),
        (
            json.dumps({"api_version": "v1", "topics": [measured(direction="up")]}),
            'topics[0].direction: "up" is none of',
        ),
        (
            json.dumps({"api_version": "v1", "topics": [measured(payload_bytes="1\x1bkB")]}),
            'topics[0].payload_bytes: "1\\u001bkB" is not a number',
        ),
        (
            json.dumps({"api_version": "v1", "topics": [measured(source_rate_hz=float("nan"))]}),
            "topics[0].source_rate_hz: NaN is not a number",
        ),
        (
            json.dumps({"api_version": "v1", "topics": [measured(remote_readers=True)]}),
            "topics[0].remote_readers: true is not a number",
        ),
    ],
    ids=range(14),
)
def test_a_file_that_is_no_status_exits_1_and_says_how_to_save_one(solve, config, tmp_path, text, wrong):
    """The error names the file, the place in it, and the command."""
    path = tmp_path / "robot.json"
    path.write_text(text, errors="surrogateescape")
    code, out, err = solve("--config", config(), "--status", path, "--capacity", "5mbit")
    assert (code, out) == (1, "")
    assert err.startswith(f"arpd: {path}: {wrong}")
    assert err.endswith(f"; save it on the robot with arpd status --json > {path}\n")


def test_a_status_file_that_cannot_be_read_exits_2(solve, config, tmp_path):
    """The error has the file and the reason."""
    for path in (tmp_path / "nosuch.json", tmp_path):
        code, out, err = solve("--config", config(), "--status", path, "--capacity", "5mbit")
        assert (code, out) == (2, "")
        assert err.startswith(f"arpd: --status {path} cannot be read (")
        assert "save it with arpd status --json" in err


def test_without_any_topic_it_teaches_what_to_write(solve, config, status):
    """It exits 78 with the file, an example that loads, and the other way."""
    path = config("topics: [{name: /a, payload: 1kB}]")
    code, out, err = solve("--config", path, "--capacity", "5mbit")
    assert (code, out) == (78, "")
    assert err.startswith(f"{path}:1:1: topics: no topic has a payload and a source_rate_hz; write `topics: ")
    assert "arpd status --json > robot.json" in err
    (example,) = re.findall("`(.*)`", err)
    assert solve("--config", config(example), "--capacity", "5mbit")[0] == 0
    path = config("{}")
    code, _, err = solve("--config", path, "--status", status(measured(direction="local")), "--capacity", "5mbit")
    assert code == 78
    assert "robot.json has none that publishes across the link" in err


def test_a_faulty_configuration_exits_78_as_everywhere(solve, config):
    """The fault has file, line and column."""
    path = config("topics:\n  - {name: /a, payload: 30}\n")
    expected = f"{path}:2:25: topics[0].payload: 30 has no unit; write a size like 64MiB\n"
    assert solve("--config", path, "--capacity", "5mbit") == (78, "", expected)


BAD_USAGE = {
    "nothing": ([], "nothing to solve; give --rmax, --sensing and --actuation"),
    "both programs": (["--rmax", "100", "--config", "x"], "--rmax and --config do not go together; give "),
    "mixed": (["--dmin", "2", "--capacity", "5mbit"], "--dmin and --capacity do not go together"),
    "half the paper": (["--rmax", "100"], "the paper's program needs --sensing and --actuation, too; give "),
    "no config": (["--capacity", "5mbit"], "--capacity needs --config FILE"),
    "only status": (["--status", "x"], "--status needs --config FILE"),
    "no capacity": (["--config", "x"], "--config needs one of --capacity RATE (5mbit) and --sweep"),
    "both": (["--config", "x", "--capacity", "5mbit", "--sweep", "1mbit:2mbit"], "--config needs one of --capacity"),
    "bare number": (["--config", "x", "--capacity", "5"], "--capacity: '5' has no unit; write a rate like 20mbit"),
    "too fast": (["--config", "x", "--capacity", "1e9gbit"], "--capacity: '1e9gbit' is out of range; write at most"),
    "no range": (["--config", "x", "--sweep", "5mbit"], "--sweep '5mbit' is not LOW:HIGH; write it like"),
    "falling": (["--config", "x", "--sweep", "5mbit:1mbit"], "--sweep '5mbit:1mbit' does not rise from above 0"),
    "from zero": (["--config", "x", "--sweep", "0bit:1mbit"], "--sweep '0bit:1mbit' does not rise from above 0"),
    "bad end": (["--config", "x", "--sweep", "1mbit:fast"], "--sweep: 'fast' is not a rate"),
    "one point": (["--config", "x", "--sweep", "1mbit:2mbit", "--points", "1"], "--points 1 is not 2..1000"),
    "points": (["--config", "x", "--capacity", "1mbit", "--points", "5"], "--points belongs to --sweep; write --sweep"),
    "plot": (["--config", "x", "--capacity", "1mbit", "--plot", "x.png"], "--plot belongs to --sweep; write --sweep"),
    "no PNG": (["--config", "x", "--sweep", "1mbit:2mbit", "--plot", "x.pdf"], "--plot x.pdf is not a PNG; write"),
}


@pytest.mark.parametrize(("arguments", "message"), BAD_USAGE.values(), ids=BAD_USAGE)
def test_what_does_not_fit_together_exits_2_with_what_would(solve, arguments, message):
    """The command line is checked before any file is read."""
    code, out, err = solve(*arguments)
    assert (code, out) == (2, "")
    assert err.startswith(f"arpd: {message}")
    assert err.count("\n") == 1


def test_a_back_end_that_is_not_installed_exits_2(solve, config, monkeypatch):
    """The option and the file have the same error."""
    monkeypatch.setitem(sys.modules, "arpd.solve.cvxpy_", None)
    code, _, err = solve("--config", config(SMALL.replace("exact", "cvxpy")), "--capacity", "5mbit")
    assert code == 2
    assert err.startswith("arpd: back end cvxpy is not installed here")


def test_solving_offline_needs_neither_ros_nor_matplotlib(config):
    """It starts fast and works on any computer."""
    script = (
        "import sys; from arpd.cli.main import main; main(); "
        "print(sorted({'rclpy', 'osqp', 'cvxpy', 'matplotlib', 'psutil'} & set(sys.modules)))"
    )
    ran = subprocess.run(
        [sys.executable, "-c", script, "solve", "--config", config(), "--capacity", "5mbit"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert ran.stdout.splitlines()[-1] == "[]"


def png_size(path):
    """Width and height of a PNG (pixels)."""
    head = path.read_bytes()[:24]
    assert head[:8] == b"\x89PNG\r\n\x1a\n"
    return struct.unpack(">II", head[16:24])


def test_the_plot_is_a_picture_of_the_sweep(solve, tmp_path):
    """It is a PNG, drawn without a display, and the table is printed."""
    pytest.importorskip("matplotlib")
    path = tmp_path / "sweep.png"
    code, out, err = solve("--config", ROBOT, "--sweep", "0.5mbit:54mbit", "--points", 3, "--plot", path)
    assert (code, err) == (0, "")
    assert out == solve("--config", ROBOT, "--sweep", "0.5mbit:54mbit", "--points", 3)[1]
    width, height = png_size(path)
    assert width >= 1200
    assert height >= 900
    assert path.stat().st_size > 30_000


def test_the_plot_grows_with_the_topics_and_takes_any_name(solve, config, status, tmp_path):
    """Names of many topics stay apart; silent topics and names like formulas do no harm."""
    pytest.importorskip("matplotlib")
    rows = [measured(f"/t{i}", source_rate_hz=float(i)) for i in range(60)]
    robot = status(*rows, measured("/$x_{$", source_rate_hz=0.0))
    path = tmp_path / "SWEEP.PNG"
    arguments = ("--config", config("defaults: {min_rate_hz: 0}"), "--status", robot, "--sweep", "1mbit:2mbit")
    code, _, err = solve(*arguments, "--plot", path)
    assert (code, err) == (0, "")
    assert png_size(path)[1] > 2000


def test_a_plot_that_cannot_be_written_exits_1(solve, config, tmp_path):
    """The error has the file and the reason."""
    pytest.importorskip("matplotlib")
    path = tmp_path / "nosuch" / "x.png"
    code, _, err = solve("--config", config(), "--sweep", "1mbit:2mbit", "--plot", path)
    assert (code, err) == (1, f"arpd: --plot {path} cannot be written (No such file or directory); name another file\n")


def test_a_missing_matplotlib_is_named_with_its_remedy(solve, config, monkeypatch, tmp_path):
    """The error comes before any computation."""
    monkeypatch.setitem(sys.modules, "arpd.cli.sweep_plot", None)
    code, out, err = solve("--config", config(), "--sweep", "1mbit:2mbit", "--plot", tmp_path / "x.png")
    assert (code, out) == (1, "")
    assert err.startswith("arpd: --plot needs matplotlib (")
    assert "pip install 'arpd[plot]'" in err


def test_at_5_mbit_only_the_large_topics_of_the_demo_robot_yield(allocation):
    """Lidars, point cloud and camera yield; small topics keep their desired rates."""
    document, topics = allocation("--config", ROBOT, "--capacity", "5mbit")
    assert len(topics) == 12
    assert (document["status"], document["left_out"]) == ("optimal", [])
    assert {name for name, row in topics.items() if row["rate_binding"] != "desired_rate"} == YIELDING


def test_at_half_a_megabit_the_demo_robot_keeps_commands_imu_and_odometry(allocation):
    """Their floors hold to the nanosecond of a period; all others keep the same small part of theirs."""
    document, topics = allocation("--config", ROBOT, "--capacity", "0.5mbit")
    kept = {name: row["rate_hz"] / row["min_rate_hz"] for name, row in topics.items()}
    heavy = {"/cmd_vel", "/link/imu", "/link/odom"}
    assert {name: kept[name] for name in heavy} == dict.fromkeys(heavy, pytest.approx(1.0, abs=1e-7))
    assert len({round(part, 6) for name, part in kept.items() if name not in heavy}) == 1
    assert document["status"] == "degraded"
    assert document["degradation"].startswith("rate floor of weight 1 cut to")


def test_the_demo_robots_payloads_are_those_its_nodes_publish():
    """The configuration has the sizes that rclpy serializes, frame_id included."""
    pytest.importorskip("rclpy")
    from geometry_msgs.msg import TwistStamped
    from rclpy.serialization import serialize_message

    from arpd.adapters.sim.demo import COMMAND_TOPIC
    from scripts.robot.sensors import COMMAND_RATE_HZ, SENSORS

    assumed = {
        name: (wishes.payload_bytes, wishes.source_rate_hz)
        for name, wishes in load_settings(ROBOT, interfaces=None).topics.items()
    }
    command = TwistStamped()
    command.header.frame_id = "base#999"
    published = {COMMAND_TOPIC: (len(serialize_message(command)), COMMAND_RATE_HZ)}
    for topic, (rate_hz, make) in SENSORS.items():
        message = make()
        message.header.frame_id = f"{topic.strip('/').replace('/', '_')}#999"
        published[f"/link{topic}"] = (len(serialize_message(message)), rate_hz)
    assert assumed == published
