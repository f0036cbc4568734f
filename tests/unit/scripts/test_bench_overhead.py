"""The judgement and the checks of the benchmark of arpd's own cost, from made readings; real ones need the link."""

import json
import os
import subprocess
import sys

import pytest

from arpd.model.errors import ArpdError
from scripts.bench.overhead import FAST, SIZES, SLOW, complaints, report
from scripts.bench.overhead_cases import SYNTHETIC, case_of
from scripts.bench.overhead_meter import ANSWERS, DISCOVERY, KINDS, ORDERS, PROBES, REPORTS, is_discovery, kind_of
from scripts.bench.overhead_sides import AFTER, BEFORE, Side, side_of
from scripts.bench.overhead_targets import bytes_for_all, cpu, discovery_bytes, exponent, fitted, judge
from scripts.bench.record import REPO, conditions


def span(phase, *, run=0.02, peer=0.005, probes=3_000.0, **changes):
    is_busy = phase != "rest"
    values = {
        "phase": phase,
        "link_bytes_per_second": SLOW if phase == "paced" else FAST,
        "cpu_share": {"source": 0.05, "sink": 0.03, "relay0": 0.1, "relay1": 0.2, "run": run, "peer": peer},
        "rss_bytes": {"run": 100 * 2**20, "peer": 70 * 2**20, "relay0": 90 * 2**20},
        "has_cvxpy": False,
        "interface_bytes_per_second": 1_000.0 + probes + is_busy * 500_000.0,
        "control_bytes_per_second": dict.fromkeys(KINDS, 0.0) | {PROBES: probes},
        "discovery_bytes_per_second": 1_000.0,
        "listener_bytes_per_second": 100.0,
        "sent": 500 * is_busy,
        "expected": 505.0 * is_busy,
        "withheld": 200 * (phase == "paced"),
        "published_bytes_per_second": 490_000.0 * is_busy,
        "plans": 0,
        "swaps": 0,
    }
    return values | changes


def plan(cause, *, swaps=12, discovery=60_000, **changes):
    fall = {"price_s": 0.1, "plan_s": 2.0, "confirmed_s": 5.0} if cause == "fall" else {}
    values = {"cause": cause, "lasted_s": 10.0, "discovery_bytes": discovery, "listener_bytes": 30_000, "swaps": swaps}
    return values | fall | changes


def run(*spans, topics=12, side=AFTER, plans=None, **changes):
    counts = dict.fromkeys(("found", "planned", "confirmed"), topics)
    values = {
        "side": side,
        "topics": topics,
        "relays": 1,
        "offered_hz": 428.0,
        "offered_bytes_per_second": 1.4e6,
        "least_payload_bytes": 52,
        "most_payload_bytes": 30_060,
        **counts,
        **{f"{key}_s": 2.0 for key in counts},
        "spans": list(spans) or [span("rest"), span("load"), span("paced")],
        "plans": plans if plans is not None else [plan("start"), plan("fall")],
        "complaints": [],
    }
    return values | changes


def document(*runs, before=None, steady=None):
    rates = {"fast": FAST, "slow": SLOW}
    found = {"conditions": conditions(), "rates_bytes_per_second": rates, "before": before, "steady": steady}
    return found | {"runs": list(runs) or [run()]}


def missed(found):
    return [target.what for target in judge(found) if not target.is_met]


def test_twelve_topics_meet_their_targets():
    """CPU and bytes in three phases, memory, no cvxpy, the plan, and the price."""
    assert len(judge(document())) == 10
    assert missed(document()) == []


def test_what_is_missed_names_its_parts_the_largest_first():
    """Twice the CPU and ten times the probes at rest miss two targets and no other."""
    found = document(run(span("rest", run=0.05, probes=30_000.0), span("load"), span("paced")))
    assert missed(found) == [
        "12 topics, at rest: CPU of run and peer, of a core",
        "12 topics, at rest: bytes of run and peer, of the link",
    ]
    assert judge(found)[0].parts == "run 5.0%, peer 0.5%"


