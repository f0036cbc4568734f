"""The robot's dashboard, second part: why arpd decided so."""

from __future__ import annotations

from scripts.dashboards.document import Section, evenly
from scripts.dashboards.panels import COUNT, Scale, bars, query, timeline, timeseries
from scripts.dashboards.states import BLUE, DEPTH_BINDING, GREEN, GREY, RATE_BINDING, VERMILLION


def why() -> Section:
    """Return the section that explains the decision."""
    return Section(
        title="Why did it decide so?",
        lines=(
            (10, evenly(_BOUND_BY, _SHARES)),
            (8, evenly(_ESTIMATE_AGE, _ESTIMATOR_EVENTS, _NEW_PLANS, _PLANS_REFUSED)),
            (8, evenly(_DEPTH_BOUND_BY, _PUBLISHERS_REFUSED, _PEERS, _INTERFACE)),
        ),
    )


_BOUND_BY = timeline(
    "What limits the rate of each topic",
    [(query(RATE_BINDING.expression("topic, node", 'topic=~"$topic"'), "{{topic}} {{node}}"), RATE_BINDING)],
    shows="The constraint that keeps each topic from a higher rate.",
    bad="floor (the link carries no more than that), or link on a topic that matters.",
    then="raise its weight, lower floors of others, or make its messages smaller.",
)

_DEPTH_BOUND_BY = timeline(
    "What limits the depth of each topic",
    [(query(DEPTH_BINDING.expression("topic, node", 'topic=~"$topic"'), "{{topic}} {{node}}"), DEPTH_BINDING)],
    shows="The constraint that keeps each topic from a deeper history.",
    bad="memory.",
    then="raise program.memory_budget, or lower max_depth of topics with large messages.",
)

_SHARES = timeseries(
    "Share of link time each topic gets",
    [query('sum by (topic, node) (arpd_topic_share_ratio{topic=~"$topic"})', "{{topic}} {{node}}")],
    Scale("percentunit", 1),
    shows="Share of link time that each topic gets now; together at most the headroom.",
    bad="a topic of little use that takes much.",
    then="lower its weight or its max_rate_hz.",
    is_stacked=True,
    is_step=True,
    is_table=True,
)

_ESTIMATE_AGE = timeseries(
    "Age of the estimate",
    [
        query("arpd_link_estimate_age_seconds{}", "estimate"),
        query("arpd_peer_report_age_seconds{}", "report of {{peer}}"),
    ],
    Scale("s", 1, (75, 150)),
    shows="Time since the evidence behind the capacity, and since the last report of each peer.",
    bad="reports older than 1 s, or an estimate older than 150 s: arpd would not see a change of the link.",
    then="see whether arpd-peer runs on the other end and reaches the robot.",
)

_ESTIMATOR_EVENTS = bars(
    "Changes of the estimate",
    [query("sum by (event) (increase(arpd_estimator_events_total{}[$__rate_interval]))", "{{event}}")],
    shows="How often the capacity changed, by kind: the first measurement, evidence of less (down) and of more (up), "
    "outages and their ends (resume), and what this host measures without a peer (local).",
    bad="down and up in turn, many times a minute: the evidence contradicts itself, or the link does swing.",
    then="look for cross traffic that comes in bursts, or a radio that roams.",
)

_NEW_PLANS = bars(
    "New plans",
    [query("sum by (cause) (increase(arpd_plans_total{}[$__rate_interval]))", "{{cause}}")],
    shows="Plans made, by cause.",
    bad="down and up in turn, more than two a minute: depths and deadlines flap.",
    then="rates do not need plans; lengthen governor.dwell and governor.hold, so that fewer writers are swapped.",
)

_PLANS_REFUSED = bars(
    "Plans and swaps that wait",
    [query("sum by (reason) (increase(arpd_refusals_total{}[$__rate_interval]))", "{{reason}}")],
    shows="How often a plan came too soon after the last one (dwell), or its swaps were beyond 1 % of the link "
    "(budget). Rates do not wait.",
    bad="dwell for minutes; budget for long with few topics.",
    then="both pass by themselves; fewer topics in a process make a swap cheaper.",
)

_PUBLISHERS_REFUSED = timeseries(
    "Publishers refused",
    [query("arpd_publishers_refused{}", "{{reason}}")],
    COUNT,
    shows="Publishers that do not take the QoS asked of them, by reason. middleware and transient_local are "
    "permanent: arpd only paces these.",
    bad="incompatible, unmatched or failed.",
    then="`arpd status` names publisher and reader; most often a reader requests a deadline that is too short.",
    is_step=True,
    is_stacked=True,
)

_PEERS = timeseries(
    "Peers and topics",
    [
        query("arpd_peers{}", "peers"),
        query("sum(arpd_graph_topics{})", "topics that cross"),
        query("arpd_plan_topics{}", "topics planned"),
    ],
    COUNT,
    shows="Peers heard in the last minute, topics that cross the link, and those that the plan covers.",
    bad="no peer; far fewer topics planned than cross the link.",
    then="start arpd-peer on the other end; put missing topics under relay.topics, or use AdaptivePublisher.",
    is_step=True,
    colours={"peers": VERMILLION, "topics that cross": GREY, "topics planned": GREEN},
)

_INTERFACE = timeseries(
    "Link interface",
    [
        query("8 * sum(rate(arpd_interface_transmit_bytes_total{}[$__rate_interval]))", "sent"),
        query("8 * sum(rate(arpd_interface_receive_bytes_total{}[$__rate_interval]))", "received"),
    ],
    Scale("bps", 1),
    shows="All that the interface sends and receives, cross traffic included.",
    bad="sending above the capacity, or packets dropped on the way out.",
    then="find the sender that arpd does not know (`ss`, `nethogs`); see 'Lost on the way' for drops.",
    colours={"sent": GREEN, "received": BLUE},
)
