"""The paper's experiment: the figures of a turn, void turns, and whether the optimum wins."""

import pytest

from scripts.bench.paper import report
from scripts.bench.paper_cells import (
    FIGURES,
    PAYLOADS_BYTES,
    RMAX_HZ,
    SENSORS,
    Configuration,
    configurations,
    figure_turns,
    loss_turns,
    optimum,
)
from scripts.bench.paper_summary import summary
from scripts.bench.paper_verdict import cells, nonsense, verdicts, voids
from scripts.bench.record import conditions
from tests.unit.scripts.paper_files import PaperFiles

MS = 1_000_000
SECONDS = 1.0
IDLE = {"process_cpu_s": 0.3, "cpu_s": 0.1, "core_wait_s": 0.01, "wall_s": 1.2, "publish_s": 0.1}


class Files(PaperFiles):
    """Files as the processes leave them: each sensor publishes at 22 Hz for a second, and two samples are answered."""

    def __init__(self, folder):
        super().__init__(folder)
        self.left = {index: [index + number * 45 * MS for number in range(22)] for index in range(SENSORS)}
        self.arrived = {index: [(n, at + 2 * MS) for n, at in enumerate(left)] for index, left in self.left.items()}
        self.commands = [n for n in range(22) for index in range(SENSORS) if n % SENSORS == index]
        self.actuated = [(n, self.left[n % SENSORS][n] + 5 * MS) for n in self.commands]
        self.spent = dict(IDLE)
        self.planner = dict(IDLE)

    def summary(self):
        told = [
            {
                "sensors": [{"index": i, "left": self.keep(f"left-{i}", left)} for i, left in self.left.items()],
                "spent": self.spent,
            }
        ]
        arrived = {
            "arrived": [self.pairs(f"arrived-{i}", pairs) for i, pairs in self.arrived.items()],
            "commands": self.keep("commands", self.commands),
            "spent": self.planner,
        }
        cell = Configuration(depth=10, deadline_hz=22, payload_bytes=100)
        return summary(cell, SECONDS, told, arrived, self.pairs("actuated", self.actuated))


@pytest.fixture
def files(tmp_path):
    return Files(tmp_path)


def test_latency_is_that_of_the_sample_that_was_answered(files):
    """Sensing ends at the planner, end to end at the robot; nothing is lost and every sensor is answered."""
    run = files.summary()
    assert run["sensing"] == pytest.approx(
        {"count": 242, "lost_ratio": 0.0, **dict.fromkeys(("mean_s", "p50_s", "p95_s", "p99_s"), 0.002)}
    )
    assert run["end_to_end"]["count"] == 22
    assert run["end_to_end"]["p99_s"] == pytest.approx(0.005)
    assert (run["published"], run["lost"], run["reached_ratio"], run["void"]) == (264, 0, 1.0, "")
    assert (run["sensors_cpu"], run["planner_cpu"]) == pytest.approx((0.3, 0.25))


def test_a_sample_that_does_not_arrive_is_lost_once(files):
    """A lost sample that was to be answered is missing on its topic, and its command was never sent."""
    files.arrived[3].pop(3)
    files.commands.remove(3)
    files.actuated = [pair for pair in files.actuated if pair[0] != 3]
    run = files.summary()
    assert (run["published"], run["lost"]) == (263, 1)
    assert run["sensing"]["lost_ratio"] == pytest.approx(1 / 242)
    assert run["end_to_end"]["lost_ratio"] == pytest.approx(1 / 22)


def test_a_lost_command_counts_on_the_way_back_only(files):
    """A command that never reaches the robot is lost, while sensing lost nothing."""
    files.actuated.pop()
    run = files.summary()
    assert (run["lost"], run["sensing"]["lost_ratio"]) == (1, 0.0)
    assert run["end_to_end"]["lost_ratio"] == pytest.approx(1 / 22)


def test_a_doubled_sample_counts_when_it_first_came(files):
    """A sample that arrives twice neither makes up for a lost one nor counts with its second arrival."""
    files.arrived[0].append((0, files.left[0][0] + 900 * MS))
    files.arrived[0].remove((1, files.left[0][1] + 2 * MS))
    run = files.summary()
    assert run["lost"] == 1
    assert run["sensing"]["p99_s"] == pytest.approx(0.002)


def test_nothing_at_all_gives_no_latency(files):
    """Where nothing arrived there is no latency, and everything is lost."""
    files.arrived = {index: [] for index in files.arrived}
    files.commands, files.actuated = [], []
    run = files.summary()
    assert (run["lost"], run["published"]) == (242, 242)
    assert run["end_to_end"]["p99_s"] is None
    assert run["end_to_end"]["lost_ratio"] == 1.0


