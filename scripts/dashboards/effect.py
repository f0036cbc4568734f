"""The robot's dashboard, third part: did it help, in all and topic by topic."""

from __future__ import annotations

from typing import TYPE_CHECKING

from scripts.dashboards.document import Section
from scripts.dashboards.panels import (
    BAD_TO_GOOD,
    Advice,
    Column,
    instant,
    query,
    repeated,
    stat,
    table,
    timeseries,
)
from scripts.dashboards.states import BLUE, GREEN, GREY, ORANGE, PINK, RATE_BINDING, VERMILLION

if TYPE_CHECKING:
    from scripts.dashboards.panels import Json

_TOPIC = 'topic=~"$topic"'
_DROPPED = "sum(rate(arpd_interface_transmit_dropped_packets_total{}[$__rate_interval]))"


def effect() -> Section:
    """Return the section on what became of the samples."""
    numbers = (
        (4, _outage_share()),
        (4, _worst_delay()),
        (4, _link_used()),
        (4, _samples_sent()),
        (4, _deadlines_missed_now()),
        (4, _lost_now()),
    )
    return Section(
        title="Did it help?",
        lines=(
            (4, numbers),
            (11, ((24, _topics()),)),
            (9, ((12, _kept()), (12, _drops()))),
            (8, ((6, _deadlines_missed()), (6, _commands()), (6, _lost()), (6, _waiting()))),
        ),
    )


def each_topic() -> Section:
    """Return the section with a chart for each chosen topic."""
    return Section(
        title="Each topic: what its source gives, what the plan allows, what leaves",
        lines=((7, ((24, repeated(_one_topic(), "topic")),)),),
        is_collapsed=True,
    )


def _outage_share() -> Json:
    return stat(
        "Time in outage",
        Advice(
            shows="Part of the time shown in which the link carried nothing. Ten seconds without any peer end it: "
            "from then on arpd measures alone.",
            bad="anything above 0 on a robot that stays in range.",
            then="see 'Link and plan' for when, and whether the capacity was measured alone afterwards.",
        ),
        [instant('avg_over_time(arpd_link_state{state="outage"}[$__range])', "outage")],
        unit="percentunit",
        decimals=1,
        limits=(0.001, 0.05),
    )


def _worst_delay() -> Json:
    return stat(
        "Queue delay, 95 % below",
        Advice(
            shows="In 95 % of the time shown the queue delayed packets by less than this.",
            bad="above 0.1 s: commands and sensors are late by as much.",
            then="lower link.headroom; look for foreign traffic.",
        ),
        [instant("quantile_over_time(0.95, arpd_link_queue_delay_seconds{}[$__range])", "delay")],
        unit="s",
        decimals=3,
        limits=(0.1, 0.25),
    )


def _link_used() -> Json:
    return stat(
        "Link used",
        Advice(
            shows="What arrived, as a part of what the link could carry, over the time shown.",
            bad="low while topics are limited by the link: the estimate is too low, or plans rise late.",
            then="compare with 'What limits the rate of each topic'; all green there means the sources have no more.",
        ),
        [
            instant(
                "avg_over_time(arpd_link_delivery_rate_bytes_per_second{}[$__range])"
                " / avg_over_time(arpd_link_capacity_bytes_per_second{}[$__range])",
                "used",
            )
        ],
        unit="percentunit",
        decimals=0,
    )


def _samples_sent() -> Json:
    return stat(
        "Samples sent",
        Advice(
            shows="Of the messages that applications gave in the time shown, those written to the link.",
            bad="less than expected for this link. Withheld samples are the older ones: what leaves is fresh.",
            then="'Kept of what each source gives' shows which topics pay.",
        ),
        [
            instant(
                f"sum(increase(arpd_topic_published_messages_total{{{_TOPIC}}}[$__range]))"
                f" / sum(increase(arpd_topic_offered_messages_total{{{_TOPIC}}}[$__range]))",
                "sent",
            )
        ],
        unit="percentunit",
        decimals=0,
        limits=(0.1, 0.5),
        colours=BAD_TO_GOOD,
    )


