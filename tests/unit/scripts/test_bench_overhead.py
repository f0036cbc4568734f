"""The judgement and the checks of the benchmark of arpd's own cost, from made readings; real ones need the link."""

import json

import pytest

from scripts.bench.overhead import check
from scripts.bench.overhead_cases import DEMO_TOPICS, SYNTHETIC, case_of
from scripts.bench.overhead_meter import ANSWERS, DISCOVERY, KINDS, ORDERS, PROBES, REPORTS, kind_of
from scripts.bench.overhead_report import markdown, verdicts
from scripts.bench.overhead_robot import OverheadError
from scripts.bench.record import conditions

FAST, SLOW = 2.5e6, 625e3


def span(phase, *, run=0.02, peer=0.005, probes=3_000.0, **changes):
    is_managed, is_busy = phase != "rest without", not phase.startswith("rest")
    values = {
        "phase": phase,
        "link_bytes_per_second": SLOW if phase == "paced" else FAST,
        "span_s": 12.0,
        "cpu_share": {"source": 0.05, "sink": 0.03, "relay0": 0.1} | ({"run": run, "peer": peer} if is_managed else {}),
        "rss_bytes": {"run": 100 * 2**20, "peer": 70 * 2**20, "relay0": 90 * 2**20} if is_managed else {},
        "has_cvxpy": False,
        "interface_bytes_per_second": 1_000.0 + is_managed * probes + is_busy * 500_000.0,
        "control_bytes_per_second": dict.fromkeys(KINDS, 0.0) | ({PROBES: probes} if is_managed else {}),
        "sent": 500 * is_busy,
        "expected": 505.0 * is_busy,
        "offered": 500 * is_busy,
        "withheld": 200 * (phase == "paced"),
        "published_bytes_per_second": 490_000.0 * is_busy,
    }
    return values | changes


def case(*spans, topics=12, reactions=(), settled_s=2.0):
    return {
        "topics": topics,
        "relays": 1,
        "offered_hz": 428.0,
        "offered_bytes_per_second": 1.4e6,
        "least_payload_bytes": 52,
        "most_payload_bytes": 30_060,
        "settled_s": settled_s,
        "spans": list(spans) or [span("rest without"), span("rest"), span("load"), span("paced")],
        "reactions": list(reactions),
    }


def document(*cases):
    rates = {"fast": FAST, "slow": SLOW}
    return {"conditions": conditions(), "rates_bytes_per_second": rates, "cases": list(cases) or [case()]}


def reaction(*, falls, plan_s=2.0, confirmed_s=5.0, gate_s=0.4):
    ends = (FAST, SLOW) if falls else (SLOW, FAST)
    keys = ("from_bytes_per_second", "to_bytes_per_second")
    return dict(zip(keys, ends, strict=True)) | {
        "gate_s": gate_s,
        "plan_s": plan_s,
        "confirmed_s": confirmed_s,
        "plans": 1,
        "refusals": 0,
    }


def judgement(found, what):
    return next(sentence for sentence in verdicts(found) if sentence.startswith(what) and "at rest" in sentence)


def test_what_is_within_its_bound_is_met():
    """Eight targets with twelve topics: CPU and bytes in three phases, memory, and no cvxpy."""
    assert [sentence.endswith("met.") for sentence in verdicts(document())] == [True] * 8


def test_what_is_missed_names_its_parts_the_largest_first():
    """Twice the CPU and ten times the probes at rest miss two targets and no other."""
    found = document(case(span("rest without"), span("rest", run=0.05, probes=30_000.0), span("load"), span("paced")))
    assert judgement(found, "CPU").endswith("missed (run 5.0%, peer 0.5%).")
    assert "1.20% of 20 Mbit/s; missed (probes 30.0 kB/s" in judgement(found, "Bytes")
    assert sum("missed" in sentence for sentence in verdicts(found)) == 2


def test_one_process_that_has_loaded_cvxpy_misses_its_target():
    """All other targets are met."""
    (missed,) = (s for s in verdicts(document(case(span("rest", has_cvxpy=True)))) if s.endswith("missed."))
    assert missed.startswith("cvxpy")


def test_without_twelve_topics_nothing_is_judged():
    """The targets are those of twelve topics."""
    assert not any(sentence.endswith(("met.", "missed.")) for sentence in verdicts(document(case(topics=100))))


def test_a_reaction_that_never_came_is_counted():
    """A median does not hide a reaction that never came, and a rise has no gate."""
    reactions = [reaction(falls=True), reaction(falls=True, confirmed_s=None), reaction(falls=False, gate_s=None)]
    text = markdown(document(case(reactions=reactions)))
    (fall,) = (line for line in text.splitlines() if "20 → 5" in line)
    assert "| 0.40 | 2.0 | never in 1 of 2 | 1 |" in fall
    (rise,) = (line for line in text.splitlines() if "5 → 20" in line)
    assert "|  | 2.0 | 5.0 | 1 |" in rise


def test_the_worst_stands_beside_the_median():
    """Spans of the same phase share a cell."""
    spans = [span("rest without"), span("rest"), *(span("load", run=share) for share in (0.02, 0.03, 0.06))]
    assert "3.0 (6.0)" in markdown(document(case(*spans)))


def test_a_robot_without_a_plan_and_one_without_figures_are_named():
    """The page has a point for each, with the reason of the failure."""
    points = markdown(document()).count("\n- ")
    found = document(case(), case(topics=500, settled_s=None))
    assert markdown(found).count("\n- ") == points + 1
    text = markdown({**found, "failures": [{"topics": 900, "why": "nothing came"}]})
    assert text.count("\n- ") == points + 2
    assert "nothing came" in text


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
def test_nonsense_is_refused(changes, complaint):
    """Idle sources, a bypassed link and idle processes are errors."""
    check(case())
    with pytest.raises(OverheadError, match=complaint):
        check(case(span("load", **changes), span("paced")))


def test_pacing_must_have_had_something_to_do():
    """Otherwise the slow link was not slow."""
    with pytest.raises(OverheadError, match="pacing"):
        check(case(span("paced", withheld=0)))


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


@pytest.mark.parametrize("topics", [DEMO_TOPICS, *SYNTHETIC])
def test_every_robot_can_be_carried_and_must_be_paced(topics):
    """The fast link carries what the sources offer, the slow one does not, and every topic is in one relay."""
    made = case_of(topics)
    assert len(made.topics) == topics
    assert SLOW < made.offered_bytes_per_second < 0.8 * FAST
    carried = [topic["name"] for relay in made.relays() for topic in relay["relay"]["topics"]]
    assert carried == [topic.name for topic in made.sensing]
    assert all(len(relay["relay"]["topics"]) <= 256 for relay in made.relays())
    assert json.loads(json.dumps(made.relays())) == made.relays()


def test_a_span_without_arpd_need_not_say_what_was_published():
    """Without run, nothing counts it."""
    without = span("rest without")
    del without["published_bytes_per_second"]
    check(case(without, span("load"), span("paced")))
