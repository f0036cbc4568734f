"""The robot's dashboard, fourth part: what changing QoS cost."""

from __future__ import annotations

from scripts.dashboards.document import Section, evenly
from scripts.dashboards.panels import COUNT, Scale, bars, instant, query, ranking, timeseries
from scripts.dashboards.states import GREEN, GREY, VERMILLION

_TOPIC = 'topic=~"$topic"'


def swaps() -> Section:
    """Return the section on putting a plan into force."""
    return Section(
        title="Swaps: what changing QoS cost",
        lines=(
            (8, evenly(_RESULTS, _PLAN_REACHES, _GENERATIONS)),
            (8, evenly(_PHASE_TIMES, _WRITER_COST)),
        ),
    )


_RESULTS = bars(
    "Swaps",
    [
        query(f"sum(increase(arpd_topic_swaps_total{{{_TOPIC}}}[$__rate_interval]))", "begun"),
        query(
            f"sum by (reason) (increase(arpd_topic_swap_failures_total{{{_TOPIC}}}[$__rate_interval]))",
            "failed: {{reason}}",
        ),
    ],
    shows="QoS swaps begun, and those that failed, by reason.",
    bad="any failure but superseded (a newer plan came first); many swaps without a change of the link.",
    then="unmatched and incompatible: a reader requests what no writer can offer. undelivered: the link was too "
    "slow to drain the old writer.",
)

_PLAN_REACHES = bars(
    "The plan reaches the nodes",
    [
        query("sum(increase(arpd_applies_total{}[$__rate_interval]))", "plans sent"),
        query("sum by (reason) (increase(arpd_apply_failures_total{}[$__rate_interval]))", "failed: {{reason}}"),
    ],
    shows="Plans sent to nodes, and those that failed.",
    bad="timeout or unreachable again and again: a node hangs, or its executor does not spin.",
    then="look at that node's log; the other nodes have their plan.",
)

_GENERATIONS = timeseries(
    "Publishers that follow the plan",
    [
        query("arpd_publishers_managed{}", "managed"),
        query("arpd_publishers_confirmed{}", "confirmed"),
        query("sum(arpd_publishers_refused{})", "refused"),
    ],
    COUNT,
    shows="Publishers that the plan covers, that announce it, and that are refused.",
    bad="confirmed below managed for more than ten seconds.",
    then="see 'Publishers refused' and 'The plan reaches the nodes'.",
    is_step=True,
    colours={"managed": GREY, "confirmed": GREEN, "refused": VERMILLION},
)


def _phase_quantile(share: float) -> str:
    counts = "sum by (le, phase) (increase(arpd_swap_phase_duration_seconds_bucket{}[$__range]))"
    none = "0 * sum by (phase) (increase(arpd_swap_phase_duration_seconds_count{}[$__range]))"
    return f"histogram_quantile({share}, {counts}) >= 0 or {none}"


_PHASE_TIMES = ranking(
    "Time in each phase of a swap",
    [instant(_phase_quantile(0.5), "{{phase}}, half"), instant(_phase_quantile(0.95), "{{phase}}, 95 %")],
    Scale("s", limits=(3.6, 5)),
    shows="Median and 95th percentile of each phase over the time shown; 0 for phases without a swap. Matching "
    "takes at least 3 s, so that every reader is matched, and the old writer publishes meanwhile.",
    bad="matching above 5 s; holding near 0.3 s, because samples wait; draining near 4 s.",
    then="long draining: the link is full. Long matching: discovery is slow, look at the peer's CPU.",
)

_WRITER_COST = ranking(
    "Topics that spent longest in swaps",
    [
        instant(
            f"topk(10, sum by (topic) (increase(arpd_topic_swap_phase_seconds_total{{{_TOPIC}}}[$__range])))",
            "{{topic}}",
        )
    ],
    Scale("s"),
    shows="Time that the ten busiest topics spent in swaps, over the time shown.",
    bad="one topic far above the others.",
    then="its source or its readers change all the time; give it a fixed rate.",
)
