"""scripts/bench/traces.py: a folder of recorded links becomes a table and dots."""

import pytest

from scripts.bench.report import draw
from scripts.bench.traces import SIDES, measured, recordings, summary

CSV = "time_s,rate_bit_per_s\n0,8e6\n15,2e6\n"


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "a.csv").write_text(CSV)
    (tmp_path / "b.csv").write_text(CSV.replace("15", "x"))
    (tmp_path / "c.up").write_text("1\n")
    return tmp_path


def test_a_file_that_is_no_recording_is_named_with_its_line_and_the_others_are_read(folder, capsys):
    """So is a trace of mahimahi that lasts a millisecond and repeats."""
    assert [(trace.name, trace.duration_s) for trace in recordings(folder)] == [("a.csv", 15.0), ("c.up", 0.001)]
    assert f"{folder / 'b.csv'}:3: time_s 'x'" in capsys.readouterr().err


def test_a_row_and_a_dot_stand_for_each_link_and_side(folder, tmp_path):
    """A dot stands in the column of its side; what is delivered is part of what is carried; a picture is drawn."""
    sides = ("defaults", "arpd", "bound")
    rows = [measured(recordings(folder)[0], side) for side in sides]
    found = summary(rows)
    assert [row[:2] for row in found.tables[1].rows] == [["a.csv", side] for side in sides]
    assert all(0.0 < row["delivered %"] < row["carried %"] < 101.0 for row in rows)
    assert [row[0] for row in found.tables[0].rows] == ["defaults", "arpd", "bound"]
    slow = {row["side"]: row["queue p95 s"] for row in rows}
    assert slow["arpd"] < slow["defaults"]
    assert [row.index(each) for row in found.drawn.rows for each in row[1:] if each] == [1, 3, 5]
    assert found.drawn.columns[1:] == list(SIDES)
    draw(tmp_path / "dots.png", found.drawn)
    assert (tmp_path / "dots.png").stat().st_size


def test_the_throttle_offers_half_of_the_mean(folder):
    """So its queue stays short, and nearly half of the link is delivered."""
    found = measured(recordings(folder)[1], "fixed throttle")
    assert 35.0 < found["delivered %"] < 52.0
    assert found["queue p95 s"] < 0.1