@pytest.mark.parametrize(
    ("spent", "void"),
    [
        ({"cpu_s": 0.2, "core_wait_s": 0.1, "publish_s": 0.95, "wall_s": 1.0}, ""),  # slept in publish(): a full link
        ({"cpu_s": 0.6, "core_wait_s": 0.1, "publish_s": 0.95, "wall_s": 1.0}, "generator"),  # twice that is too much
        ({"cpu_s": 0.2, "core_wait_s": 0.5, "publish_s": 0.95, "wall_s": 1.0}, "generator"),  # others had the core
    ],
)
def test_half_the_rate_is_void_unless_publish_blocked(files, spent, void):
    """A sensor with half its rate had time for all of it if publish() slept, and had not if it was busy."""
    files.left = {index: left[:11] for index, left in files.left.items()}
    files.arrived = {index: pairs[:11] for index, pairs in files.arrived.items()}
    files.commands, files.actuated = files.commands[:11], files.actuated[:11]
    files.spent = {**IDLE, **spent}
    run = files.summary()
    assert (run["reached_ratio"], run["void"]) == (0.5, void)
    assert run["blocked_ratio"] == pytest.approx(0.95 - spent["cpu_s"] - spent["core_wait_s"])


def test_sensors_that_publish_nothing_are_void(files):
    """Without a single sample there is nothing to judge by."""
    files.left = {index: [] for index in files.left}
    files.arrived = {index: [] for index in files.arrived}
    files.commands, files.actuated = [], []
    assert files.summary()["void"] == "generator"


def test_a_planner_without_a_moment_left_makes_a_turn_void(files):
    """A busy planner adds a queue of its own to the link's."""
    files.planner = {**IDLE, "cpu_s": 0.9, "core_wait_s": 0.29}
    assert files.summary()["void"] == "planner"


def test_the_configurations_are_the_papers():
    """Table 2's optima, and with DEPTH 1 and 5000 at both rates 24 configurations for each payload and link."""
    assert [optimum(hz) for hz in RMAX_HZ] == [(7, 365), (15, 390), (40, 405), (82, 410)]
    assert len(set(configurations(10))) == 24
    assert {(1, 7), (5000, 1000), (410, 1000), (410, 82)} <= {(c.depth, c.deadline_hz) for c in configurations(10)}
    assert len(figure_turns()) == 2 * 3 * 24
    assert {turn.loss for turn in loss_turns()} == {0.0, 0.0001, 0.001, 0.01}


def made_up(turn, number, p99_s, lost):
    """Return a turn as `paper.py` writes it."""
    figures = {"mean_s": p99_s / 3, "p50_s": p99_s / 4, "p95_s": p99_s / 2, "p99_s": p99_s}
    cell = turn.configuration
    return {
        "experiment": turn.experiment,
        "link": turn.link.name,
        "link_loss": turn.loss,
        "heartbeat": turn.heartbeat,
        "round": number,
        "load": 0.5,
        "depth": cell.depth,
        "deadline_hz": cell.deadline_hz,
        "payload_bytes": cell.payload_bytes,
        "reached_ratio": 1.0,
        "blocked_ratio": 0.0,
        "void": "",
        "published": 10_000,
        "lost": lost,
        "sensing": {"count": 1000, "lost_ratio": lost / 10_000, **figures},
        "end_to_end": {"count": 100, "lost_ratio": lost / 10_000, **figures},
        "used_ratio": 1.0 if cell.deadline_hz >= 100 else 0.3,
        "robot_sent_bytes": 10**7,
        "receive_buffer_overflows": 0,
    }


@pytest.fixture
def document():
    """Two rounds in which the optimum is as published: quick where DEPTH 5000 queues, and whole where DEPTH 1 loses."""
    runs = []
    for number in (1, 2):
        for turn in [*figure_turns(), *loss_turns()]:
            cell = turn.configuration
            is_full = cell.deadline_hz >= 100
            p99_s = (2.0 if cell.depth == 5000 else 0.02) if is_full else 0.004
            lost = 5000 if is_full and cell.depth == 1 else 0
            runs.append(made_up(turn, number, p99_s + number * 1e-4, lost))
    return {
        "conditions": {**conditions(), "seconds": 3.0},
        "links": [
            {"name": "2.4 GHz", "rate_bytes_per_second": 1e6, "queue_bytes": 256_000, "loss": 0.0002},
            {"name": "wired", "rate_bytes_per_second": 1.25e8, "queue_bytes": 1_000_000, "loss": 0.0},
        ],
        "optima": [
            dict(zip(("rmax_hz", "rate_hz", "depth"), (hz, *optimum(hz)), strict=True)) for hz in RMAX_HZ
        ],
        "runs": runs,
    }  # fmt: skip


