"""The robot's dashboard, second part: why arpd decided so."""

from __future__ import annotations

from typing import TYPE_CHECKING

from scripts.dashboards.document import Section
from scripts.dashboards.panels import (
    Advice,
    bars,
    query,
    timeline,
    timeseries,
)
from scripts.dashboards.states import (
    BLUE,
    DEPTH_BINDING,
    GREEN,
    GREY,
    RATE_BINDING,
    VERMILLION,
)

if TYPE_CHECKING:
    from scripts.dashboards.panels import Json


def why() -> Section:
    """Return the section that explains the decision."""
    return Section(
        title="Why did it decide so?",
        lines=(
            (10, ((12, _bound_by()), (12, _shares()))),
            (8, ((6, _estimate_age()), (6, _estimator_events()), (6, _new_plans()), (6, _plans_refused()))),
            (8, ((6, _depth_bound_by()), (6, _publishers_refused()), (6, _peers()), (6, _interface()))),
        ),
    )


def _bound_by() -> Json:
    return timeline(
        "What limits the rate of each topic",
        Advice(
            shows="The constraint that keeps each topic from a higher rate.",
            bad="floor (the link does not even carry the least it asked for), or link on a topic that matters.",
            then="raise its weight, lower floors of others, or make its messages smaller.",
        ),
        [(query(RATE_BINDING.expression("topic, node", 'topic=~"$topic"'), "{{topic}} {{node}}"), RATE_BINDING)],
    )


def _depth_bound_by() -> Json:
    return timeline(
        "What limits the depth of each topic",
        Advice(
            shows="The constraint that keeps each topic from a deeper history.",
            bad="memory.",
            then="raise program.memory_budget, or lower max_depth of topics with large messages.",
        ),
        [(query(DEPTH_BINDING.expression("topic, node", 'topic=~"$topic"'), "{{topic}} {{node}}"), DEPTH_BINDING)],
    )


def _shares() -> Json:
    return timeseries(
        "Share of link time each topic gets",
        Advice(
            shows="What part of the link's time the plan gives to each topic; together at most the headroom.",
            bad="a topic of little use that takes much.",
            then="lower its weight or its max_rate_hz.",
        ),
        [query('sum by (topic, node) (arpd_topic_share_ratio{topic=~"$topic"})', "{{topic}} {{node}}")],
        unit="percentunit",
        decimals=1,
        is_stacked=True,
        is_step=True,
        is_table=True,
    )


def _estimate_age() -> Json:
    return timeseries(
        "Age of the estimate",
        Advice(
            shows="Time since the evidence behind the capacity, and since the last report of each peer.",
            bad="reports older than 1 s, or an estimate older than a minute: a change of the link would go unseen.",
            then="see whether arpd-peer runs on the other end and reaches the robot.",
        ),
        [
            query("arpd_link_estimate_age_seconds{}", "estimate"),
            query("arpd_peer_report_age_seconds{}", "report of {{peer}}"),
        ],
        unit="s",
        decimals=1,
        limits=(30, 60),
    )


def _estimator_events() -> Json:
    return bars(
        "Changes of the estimate",
        Advice(
            shows="How often each rule changed the capacity: down on a queue, undo when that was wrong, agree and "
            "carried as the link shows more, outage and resume.",
            bad="down and undo in turn: delay comes and goes without the capacity doing so.",
            then="look for another sender in bursts (foreign traffic), or a radio that roams.",
        ),
        [query("sum by (event) (increase(arpd_estimator_events_total{}[$__rate_interval]))", "{{event}}")],
    )


def _new_plans() -> Json:
    return bars(
        "New plans",
        Advice(
            shows="Plans made, by what caused them.",
            bad="down and up in turn, more than two a minute: the plan flaps.",
            then="it calms down by itself, as the time between plans doubles up to 40 s; else lower link.headroom.",
        ),
        [query("sum by (cause) (increase(arpd_levels_total{}[$__rate_interval]))", "{{cause}}")],
    )


def _plans_refused() -> Json:
    return bars(
        "Plan changes refused",
        Advice(
            shows="Ticks in which another plan was wanted, but too soon after the last (dwell) or beyond the swaps "
            "allowed per minute (budget).",
            bad="budget at all; dwell for minutes.",
            then="dwell passes by itself; raise governor.swaps_per_minute if swaps are quick.",
        ),
        [query("sum by (reason) (increase(arpd_refusals_total{}[$__rate_interval]))", "{{reason}}")],
    )


def _publishers_refused() -> Json:
    return timeseries(
        "Publishers refused",
        Advice(
            shows="Publishers that do not take the QoS asked of them, by reason. middleware and transient_local last: "
            "these are paced and gated only.",
            bad="incompatible, unmatched or failed.",
            then="arpd status names publisher and reader; most often a reader requests a deadline nobody can offer.",
        ),
        [query("arpd_publishers_refused{}", "{{reason}}")],
        unit="short",
        decimals=0,
        is_step=True,
        is_stacked=True,
    )


def _peers() -> Json:
    return timeseries(
        "Peers and topics",
        Advice(
            shows="Peers heard in the last minute, topics that cross the link, and those that the plan covers.",
            bad="no peer; far fewer topics planned than cross the link.",
            then="start arpd-peer on the other end; put missing topics under relay.topics, or use AdaptivePublisher.",
        ),
        [
            query("arpd_peers{}", "peers"),
            query("sum(arpd_graph_topics{})", "topics that cross"),
            query("arpd_plan_topics{}", "topics planned"),
        ],
        unit="short",
        decimals=0,
        is_step=True,
        colours={"peers": VERMILLION, "topics that cross": GREY, "topics planned": GREEN},
    )


def _interface() -> Json:
    return timeseries(
        "Link interface",
        Advice(
            shows="Everything the interface sends and receives, arpd's or not.",
            bad="sending above the capacity, or packets dropped on the way out.",
            then="find the sender that arpd does not know (`ss`, `nethogs`); see 'Lost on the way' for drops.",
        ),
        [
            query("8 * sum(rate(arpd_interface_transmit_bytes_total{}[$__rate_interval]))", "sent"),
            query("8 * sum(rate(arpd_interface_receive_bytes_total{}[$__rate_interval]))", "received"),
        ],
        unit="bps",
        decimals=1,
        colours={"sent": GREEN, "received": BLUE},
    )
