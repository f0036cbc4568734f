"""The links, sides and figures of the benchmark of adaptation, from made runs; real runs need the link."""

import json
import math
from dataclasses import fields, replace
from itertools import pairwise
from typing import Any

import pytest

from arpd.adapters.config.load import load_settings
from arpd.adapters.sim.demo import COMMAND_TOPIC
from arpd.adapters.sim.result import TopicResult
from arpd.solve.topics import assumed_traffic
from scripts.bench.adapt import renewed
from scripts.bench.adapt_figures import (
    beyond_period,
    check,
    document,
    due,
    figures_of,
    late_share,
    over_time,
    pooled,
    ranges_of,
)
from scripts.bench.adapt_links import CALM_S, MBIT, SEED, links
from scripts.bench.adapt_sides import SIDES, papers_optimum, plain_wire_bytes, throttle
from scripts.bench.adapt_targets import TARGETS, judge, missing_of, times_of
from scripts.bench.adapt_walk import TRACE, text, walk
from scripts.bench.record import conditions
from scripts.robot.run import CONFIG
from scripts.robot.sensors import SENSORS
from scripts.robot.stamped import StampedArrivals

# -- the links


def test_every_link_is_calm_first_and_then_changes():
    """For five seconds a link is steady; then its rate or its loss changes before the run ends, or it never does."""
    for link in links(seed=SEED):
        if link.name.startswith("steady"):
            assert not link.changes_s
            assert not link.losses
            continue
        changes = list(link.changes_s)
        changes += [step.start_s for step in link.losses if step.start_s > 0]
        assert link.loss_at(CALM_S - 0.1) == 0.0, link.name
        assert min(changes) >= CALM_S, link.name
        assert max(changes) < link.duration_s, link.name


def test_the_same_seed_brings_the_same_links_and_another_other_bursts():
    """Every side meets the same schedule; only the seed moves the bursts."""
    assert links(seed=1) == links(seed=1)
    (bursts,), (others,) = ([link.losses for link in links(seed) if link.name == "burst-loss"] for seed in (SEED, 1))
    assert bursts != others


def test_the_bursts_are_bad_as_often_as_their_chain_is():
    """After the calm, 9 % of the time is bad, 0.3 s of 3.3 s; half is lost then or all, and at the end nothing."""
    (bursts,) = (link.losses for link in links(SEED) if link.name == "burst-loss")
    bad_s = sum(end.start_s - begin.start_s for begin, end in pairwise(bursts) if begin.loss)
    assert bad_s / (28.0 - 1.0 - CALM_S) == pytest.approx(0.3 / 3.3, rel=0.05)
    assert {step.loss for step in bursts} == {0.0, 0.5, 1.0}
    assert bursts[-1].loss == 0.0


def test_in_the_outage_nothing_passes():
    """The outage takes the rate as well as the packets, for five seconds."""
    outage = next(link for link in links(seed=SEED) if link.name == "outage")
    assert [outage.loss_at(at_s) for at_s in (7.9, 8.0, 12.9, 13.0)] == [0, 1, 1, 0]
    assert [outage.rates.rate_at(at_s) for at_s in (7.9, 8.0, 12.9, 13.0)] == [20 * MBIT, 10, 10, 20 * MBIT]
    assert outage.outages == ((8.0, 13.0),)


@pytest.mark.parametrize(("name", "mbit"), [("step-down", (20 * 5 + 5 * 23) / 28), ("step-up", (5 * 5 + 20 * 23) / 28)])
def test_the_mean_rate_is_that_over_the_whole_run(name, mbit):
    """The mean weighs every rate by its duration."""
    link = next(link for link in links(seed=SEED) if link.name == name)
    assert link.mean_bytes_per_second == pytest.approx(mbit * MBIT)


def test_the_walk_in_the_tree_is_what_its_generator_makes():
    """The committed trace comes from the committed generator and seed, between 1.5 and 20.2 Mbit/s."""
    assert TRACE.read_text() == text()
    rates = [rate for _, rate, _ in walk()]
    assert 1.5e6 <= min(rates) < 3e6
    assert 19e6 < max(rates) <= 20.2e6


# -- the sides