def of(document, link, payload_bytes, deadline_hz, depth):
    """Return the rounds of one configuration."""
    named = {"link": link, "payload_bytes": payload_bytes, "deadline_hz": deadline_hz, "depth": depth}
    found = [run for run in document["runs"] if run["experiment"] == FIGURES and named.items() <= run.items()]
    assert len(found) == 2
    return found


def set_p99(runs, *values_s):
    for run, value_s in zip(runs, values_s, strict=True):
        run["end_to_end"]["p99_s"] = value_s


def missed(document):
    """Return every verdict with a miss, and how many configurations are quicker or lose less."""
    return {
        (v.optimum.link, v.optimum.name, v.rmax_hz): (len(v.slower_than), len(v.lossier_than))
        for v in verdicts(document)
        if v.slower_than or v.lossier_than
    }


def test_what_the_paper_says_is_found_to_hold(document):
    """Every optimum is below all that lose nothing and loses no more than its like; a quicker one is found."""
    assert len(verdicts(document)) == 2 * len(PAYLOADS_BYTES) * len(RMAX_HZ)
    assert missed(document) == {}
    assert nonsense(document) == voids(document) == []
    set_p99(of(document, "wired", 100, 100, 5000), 0.003, 0.003)
    assert {(link, name.split()[0]) for link, name, _ in missed(document)} == {("wired", "100")}


def test_a_part_of_the_configurations_has_a_report(document):
    """The short form has no fixed configuration at some Rmax."""
    document["runs"] = [run for run in document["runs"] if run["depth"] not in {1, 5000}]
    assert "| wired | 12 of 12 | 12 of 12 |" in report(document)


def test_loss_is_compared_with_a_like_latency_only(document):
    """A configuration that is slower by more than a factor of two may lose less."""
    for run in of(document, "wired", 10, 7, 365):
        run["lost"] = 1
    assert missed(document) == {}
    set_p99(of(document, "wired", 10, 100, 5000), 0.008, 0.008)
    assert missed(document) == {("wired", "10 B (7 Hz, 365)", 100): (0, 1)}


def test_an_optimum_that_never_answers_is_not_below_any(document):
    """No latency is the worst latency."""
    set_p99(of(document, "wired", 10, 7, 365), None, None)
    verdict = next(v for v in verdicts(document) if v.optimum.link == "wired")
    assert {cell.deadline_hz for cell in verdict.slower_than} == {100, 200, 500, 1000}


def test_a_void_cell_has_no_figures_and_no_verdict(document):
    """It is neither an optimum nor a rival, and a void round beside a good one is left out; reports show all that."""
    for run in of(document, "wired", 10, 82, 410):
        run["void"] = "generator"
    rival = of(document, "wired", 10, 1000, 5000)
    set_p99(rival, 0.0, 0.0)
    for run in rival:
        run["void"] = "planner"
    of(document, "wired", 100, 82, 410)[0].update(void="generator", lost=5000)
    found = {(c.link, c.name): c for c in cells(document, FIGURES)}
    assert found["wired", "10 B (82 Hz, 410)"].why_void == "void: generator"
    assert found["wired", "100 B (82 Hz, 410)"].lost == 0
    assert set(missed(document)) <= {("wired", "10 B (82 Hz, 410)", 1000)}
    assert len(voids(document)) == 5
    assert "void: planner" in report(document)
    assert "| wired | 11 of 11 | 11 of 11 |" in report(document)


@pytest.mark.parametrize(
    ("fault", "said"),
    [
        ({"failed": "planner ended with code 1"}, "planner ended with code 1"),
        ({"sensing": {"count": 0, "p99_s": None}}, "nothing arrived"),
        ({"end_to_end": {"count": 0, "p99_s": None}}, "nothing was answered"),
        ({"robot_sent_bytes": 50_000}, "bypassed"),
        ({"used_ratio": float("nan")}, "not a number"),
        ({"end_to_end": {"count": 9, "p99_s": float("inf")}}, "not a number"),
    ],
)
def test_nonsense_is_found(document, fault, said):
    """A turn that failed, gave nothing, went past the link or is not a number makes the document worthless."""
    document["runs"][70].update(payload_bytes=100, **fault)
    (found,) = nonsense(document)
    assert said in found


def test_nothing_may_be_answered_where_nearly_all_is_lost(document):
    """A flooded DEPTH 1 may lose every sample that was to be answered."""
    document["runs"][70].update(sensing={"count": 9, "lost_ratio": 0.99}, end_to_end={"count": 0, "p99_s": None})
    assert nonsense(document) == []


def test_no_turn_at_all_is_nonsense(document):
    """An empty document has one fault."""
    assert nonsense({**document, "runs": []}) == ["no turn came to its end"]
