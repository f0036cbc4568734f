"""`arpd solve --config` with the uniform policy."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from arpd.report.status import status_document

SMALL = """\
program: {policy: uniform, backend: exact}
link: {headroom: 1}
defaults: {latency_budget: none}
topics:
  - {name: /scan, payload: 1kB, source_rate_hz: 20}
  - {name: /camera, payload: 6kB, source_rate_hz: 30, weight: 2, min_rate_hz: 2, max_rate_hz: 15}
  - {name: /battery, payload: 76B, source_rate_hz: 2}
"""


@pytest.fixture
def planned(run):
    """Run ``arpd solve --config … --json`` and return its document."""

    def planned(*arguments):
        code, out, _ = run("solve", "--config", *arguments, "--json")
        assert code == 0
        return json.loads(out)

    return planned


@pytest.fixture
def saved(tmp_path, sample_snapshot):
    """Save a status with these counts of the graph, and return its path."""

    def saved(sensing, actuation):
        graph = replace(sample_snapshot.observation, sensing_topics=sensing, actuation_topics=actuation)
        path = tmp_path / "robot.json"
        path.write_text(json.dumps(status_document(replace(sample_snapshot, observation=graph))))
        return path

    return saved


def test_the_table_has_the_optimum_of_all_topics(run, config):
    """A line has N, Rmax, R and D; each row has the same rate and depth, but a slow source keeps its own rate."""
    code, out, _ = run("solve", "--config", config(), "--capacity", "1mbit")
    lines = out.splitlines()
    assert code == 0
    assert lines[2] == "uniform  3 topics on the link, Rmax 40.54 Hz: R 12.51 Hz and D 1542 for each"
    rows = {line.split()[0]: line.split() for line in lines if line.startswith("/")}
    assert {name: (row[6], row[10], row[11]) for name, row in rows.items()} == {
        "/battery": ("2", "1542", "desired"),
        "/camera": ("12.51", "1542", "link"),
        "/scan": ("12.51", "1542", "link"),
    }


def test_the_document_has_the_policy_and_the_optimum(planned, config):
    """JSON has N, Rmax, R and D, and the preferences in force: those of `defaults`."""
    document = planned(config(), "--capacity", "1mbit")
    assert document["policy"] == "uniform"
    assert document["uniform"]["topics"] == 3
    assert document["uniform"]["rate_hz"] == pytest.approx(document["uniform"]["max_rate_hz"] / 3 - 1)
    camera = next(row for row in document["topics"] if row["topic"] == "/camera")
    assert (camera["weight"], camera["min_rate_hz"], camera["desired_rate_hz"]) == (1.0, 1.0, 30.0)
    assert camera["rate_hz"] == pytest.approx(document["uniform"]["rate_hz"], rel=1e-6)


def test_the_other_policy_has_no_common_optimum(planned, config):
    """Per topic, ``uniform`` is null."""
    document = planned(config(SMALL.replace("policy: uniform, ", "")), "--capacity", "1mbit")
    assert (document["policy"], document["uniform"]) == ("per_topic", None)


@pytest.mark.parametrize(
    ("graph", "count"), [("", 30), ("graph: {actuation_topics: 4}", 24), ("graph: {sensing_topics: 0}", 10)]
)
def test_n_is_pinned_or_measured(planned, config, saved, graph, count):
    """N comes from `graph`, else from the saved status."""
    document = planned(config(SMALL + graph), "--capacity", "5mbit", "--status", saved(20, 10))
    assert document["uniform"]["topics"] == count


def test_without_a_status_n_is_pinned_or_that_of_the_file(planned, config):
    """Offline, N is at least the number of the file's topics."""
    pinned = "graph: {sensing_topics: 11, actuation_topics: 1}"
    documents = [planned(config(SMALL + graph), "--capacity", "5mbit") for graph in ("", pinned)]
    assert [document["uniform"]["topics"] for document in documents] == [3, 12]


def test_a_status_with_impossible_counts_is_refused(run, config, saved):
    """Counts that are no counts are named."""
    code, _, err = run("solve", "--config", config(), "--capacity", "1mbit", "--status", saved(-1, 2))
    assert code == 1
    assert "graph.sensing_topics: -1 is not a number of topics" in err


def test_the_sweep_says_what_gave_way(run, config):
    """Below Rmin for all topics the words say what is left of it."""
    code, out, _ = run("solve", "--config", config(), "--sweep", "10kbit:10mbit", "--points", "3")
    assert code == 0
    assert "rate reserve given up; rate floor cut to 14%" in out