def test_the_papers_optimum_fills_the_link_at_the_start_with_one_rate_and_one_depth():
    """All topics at R + Rmin (2) cost exactly what the link carries; the depth is that of (3) at this rate."""
    chosen = papers_optimum(20 * MBIT)
    (rate_hz,) = set(chosen.rates_hz.values())
    topics = assumed_traffic(load_settings(CONFIG, interfaces=None))
    costs = [plain_wire_bytes(topic.payload_bytes) for topic in topics]
    assert chosen.rates_hz.keys() == {*SENSORS, COMMAND_TOPIC}
    assert rate_hz == pytest.approx(1e9 / chosen.deadline_ns)
    assert (rate_hz + 1.0) * sum(costs) == pytest.approx(20 * MBIT)
    assert chosen.depth == math.floor(5000 / 12 * rate_hz / (rate_hz + 1.0) - 1)
    assert chosen.rate_hz("/battery", 1.0) == 1.0


@pytest.mark.parametrize(("payload_bytes", "frames"), [(76, 1), (1300, 1), (1400, 2), (30_060, 21)])
def test_a_plain_sample_costs_its_headers_once_and_a_frame_for_every_fragment(payload_bytes, frames):
    """UDP 8 and RTPS 132 bytes come once, Ethernet 14 and IPv4 20 with each frame of at most 1500 bytes."""
    assert plain_wire_bytes(payload_bytes) == payload_bytes + 8 + 132 + frames * 34


def test_the_throttle_gives_every_topic_what_solve_prints():
    """At 5 Mbit/s the heavy topics are slowed by hand and the light ones are not."""
    slowed = throttle(5 * MBIT)
    assert slowed.rate_hz("/camera/image/compressed", 30.0) < 10.0
    assert slowed.rate_hz(COMMAND_TOPIC, 20.0) == pytest.approx(20.0)
    assert slowed.depth == 10


# -- ages


def test_an_age_grows_while_nothing_comes_from_before_the_first_sample_to_the_end():
    """The log gives an age every 50 ms: before the first sample the wait, after the last one its growing age."""
    arrivals = StampedArrivals(renewals=[(100.1, 100.09), (100.22, 100.2)])
    arrivals.sample_ages(100.0, 100.4)
    assert arrivals.ages_s == pytest.approx([0.05, 0.01, 0.06, 0.11, 0.05, 0.10, 0.15, 0.20], abs=1e-6)


def test_a_reader_that_never_got_anything_is_as_old_as_the_run():
    """The age grows although nothing arrives."""
    arrivals = StampedArrivals()
    arrivals.sample_ages(5.0, 6.0)
    assert arrivals.ages_s[-1] == pytest.approx(1.0)


def test_the_age_beyond_the_period_is_zero_on_a_perfect_link():
    """A topic of 1 Hz may be a second old."""
    assert beyond_period([0.3, 1.0, 1.5], 1.0) == [0.0, 0.0, 0.5]


def test_ages_over_time_are_means_over_all_topics():
    """Half a second holds ten ages of each topic."""
    assert over_time([[0.1] * 20, [0.3] * 10 + [0.5] * 10]) == pytest.approx([0.2, 0.3])


# -- pooling


def test_every_topic_weighs_the_same_however_many_samples_it_has():
    """A slow topic of two samples makes half of a percentile over two topics."""
    samples = [([0.001] * 998, 998), ([1.0, 2.0], 2)]
    assert pooled(samples, 0.5) == 0.001
    assert pooled(samples, 0.75) == 1.0
    assert pooled(samples, 0.99) == 2.0


def test_what_is_lost_never_arrives():
    """With two of a hundred lost, p98 is a number and p99 is never; without any arrival p50 is never."""
    samples = [([0.01] * 98, 100)]
    assert pooled(samples, 0.98) == 0.01
    assert pooled(samples, 0.99) is None
    assert pooled([([], 5)], 0.5) is None


def test_a_late_command_and_a_lost_one_count_alike():
    """One of four is later than 100 ms and one is lost: half are late."""
    assert late_share([0.01, 0.1, 0.2], 4) == 0.5


def result(topic, **changes):
    values: dict[str, Any] = {field.name: None for field in fields(TopicResult)}
    values |= {"expected": 100, "offered": 100, "withheld": 0, "sent": 100, "received": 100, "delivered_bytes": 1000}
    values |= {"topic": topic, "source_rate_hz": SENSORS[topic][0] if topic in SENSORS else 20.0}
    return TopicResult(**(values | {"doubled": 0, "reordered": 0} | changes))


def test_what_the_robot_lost_itself_is_due_and_what_pacing_withheld_is_not():
    """Of 100 offered with 30 withheld, 70 are due though only 60 left."""
    assert due(result("/imu", withheld=30, sent=60, received=60)) == 70


# -- the document and its verdicts