@pytest.mark.parametrize(
    ("changes", "what"),
    [
        ({"confirmed": 990}, "confirmed"),
        ({"complaints": ["it was bypassed"]}, "runs that failed"),
        ({"failed": "gone"}, "runs that failed"),
        ({"plans": [plan("fall", price_s=None)]}, "price"),
        ({"plans": [plan("fall", price_s=0.6)]}, "price"),
        ({"spans": [span("load", run=0.16)]}, "CPU of run"),
    ],
)
def test_a_thousand_topics_have_targets_of_their_own(changes, what):
    """One of them misses, and the others hold."""
    (wrong,) = missed(document(run(topics=1000, **changes)))
    assert wrong.startswith(f"1000 topics: {what}")


def test_before_stands_beside_after_and_a_failure_is_a_figure():
    """Rounds share a cell, and the reason of a run that failed stands on the page."""
    failed = run(topics=500, side=BEFORE, spans=[], plans=[], failed="lost sight", found=0, found_s=None)
    runs = [run(topics=500), *(run(span("load", run=share)) for share in (0.02, 0.03, 0.06))]
    text = report(document(failed, run(span("load", run=0.1), side=BEFORE), *runs, before="abc"))
    assert "| 10.0 → 3.0 (6.0) |" in text
    assert "| 500 | 0 → 500, 2.0 s |" in text
    assert "- 500 topics, before: failed: lost sight." in text


def test_all_relays_count_together():
    """Their CPU is added."""
    assert cpu(span("rest"), "relay") == pytest.approx(0.3)


def test_discovery_of_a_plan_leaves_out_what_flows_at_rest():
    """Of 60 kB in ten seconds, ten are there without a plan; ten seconds at a higher rate leave nothing."""
    made = run()
    assert discovery_bytes(made, plan("start")) == 50_000
    assert discovery_bytes(made, plan("start"), "listener_bytes") == 29_000
    assert discovery_bytes(made, plan("start", discovery=5_000)) == 0
    assert bytes_for_all([run(plans=[plan("start", swaps=6), plan("fall", swaps=0)])]) == 100_000
    assert bytes_for_all([run(plans=[plan("fall", swaps=0)])]) is None


def test_the_exponent_is_that_of_a_power():
    """Two for squares; only large numbers of topics have to grow linearly."""
    assert exponent([12, 100, 1000], [3 * size**2 for size in (12, 100, 1000)]) == pytest.approx(2.0)
    sizes = (100, 1000)
    squares = [run(topics=n, plans=[plan("start", swaps=n, discovery=n**2 + 10_000)]) for n in sizes]
    assert fitted(document(*squares), AFTER) == pytest.approx(2.0)
    assert fitted(document(*squares), AFTER, least_topics=101) is None
    assert fitted(document(*squares), BEFORE) is None
    assert any(what.startswith("exponent") for what in missed(document(*squares)))


@pytest.mark.parametrize(
    ("plans", "most_swaps", "misses"),
    [({}, 0, 0), ({"budget": 13}, 1, 0), ({"up": 1}, 0, 1), ({"budget": 2}, 2, 1)],
)
def test_nothing_may_flap_in_the_long_time(plans, most_swaps, misses):
    """A plan without a cause, or a second swap of a topic, is a flap; swaps that were owed are none."""
    steady = run(topics=100, steady={"lasted_s": 600.0, "plans": plans, "swaps": 86, "most_swaps": most_swaps})
    assert len(missed(document(steady=steady))) == misses


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"sent": 100}, "100 of 505 samples"),
        ({"interface_bytes_per_second": 1_000.0}, "bypassed"),
        ({"published_bytes_per_second": 0.0}, "lost sight"),
        ({"cpu_share": {"run": 0.0}}, "no CPU"),
        ({"control_bytes_per_second": dict.fromkeys(KINDS, 0.0)}, "no byte"),
    ],
)
def test_nonsense_is_named(changes, complaint):
    """Idle sources, a bypassed link and idle processes are no figures."""
    assert complaints(run()) == []
    assert any(complaint in said for said in complaints(run(span("load", **changes), span("paced"))))