def _deadlines_missed_now() -> Json:
    return stat(
        "Deadlines missed",
        Advice(
            shows="Deadlines that publishers offered and missed in the time shown.",
            bad="more and more while the gate is open; a gate below 100 % makes topics miss what their plan offered.",
            then="'Deadlines missed by topic' says which; raise program.deadline_slack if the sources are unsteady.",
        ),
        [instant(f"sum(increase(arpd_topic_deadlines_missed_total{{{_TOPIC}}}[$__range]))", "missed")],
        unit="short",
        decimals=0,
        limits=(1, 100),
    )


def _lost_now() -> Json:
    return stat(
        "Lost on the link",
        Advice(
            shows="Share of the probe packets of late that never arrived; empty while too few were sent to tell.",
            bad="above 1 %: reliable topics repeat themselves and so fill the link.",
            then="improve the radio: distance, channel, antenna. arpd cannot.",
        ),
        [query("arpd_link_loss_ratio{}", "lost")],
        unit="percentunit",
        missing="not known",
        decimals=1,
        limits=(0.01, 0.1),
    )


def _topics() -> Json:
    def of(metric: str, *, by: str = "topic, node, direction", condition: str = "") -> str:
        return f"max by ({by}) ({metric}{{{_TOPIC}}}{condition})"

    return table(
        "Topics now",
        Advice(
            shows="Each publisher: what its source gives, what the plan allows, what leaves, and what limits it. "
            "'unpaced' has no limit.",
            bad="published far below planned while the source gives more: the gate is low, or the writer blocks.",
            then="look at gate and 'Waiting and blocked'; weights and floors move planned rates.",
        ),
        (
            Column(title="Topic", label="topic"),
            Column(title="Node", label="node"),
            Column(title="Direction", label="direction", width=100),
            Column(title="Source", expression=of("arpd_topic_source_rate_hertz"), unit="hertz", decimals=1, width=100),
            Column(
                title="Planned",
                expression=of("arpd_topic_planned_rate_hertz", condition=" < +Inf"),
                unit="hertz",
                decimals=1,
                missing="unpaced",
                width=100,
            ),
            Column(
                title="Published", expression=of("arpd_topic_published_rate_hertz"), unit="hertz", decimals=1, width=100
            ),
            Column(title="Share", expression=of("arpd_topic_share_ratio"), unit="percentunit", decimals=1, width=90),
            Column(
                title="Limited by",
                label="binding",
                expression=of("arpd_topic_rate_binding", by="topic, node, direction, binding", condition=" == 1"),
                states=RATE_BINDING,
                width=210,
            ),
            Column(title="Depth", expression=of("arpd_topic_confirmed_depth_samples"), decimals=0, width=80),
            Column(
                title="Deadline",
                expression=of("arpd_topic_confirmed_deadline_seconds", condition=" < +Inf"),
                unit="s",
                decimals=3,
                missing="none",
                width=100,
            ),
            Column(title="Payload", expression=of("arpd_topic_payload_bytes"), unit="bytes", decimals=1, width=100),
        ),
        sort_by="Share",
        is_descending=True,
    )


def _kept() -> Json:
    return timeseries(
        "Kept of what each source gives",
        Advice(
            shows="Published rate as a part of the rate at which the application publishes.",
            bad="a topic that matters below the others.",
            then="raise its weight or min_rate_hz.",
        ),
        [
            query(
                f"sum by (topic, node) (arpd_topic_published_rate_hertz{{{_TOPIC}}})"
                f" / (sum by (topic, node) (arpd_topic_source_rate_hertz{{{_TOPIC}}}) > 0)",
                "{{topic}} {{node}}",
            )
        ],
        unit="percentunit",
        decimals=0,
        is_table=True,
    )