def made_run(link, side, *, latency_s=0.01, age_s=0.1, received=100, number=1, swaps=12, imu=None):
    """Return a run of 2 s; ``imu`` changes the counts of /imu, of which 100 are due."""
    topics = [result(topic, received=received) for topic in (*SENSORS, COMMAND_TOPIC)]
    topics = [replace(each, **(imu or {})) if each.topic == "/imu" else each for each in topics]
    samples = {t.topic: {"latencies_s": [latency_s] * t.received, "ages_s": [age_s] * 40} for t in topics}
    return {
        "link": link,
        "side": side,
        "round": number,
        **document(topics, samples, 2.0),
        "cpu": {"sources": 0.5, "machine": 0.5, **({"run": 0.05, "relay": 0.1, "peer": 0.01} if "a" in side else {})},
        "swaps": swaps,
        "reassembly": {"failed": 7, "peak_bytes": 4096},
        "load_average": 1.0,
    }


def made(*runs):
    names = list(dict.fromkeys(run["link"] for run in runs))
    return {
        "conditions": conditions(),
        "links": [
            {"name": name, "what": "it changes", "duration_s": 2.0, "rates": [[0.0, 2.5e6]], "losses": [[1.0, 0.5]]}
            for name in names
        ],
        "sides": {side: what for side, what in SIDES.items() if any(run["side"] == side for run in runs)},
        "runs": json.loads(json.dumps(list(runs), allow_nan=False)),
    }


def four(link="drop", **changed):
    """One link with four sides: the defaults lose, the paper's optimum is late, arpd and the bound are well."""
    sides = {
        "defaults": {"received": 50, "age_s": 10.0},
        "paper": {"latency_s": 0.5, "age_s": 5.0},
        "arpd": {},
        "oracle": {},
    }
    return made(*(made_run(link, side, **(how | changed.get(side, {}))) for side, how in sides.items()))


def met(found):
    return {verdict.target: verdict.is_met for verdict in judge(found)}


@pytest.mark.parametrize(
    ("link", "others"), [("drop", set()), ("wifi-walk", {"samples", "swaps"}), ("oscillation", {"swaps"})]
)
def test_arpd_meets_every_target_where_it_is_as_good_as_the_bound(link, others):
    """Lossless and quick beside a link the others choke: all eight are met, and those of this link alone."""
    assert met(four(link)) == dict.fromkeys({*TARGETS} - {"samples", "swaps"} | others, True)


@pytest.mark.parametrize(
    ("sides", "missed"),
    [
        ({"arpd": {"latency_s": 0.016}}, {"latency/bound"}),
        ({"arpd": {"latency_s": 0.4}}, {"latency/paper", "latency/bound", "commands"}),
        ({"arpd": {"age_s": 2.1}}, {"age/defaults", "age/paper", "age/bound"}),
        ({"arpd": {"received": 98}}, {"latency/defaults", "latency/paper", "latency/bound", "commands"}),
    ],
)
def test_a_missed_target_is_named_and_was_possible(sides, missed):
    """A figure of arpd beyond what is allowed is missed, and the bound shows that the target is possible."""
    verdicts = judge(four(**sides))
    assert {verdict.target for verdict in verdicts if not verdict.is_met} == missed
    assert all(verdict.is_possible for verdict in verdicts)


@pytest.mark.parametrize(
    ("imu", "missing"),
    [
        ({"received": 99}, (1, 0)),
        ({"withheld": 2, "received": 98}, (0, 2)),
    ],
)
def test_a_sample_of_the_imu_that_was_lost_or_withheld_did_not_arrive(imu, missing):
    """One round of three is enough to miss the target, and both counts are known."""
    runs = [made_run("wifi-walk", "arpd", number=number) for number in (1, 2)]
    found = made(*runs, made_run("wifi-walk", "arpd", number=3, imu=imu), made_run("wifi-walk", "oracle"))
    (verdict,) = (one for one in judge(found) if one.target == "samples")
    assert (verdict.is_met, verdict.is_possible) == (False, True)
    assert missing_of(found, "wifi-walk", "arpd") == {"/imu": missing, COMMAND_TOPIC: (0, 0)}


@pytest.mark.parametrize(("link", "most"), [("oscillation", 4), ("wifi-walk", 7)])
def test_swaps_after_the_first_plan_are_at_most_half_of_those_before(link, most):
    """In 28 s arpd swapped 8 and 14 times after the 12 swaps of the first plan; runs of 2 s may not swap at all."""
    found = [made(made_run(link, "arpd", swaps=12 + more), made_run(link, "oracle")) for more in (most, most + 1)]
    for document_ in found:
        document_["links"][0]["duration_s"] = 28.0
    assert [met(document_)["swaps"] for document_ in found] == [True, False]


