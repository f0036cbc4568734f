"""The paper's robot under arpd: what counts in the measured time, apart from the warm-up."""

from __future__ import annotations

import numpy as np
import pytest

from scripts.bench.paper_cells import (
    LIVE,
    LIVE_HZ,
    PAYLOADS_BYTES,
    SENSORS,
    Configuration,
    command_number,
    live_turns,
    quick_turns,
)
from scripts.bench.paper_summary import live_summary
from tests.unit.scripts.paper_files import PaperFiles

MS = 1_000_000
WARM, MEASURED = 20, 40  # samples that each source offers; pacing lets every second one leave
SPENT = {"process_cpu_s": 0.3, "cpu_s": 0.1, "core_wait_s": 0.01, "wall_s": 1.2, "publish_s": 0.1}


class Files(PaperFiles):
    """Files as the processes leave them: what leaves arrives after 2 ms, and every command after 5 ms."""

    def __init__(self, folder):
        super().__init__(folder)
        self.left = {index: [index + n * 10 * MS for n in range(WARM + MEASURED)] for index in range(SENSORS)}
        self.arrived = {
            index: [(n, at + 2 * MS) for n, at in enumerate(left) if n % 2 == 0] for index, left in self.left.items()
        }
        self.sent = dict.fromkeys(range(SENSORS), MEASURED // 2)
        self.actuated = [
            (command_number(index, number), self.left[index][number] + 5 * MS)
            for index in range(SENSORS)
            for number in (4, 44)
        ]
        self.commands_sent = len(self.actuated)
        self.spent = dict(SPENT)

    def summary(self):
        told = [
            {
                "sensors": [
                    {"index": i, "left": self.keep(f"left-{i}", left), "first": WARM, "sent": self.sent[i]}
                    for i, left in self.left.items()
                ],
                "spent": self.spent,
            }
        ]
        arrived = {
            "arrived": [self.pairs(f"arrived-{i}", pairs) for i, pairs in self.arrived.items()],
            "sent": self.commands_sent,
            "spent": SPENT,
        }
        cell = Configuration(depth=0, deadline_hz=MEASURED, payload_bytes=1000)
        return live_summary(cell, 1.0, told, arrived, self.pairs("actuated", self.actuated))


@pytest.fixture
def files(tmp_path):
    return Files(tmp_path)


def test_only_samples_of_the_measured_time_count(files):
    """Samples of the warm-up have no latency; the others have that of the sample a command answers."""
    files.arrived[0][0] = (0, 900 * MS)  # late, but in the warm-up
    run = files.summary()
    assert run["sensing"] == pytest.approx(
        {"count": 220, "lost_ratio": 0.0, **dict.fromkeys(("mean_s", "p50_s", "p95_s", "p99_s"), 0.002)}
    )
    assert run["end_to_end"] == pytest.approx(
        {"count": SENSORS, "lost_ratio": 0.0, **dict.fromkeys(("mean_s", "p50_s", "p95_s", "p99_s"), 0.005)}
    )
    assert (run["reached_ratio"], run["void"], run["lost"]) == (1.0, "", 0)


def test_what_pacing_withholds_is_not_lost(files):
    """Half of what the sources offer never leaves; that is withheld, and none of it is lost."""
    run = files.summary()
    assert (run["withheld_ratio"], run["lost"], run["published"]) == (0.5, 0, 220 + 22)


def test_what_leaves_and_does_not_arrive_is_lost(files):
    """A sample and a command that were sent and never came are lost; a sample of the warm-up is not."""
    files.arrived[3] = [pair for pair in files.arrived[3] if pair[0] not in {0, 30}]
    files.actuated.pop()
    run = files.summary()
    assert run["lost"] == 2
    assert run["sensing"]["lost_ratio"] == pytest.approx(1 / 220)
    assert run["end_to_end"]["lost_ratio"] == pytest.approx(1 / 22)


def test_a_source_that_cannot_keep_its_rate_is_void(files):
    """Too few samples in the measured time, from a busy process, make the turn void, however many there were before."""
    files.left = {index: left[: WARM + MEASURED // 2] for index, left in files.left.items()}
    files.arrived = {index: [pair for pair in pairs if pair[0] < 40] for index, pairs in files.arrived.items()}
    files.actuated = files.actuated[::2]
    files.spent = {**SPENT, "cpu_s": 0.6, "wall_s": 1.0}
    assert files.summary()["void"] == "generator"


def test_commands_name_their_sensor_and_their_sample():
    """Every pair of sensor and sample has a number of its own."""
    pairs = [(index, number) for index in range(SENSORS) for number in range(50)]
    codes = np.array([command_number(*pair) for pair in pairs])
    numbers, indices = np.divmod(codes, SENSORS)
    assert [*zip(indices.tolist(), numbers.tolist(), strict=True)] == pairs


def test_arpd_takes_a_turn_with_each_payload():
    """A round has one turn under arpd for each payload, and the quick form has the one that the link cannot carry."""
    assert [turn.configuration.payload_bytes for turn in live_turns()] == [*PAYLOADS_BYTES]
    (quick,) = (turn for turn in quick_turns() if turn.experiment == LIVE)
    assert LIVE_HZ * SENSORS * quick.configuration.payload_bytes > quick.link.rate_bytes_per_second