def test_pacing_must_have_had_something_to_do():
    """Otherwise the slow link was not slow."""
    assert complaints(run(span("paced", withheld=0))) == ["pacing had nothing to do"]


@pytest.mark.parametrize(
    ("sender", "receiver", "offset", "kind"),
    [
        ("run", "sink", 0, DISCOVERY),  # multicast
        ("sink", "", 0, ""),
        ("run", "sink", 12, DISCOVERY),
        ("sink", "run", 10, DISCOVERY),
        ("run", "peer", 13, PROBES),
        ("run", "sink", 11, ORDERS),
        ("peer", "run", 15, REPORTS),
        ("sink", "run", 15, ANSWERS),
        ("relay0", "peer", 7001 - 7400 - 250 * 7, DISCOVERY),  # ros_discovery_info
        ("relay0", "sink", 11, ""),
    ],
)
def test_a_datagram_is_known_by_its_ends(sender, receiver, offset, kind):
    """All that run or peer sends or receives is control plane; DDS's ports tell discovery."""
    assert kind_of(sender, receiver, 7400 + 250 * 7 + offset, domain_id=7) == kind


@pytest.mark.parametrize("topics", {*SIZES, *SYNTHETIC})
def test_every_robot_can_be_carried_and_must_be_paced(topics):
    """The fast link carries what the sources offer, the slow one does not, and every topic is in one relay."""
    made = case_of(topics)
    assert len(made.topics) == topics
    assert SLOW < made.offered_bytes_per_second < 0.8 * FAST
    carried = [topic["name"] for relay in made.relays() for topic in relay["relay"]["topics"]]
    assert carried == [topic.name for topic in made.sensing]
    assert all(len(relay["relay"]["topics"]) <= 256 for relay in made.relays())
    assert json.loads(json.dumps(made.relays())) == made.relays()


def test_discovery_of_all_processes_counts():
    """Discovery counts by its port, from any sender; user data at the odd ports does not count."""
    assert [is_discovery(7400 + 250 * 7 + offset, domain_id=7) for offset in (0, 1, 10, 11, 12)] == [1, 0, 1, 0, 1]
    assert is_discovery(7001, domain_id=7)


def test_a_side_gives_its_own_arpd(tmp_path):
    """A process imports arpd of the side's tree, and scripts of this one; a section that it refuses is left out."""
    (tmp_path / "arpd").mkdir()
    (tmp_path / "arpd" / "__init__.py").write_text("WHO = 'another'\n")
    (tmp_path / "arpd" / "cli.py").write_text(
        "import sys\nsys.exit('what is wrong' if 'governor' in open(sys.argv[-1]).read() else 0)\n"
    )
    side = Side(name=BEFORE, tree=tmp_path)
    asked = "import arpd, scripts.bench.node; print(arpd.WHO)"
    environment = {**os.environ, **side.environment()}
    printed = subprocess.run(
        [sys.executable, "-c", asked], cwd=REPO, env=environment, capture_output=True, text=True, check=True
    )
    assert printed.stdout == "another\n"
    configs = [{"governor": 1, "relay": 1}, {"governor": 1, "relay": 2}]
    assert side.accepted(configs, "governor") == [{"relay": 1}, {"relay": 2}]
    with pytest.raises(ArpdError, match="what is wrong"):
        side.accepted(configs, "relay")


def test_this_arpd_accepts_its_robots():
    """With or without the section that only an older arpd needs."""
    for topics in SIZES:
        (first, *_) = Side(name=AFTER).accepted(case_of(topics).relays(), "governor")
        assert first.keys() >= {"relay"}


@pytest.mark.skipif(not (REPO / ".git").exists(), reason="no git repository")
def test_a_revision_has_its_own_tree():
    """Only the package arpd is extracted; an unknown revision is an error."""
    with side_of("HEAD") as side:
        assert (side.tree / "arpd" / "daemon" / "tick.py").exists()
        assert [path.name for path in side.tree.iterdir()] == ["arpd"]
    assert not side.tree.exists()
    with pytest.raises(ArpdError, match="no-such-revision"), side_of("no-such-revision"):
        pass