def test_what_no_side_meets_is_impossible():
    """Where every side loses as much, the losses are the link's, and the targets compare what arrived."""
    verdicts = judge(four(arpd={"received": 90}, oracle={"received": 90}, paper={"received": 90, "age_s": 5.0}))
    assert {one.target: one.is_possible for one in verdicts if not one.is_met} == {
        "latency/defaults": False,
        "latency/paper": False,
        "commands": False,
    }


def test_what_any_side_meets_was_possible():
    """Where the bound is slow and the paper's optimum is not, the link is no excuse."""
    found = four(paper={"latency_s": 0.05}, arpd={"latency_s": 0.3}, oracle={"latency_s": 0.3})
    (verdict,) = (one for one in judge(found) if one.target == "latency/paper")
    assert (verdict.is_met, verdict.is_possible) == (False, True)


def test_where_the_papers_optimum_suffices_arpd_must_only_be_no_worse():
    """Where the bound gains less than half, arpd may be as old as the paper's optimum, but not a fifth older."""
    suffices = {"paper": {"latency_s": 0.01, "age_s": 0.1}}
    assert met(four(**suffices))["age/paper"]
    assert not met(four(**suffices, arpd={"age_s": 0.12}))["age/paper"]


def test_rounds_are_summed_up_by_their_medians_and_never_is_worst():
    """Of three rounds, the middle one counts."""
    runs = [made_run("drop", "arpd", latency_s=at, number=k) for k, at in enumerate((0.03, 0.01, 0.02), start=1)]
    lossy = [made_run("drop", "oracle", received=count, number=k) for k, count in enumerate((50, 50, 100), start=1)]
    figures = figures_of(made(*runs, *lossy))
    assert figures["drop", "arpd"]["latency_p99_s"] == 0.02
    assert figures["drop", "oracle"]["latency_p99_s"] == math.inf


def test_arpd_stands_beside_the_bound_with_its_range():
    """Least and largest of the rounds, the ratio of the medians for all topics and each class, swaps after the plan."""
    ours = [made_run("drop", "arpd", latency_s=at, number=k, swaps=14) for k, at in enumerate((0.02, 0.01, 0.04))]
    found = made(*ours, *(made_run("drop", "oracle", number=k) for k in range(3)))
    figures = figures_of(found)
    assert ranges_of(found, "latency_p99_s")["drop", "arpd"] == (0.01, 0.04)
    assert [times_of(whose, figures, "drop") for whose in ("", "commands", "small", "large")] == [2.0] * 4
    assert figures["drop", "arpd"]["swaps_per_minute"] == 60.0


def test_where_much_is_lost_what_came_is_compared():
    """Both p99 are never; the samples that came took three times as long."""
    runs = [made_run("drop", side, received=90, latency_s=at) for side, at in (("arpd", 0.03), ("oracle", 0.01))]
    assert times_of("", figures_of(made(*runs)), "drop") == pytest.approx(3.0)


def test_a_partial_run_is_not_judged():
    """Without the bound there are no verdicts."""
    assert judge(made(made_run("drop", "defaults"), made_run("drop", "arpd"))) == []


def test_a_run_in_which_a_topic_never_came_is_nonsense():
    """A topic without a single sample means that the run did not work."""
    assert check(made_run("drop", "arpd")) == []
    assert "/imu was never received" in check(made_run("drop", "arpd", received=0))


# -- measuring some sides again


def test_runs_measured_again_replace_those_of_their_side_and_are_named():
    """The other sides keep their runs, the document names the side that was measured later, and a new link is added."""
    old = made(made_run("drop", "defaults"), made_run("drop", "arpd", age_s=0.4), made_run("drop", "oracle"))
    fresh = made(made_run("drop", "arpd", age_s=0.2), made_run("steady", "arpd"))
    found = renewed(old, fresh)
    ages = {run["side"]: run["all"]["age_p99_s"] for run in found["runs"] if run["link"] == "drop"}
    assert [link["name"] for link in found["links"]] == ["drop", "steady"]
    assert ages == {"defaults": 0.1, "oracle": 0.1, "arpd": 0.2}
    assert found["apart"]["sides"] == ["arpd"]


def test_runs_over_another_link_replace_none():
    """Only runs over the same course of the link are comparable."""
    old, fresh = made(made_run("drop", "arpd")), made(made_run("drop", "arpd"))
    fresh["links"][0]["rates"] = [[0.0, 1e6]]
    with pytest.raises(ValueError, match="drop: not the links"):
        renewed(old, fresh)
