"""scripts/bench/report.py: what a summary keeps, and what a page shows first."""

from __future__ import annotations

from scripts.bench.report import Summary, Table, figure


def summary(rows, *conditions, figures=()):
    tables = [Table(columns=["robot", "side", "late %"], rows=rows)]
    return Summary(about="", tables=tables, conditions=list(conditions), figures=list(figures))


def test_a_part_that_is_measured_again_takes_the_place_of_the_first():
    """So do its conditions, where no row of the first is left."""
    kept = summary([["tb4", "plain", 1], ["rgbd", "plain", 2]], {"of": "tb4 "}, {"of": "rgbd"})
    again = kept.with_part(summary([["tb4", "plain", 3]], {"of": "^tb4"}), names=2)
    assert again.tables[0].rows == [["tb4", "plain", 3], ["rgbd", "plain", 2]]
    assert again.conditions == [{"of": "rgbd"}, {"of": "^tb4"}]


def test_figures_that_miss_their_target_stand_first_and_the_others_are_folded():
    """A long table is folded, too; a column that no figure has is left out."""
    figures = [figure("well", 1.0, "s", most=2.0), figure("late", 3.0, "s", most=2.0)]
    shown, _, folded = summary([["tb4", "plain", 1]] * 30, figures=figures).markdown().partition("<details>")
    assert "1 of 2 figures" in shown
    assert ("| late | **3** | ≤ 2 | s |" in shown, "| well | 1 | ≤ 2 | s |" in folded) == (True, True)
    assert ("tb4" in shown, folded.count("tb4"), folded.count("<details>")) == (False, 30, 1)