def _drops() -> Json:
    return timeseries(
        "Drops by cause",
        Advice(
            shows="Messages not sent, by why: the plan's rate, the gate below it, a writer that blocked, a write that "
            "failed, a publisher that closed.",
            bad="blocked or failed at all; gate for longer than seconds. rate is arpd at work.",
            then="blocked: a reader does not keep up, or the link loses what RELIABLE repeats. failed: the node's log.",
        ),
        [query(f"sum by (cause) (rate(arpd_topic_drops_total{{{_TOPIC}}}[$__rate_interval]))", "{{cause}}")],
        unit="cps",
        decimals=1,
        is_stacked=True,
        is_table=True,
        colours={"rate": BLUE, "gate": ORANGE, "blocked": VERMILLION, "failed": PINK, "closed": GREY},
    )


def _deadlines_missed() -> Json:
    return timeseries(
        "Deadlines missed by topic",
        Advice(
            shows="Offered deadlines missed by each topic's publishers, and requested ones missed by adaptive readers.",
            bad="steady misses while the gate is open; at a swap, in an outage and under the gate they are expected.",
            then="raise program.deadline_slack, or lower the rate the source claims.",
        ),
        [
            query(
                f"sum by (topic) (rate(arpd_topic_deadlines_missed_total{{{_TOPIC}}}[$__rate_interval]))", "{{topic}}"
            ),
            query(
                f"sum(rate(arpd_reader_deadlines_missed_total{{{_TOPIC}}}[$__rate_interval])) or vector(0)",
                "readers of all topics",
            ),
        ],
        unit="cps",
        decimals=2,
    )


def _commands() -> Json:
    return timeseries(
        "Commands on their way back",
        Advice(
            shows="How much longer than at best the way from the peer to the robot takes: what a command waits.",
            bad="above 0.1 s: the robot drives on old commands.",
            then="something fills the way back; see 'received' of the link interface.",
        ),
        [
            query("arpd_link_return_delay_seconds{}", "return delay"),
        ],
        unit="s",
        decimals=3,
        limits=(0.1, 0.2),
        colours={"return delay": BLUE},
    )


def _lost() -> Json:
    return timeseries(
        "Lost on the way",
        Advice(
            shows="Share of probe packets lost on the link, and of packets that the robot's own interface dropped.",
            bad="above 1 %.",
            then="dropped: the interface's queue is too short or the link too full; lost: improve the radio.",
        ),
        [
            query("arpd_link_loss_ratio{}", "lost on the link"),
            query(
                f"{_DROPPED} / (({_DROPPED}"
                " + sum(rate(arpd_interface_transmit_packets_total{}[$__rate_interval]))) > 0)",
                "dropped by the interface",
            ),
        ],
        unit="percentunit",
        decimals=2,
        limits=(0.01, 0.1),
    )


def _waiting() -> Json:
    return timeseries(
        "Waiting and blocked",
        Advice(
            shows="Messages in the pacing queues, and the part of the time that publishers spent inside publish().",
            bad="blocked above 0.1 s per second: the middleware's queues are full.",
            then="see 'Queue delay' and 'Drops by cause'; a reader that stopped reading blocks RELIABLE writers.",
        ),
        [
            query(f"sum(arpd_topic_queued_messages{{{_TOPIC}}})", "messages waiting"),
            query(
                f"sum(rate(arpd_topic_publish_blocked_seconds_total{{{_TOPIC}}}[$__rate_interval]))",
                "blocked, seconds per second",
            ),
        ],
        unit="short",
        decimals=2,
        colours={"messages waiting": BLUE, "blocked, seconds per second": VERMILLION},
    )


def _one_topic() -> Json:
    return timeseries(
        "$topic",
        Advice(
            shows="Rates of this topic: of its source, of the plan (none while unpaced), and of what leaves.",
            bad="published below planned while the source is above it.",
            then="the gate is low then, or the writer blocks.",
        ),
        [
            query(f"sum(arpd_topic_source_rate_hertz{{{_TOPIC}}})", "source"),
            query(f"sum(arpd_topic_planned_rate_hertz{{{_TOPIC}}} < +Inf)", "planned"),
            query(f"sum(arpd_topic_published_rate_hertz{{{_TOPIC}}})", "published"),
        ],
        unit="hertz",
        decimals=1,
        colours={"source": GREY, "planned": PINK, "published": GREEN},
    )
