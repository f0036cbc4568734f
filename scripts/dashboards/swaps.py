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
        lines=((8, evenly(_SWAPS, _PLAN_REACHES, _GENERATIONS)), (8, evenly(_PHASE_TIMES, _SWAP_COST, _READERS))),
    )


_SWAPS = bars(
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
    then="unmatched and incompatible: a reader requests what cannot be offered. undelivered: the link was too "
    "slow to drain the old writer.",
)

_PLAN_REACHES = bars(
    "The plan reaches the nodes",
    [
        query("sum(increase(arpd_applies_total{}[$__rate_interval]))", "calls"),
        query("sum by (reason) (increase(arpd_apply_failures_total{}[$__rate_interval]))", "failed: {{reason}}"),
    ],
    shows="Calls that set the parameters of a node, and those that failed.",
    bad="timeout or unreachable again and again: a node hangs, or its executor does not spin.",
    then="look at that node's log; the others have their plan meanwhile.",
)

_GENERATIONS = timeseries(
    "Publishers that follow the plan",
    [
        query("arpd_publishers_managed{}", "managed"),
        query("arpd_publishers_confirmed{}", "confirmed"),
        query("sum(arpd_publishers_refused{})", "refused"),
    ],
    COUNT,
    shows="Publishers the plan covers, those that announce it, and those that stand refused.",
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
    shows="Median, and what 95 % stay below, of each phase over the time shown; 0 where no swap was in it. "
    "Matching takes 3 s at least, so that every reader is there, and publishing goes on meanwhile.",
    bad="matching above 5 s; holding near 0.3 s, for samples wait meanwhile; draining near 4 s.",
    then="long draining: the link is full. Long matching: discovery is slow, look at the peer's CPU.",
)

_SWAP_COST = ranking(
    "Topics that spent longest in swaps",
    [
        instant(
            f"topk(10, sum by (topic) (increase(arpd_topic_swap_phase_seconds_total{{{_TOPIC}}}[$__range])))",
            "{{topic}}",
        )
    ],
    Scale("s"),
    shows="Seconds that the ten busiest topics spent in swaps in the time shown.",
    bad="one topic far above the others.",
    then="its source or its readers change all the time; widen governor.deadband, or give it a fixed rate.",
)


def _reader_swaps(result: str) -> str:
    return f"sum(increase(arpd_reader_handovers_total{{{_TOPIC}, {result}}}[$__rate_interval])) or vector(0)"


_READERS = bars(
    "Handovers of readers",
    [query(_reader_swaps('result="ok"'), "replaced"), query(_reader_swaps('result!="ok"'), "failed")],
    shows="Readers of AdaptiveSubscriptions that were replaced by one of other QoS, or should have been.",
    bad="failed, again and again.",
    then="see the log of the reader's node.",
)
