"""scripts/bench/report.py: what a summary keeps, and what a page shows first."""

from scripts.bench.report import CELL, REPO, RESULTS, Summary, Table, figure, rivals, targets
from scripts.bench.robots import FAULTS, summary_of


def of_rounds(rows, *conditions, never_matched=(), **drawn):
    """Return a summary of rounds of a robot's sides, in which every figure is the same number."""
    keys = ("small %", "small p99 ms", "large/s")
    filled = [[*row[:-1], *[row[-1]] * len(keys), *[0] * len(FAULTS[1:]), int(row in never_matched)] for row in rows]
    table = Table(columns=[*CELL, *keys, *FAULTS], rows=filled)
    made = summary_of(table, drawn=Table(title="", columns=["s", *drawn], rows=[[0.0, *drawn.values()]]))
    made.conditions = list(conditions)
    return made


def test_a_round_without_figures_is_named_until_its_place_is_measured_again(tmp_path):
    """So are its conditions, also where no round of a part has figures, and the rounds of others stay."""
    plain, other = (["tb4", "link", "middle", "plain"], ["rgbd", "link", "middle", "plain"])
    kept = of_rounds([[*plain, 1], [*other, 2]], {"of": "rgbd"}, {"of": "tb4"}, plain=1.0)
    died = Summary(
        about="", conditions=[{"of": "^tb4"}], failed=[[*plain, "a node ended"]], rounds=Table(columns=[], rows=[])
    )
    both = kept.with_part(died, summary_of)
    both.write(tmp_path / "robots.json")
    both = Summary.read(tmp_path / "robots.json")
    assert ([row[0] for row in both.rounds.rows], both.conditions) == (["rgbd"], [{"of": "rgbd"}, {"of": "^tb4"}])
    both.conditions = []
    assert "tb4, link, middle, plain (a node ended)" in both.markdown()
    whole = both.with_part(of_rounds([[*plain, 3]], {"of": "tb4"}), summary_of)
    assert (len(whole.rounds.rows), whole.failed) == (2, [])


def test_arpd_is_held_to_the_worst_round_of_the_rival_that_is_hardest_to_beat():
    """A rival that was played less than three times sets no target; one whose samples never came sets none either."""
    place = ["tb4", "link", "middle"]
    rounds = [
        [*place, side, value] for side, values in (("plain", (8, 9, 7)), ("large_data", (4, 5, 6))) for value in values
    ]
    never = [[*place, "profile", None]] * 3
    found = of_rounds([*rounds, *never, [*place, "throttle", 1], [*place, "two_ends", 6.5]]).figures
    assert [(each.what.split(": ")[1], each.target, each.is_met) for each in found] == [
        ("small samples delivered, beside plain", 7.0, False),
        ("latency of small samples, p99, beside large_data", 6.0, False),
        ("large samples delivered, beside plain", 6.3, True),
    ]


def test_a_round_in_which_a_rivals_topics_never_matched_sets_no_target():
    """What did not cross says nothing of the way; arpd's own rounds count all the same."""
    place = ["tb4", "link", "middle"]
    rounds = [[*place, "plain", value] for value in (8, 9, 0)]
    lost = [[*place, "two_ends", 3], [*place, "large_data", 1]]
    found = of_rounds([*rounds, *lost[:1], *lost[1:] * 3], never_matched=[rounds[-1], *lost]).figures
    assert [(each.what.split(": ")[1], each.target, each.value) for each in found] == [
        ("small samples delivered, beside plain", 8.0, 3.0),
        ("latency of small samples, p99, beside plain", 9.0, 3.0),
        ("large samples delivered, beside plain", 7.2, 3.0),
    ]


def test_a_side_of_whose_samples_none_came_in_a_round_is_never_in_the_readmes_table():
    """A median would hide it; a side that was not played has an empty cell."""
    columns = ["robot", "link", "bottleneck", "side", "large/s", "small p99 ms", "small %", "commands p99 ms"]
    place, rounds = ["tb4", "fall-and-rise", "middle"], ([1.0, None, 2.0, 3.0], [3.0, 4.0, 4.0, 5.0])
    rows = [[*place, "plain", *each] for each in rounds]
    lines = rivals(Table(columns=columns, rows=rows)).splitlines()
    assert [line for line in lines if "rclpy" in line] == ["| rclpy's defaults | 2 | never | 3 | 4 |"]
    assert "| arpd |  |  |  |  |" in lines


def test_a_figure_that_misses_its_target_looks_like_it():
    """Three digits would show some as met; one that never came has no number."""
    figures = [
        figure("part", 99.97, "%", least=100.0),
        figure("lost", None, "s", most=2.0),
        figure("off", 6e-12, most=1.0),
    ]
    shown = targets({"demo": Summary(about="", figures=figures)})
    assert "| demo | part | **99.97** | ≥ 100 | % |" in shown
    assert "| demo | lost | **never** | ≤ 2 | s |" in shown
    assert "| demo | off | 0 | ≤ 1 |" in shown


def test_the_page_is_what_the_summaries_say():
    """Every kept summary stands in docs/results.md as it is, and each target of all once, in one list."""
    page = (REPO / "docs/results.md").read_text()
    known = {path.stem: Summary.read(path) for path in sorted(RESULTS.glob("*.json"))}
    aims = [(name, each.what) for name, one in known.items() for each in one.figures]
    assert len({*aims}) == len(aims)
    for name, text in {"targets": targets(known), **{name: one.markdown() for name, one in known.items()}}.items():
        _, _, block = page.partition(f"<!-- {name}:begin -->\n")
        assert block.split("<!--")[0].split() == text.split(), name
