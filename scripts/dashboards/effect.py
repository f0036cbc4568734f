"""The robot's dashboard, third part: did it help, in all and topic by topic."""

from __future__ import annotations

from scripts.dashboards.document import Section, evenly
from scripts.dashboards.panels import (
    BAD_TO_GOOD,
    COUNT,
    QUEUE_DELAY,
    Column,
    Scale,
    instant,
    query,
    repeated,
    stat,
    table,
    timeseries,
)
from scripts.dashboards.states import BLUE, GREEN, GREY, ORANGE, PINK, RATE_BINDING, VERMILLION

_TOPIC = 'topic=~"$topic"'
_HERTZ = Scale("hertz", 1)
_DROPPED = "sum(rate(arpd_interface_transmit_dropped_packets_total{}[$__rate_interval]))"


def effect() -> Section:
    """Return the section on the samples: kept, withheld, lost, late."""
    numbers = (
        (4, _OUTAGE_SHARE),
        (4, _WORST_DELAY),
        (4, _LINK_USED),
        (4, _SAMPLES_SENT),
        (4, _DEADLINES_MISSED_NOW),
        (4, _LOST_NOW),
    )
    return Section(
        title="Did it help?",
        lines=(
            (4, numbers),
            (11, evenly(_TOPICS)),
            (9, evenly(_KEPT, _WITHHELD)),
            (8, evenly(_DEADLINES_MISSED, _COMMANDS, _LOST, _WAITING)),
        ),
    )


def each_topic() -> Section:
    """Return the section with a chart for each chosen topic."""
    return Section(
        title="Each topic: what its source gives, what the price allows, what leaves",
        lines=((7, ((24, repeated(_ONE_TOPIC, "topic")),)),),
        is_collapsed=True,
    )


_OUTAGE_SHARE = stat(
    "Time in outage",
    [instant('avg_over_time(arpd_link_state{state="outage"}[$__range])', "outage")],
    Scale("percentunit", 1, (0.001, 0.05)),
    shows="Part of the time shown in which the link carried nothing. After ten seconds without any "
    "peer it ends: arpd then measures alone.",
    bad="anything above 0 on a robot that stays in range.",
    then="see 'Link and plan' for when, and whether the capacity was measured alone afterwards.",
)

_WORST_DELAY = stat(
    "Queue delay, 95 % below",
    [instant("quantile_over_time(0.95, arpd_link_queue_delay_seconds{}[$__range])", "delay")],
    QUEUE_DELAY,
    shows="The queue delayed packets by less than this in 95 % of the time shown.",
    bad="above 0.1 s: commands and sensors are late by as much.",
    then="lower link.headroom; look for cross traffic.",
)

_LINK_USED = stat(
    "Link used",
    [
        instant(
            "avg_over_time(arpd_link_delivery_rate_bytes_per_second{}[$__range])"
            " / avg_over_time(arpd_link_capacity_bytes_per_second{}[$__range])",
            "used",
        )
    ],
    Scale("percentunit", 0),
    shows="What arrived as a share of what the link could carry, over the time shown.",
    bad="low while topics are limited by the link: the estimate is too low, or the budget is.",
    then="compare with 'What limits the rate of each topic'; all green there means the sources have no more.",
)

_SAMPLES_SENT = stat(
    "Samples sent",
    [
        instant(
            f"sum(increase(arpd_topic_published_messages_total{{{_TOPIC}}}[$__range]))"
            f" / sum(increase(arpd_topic_offered_messages_total{{{_TOPIC}}}[$__range]))",
            "sent",
        )
    ],
    Scale("percentunit", 0, (0.1, 0.5), BAD_TO_GOOD),
    shows="Share of the applications' messages that was written to the link, over the time shown.",
    bad="less than expected for this link. Withheld samples are the older ones; the fresh ones leave.",
    then="'Kept of what each source gives' shows which topics pay.",
)

_DEADLINES_MISSED_NOW = stat(
    "Deadlines missed",
    [instant(f"sum(increase(arpd_topic_deadlines_missed_total{{{_TOPIC}}}[$__range]))", "missed")],
    Scale("short", 0, (1, 100)),
    shows="Deadlines that publishers offered and missed in the time shown.",
    bad="a growing number on a steady link. A budget far below what the plan was made for makes topics miss deadlines.",
    then="'Deadlines missed by topic' says which; raise program.deadline_slack if the sources are unsteady.",
)

_LOST_NOW = stat(
    "Lost on the link",
    [query("arpd_link_loss_ratio{}", "lost")],
    Scale("percentunit", 1, (0.01, 0.1)),
    shows="Share of recent probe packets that never arrived; empty while too few were sent.",
    bad="above 1 %: RELIABLE topics send lost samples again, and that fills the link.",
    then="improve the radio: distance, channel, antenna. arpd cannot.",
    missing="not known",
)


def _of(metric: str, *, by: str = "topic, node, direction", condition: str = "") -> str:
    return f"max by ({by}) ({metric}{{{_TOPIC}}}{condition})"


_TOPICS = table(
    "Topics now",
    (
        Column(title="Topic", label="topic"),
        Column(title="Node", label="node"),
        Column(title="Direction", label="direction", width=100),
        Column(title="Source", expression=_of("arpd_topic_source_rate_hertz"), scale=_HERTZ, width=100),
        Column(
            title="Allowed",
            expression=_of("arpd_topic_paced_rate_hertz", condition=" < +Inf"),
            scale=_HERTZ,
            missing="unpaced",
            width=100,
        ),
        Column(title="Published", expression=_of("arpd_topic_published_rate_hertz"), scale=_HERTZ, width=100),
        Column(title="Share", expression=_of("arpd_topic_share_ratio"), scale=Scale("percentunit", 1), width=90),
        Column(
            title="Limited by",
            label="binding",
            expression=_of("arpd_topic_rate_binding", by="topic, node, direction, binding", condition=" == 1"),
            states=RATE_BINDING,
            width=210,
        ),
        Column(title="Depth", expression=_of("arpd_topic_confirmed_depth_samples"), scale=COUNT, width=80),
        Column(
            title="Deadline",
            expression=_of("arpd_topic_confirmed_deadline_seconds", condition=" < +Inf"),
            scale=Scale("s", 3),
            missing="none",
            width=100,
        ),
        Column(title="Payload", expression=_of("arpd_topic_payload_bytes"), scale=Scale("bytes", 1), width=100),
    ),
    shows="Each publisher: what its source gives, what the price allows, what leaves, and what limits it. "
    "'unpaced' has no limit.",
    bad="published far below allowed while the source gives more: the writer blocks.",
    then="look at 'Waiting and blocked'; weights and floors move allowed rates.",
    sort_by="Share",
    is_descending=True,
)


_KEPT = timeseries(
    "Kept of what each source gives",
    [
        query(
            f"sum by (topic, node) (arpd_topic_published_rate_hertz{{{_TOPIC}}})"
            f" / (sum by (topic, node) (arpd_topic_source_rate_hertz{{{_TOPIC}}}) > 0)",
            "{{topic}} {{node}}",
        )
    ],
    Scale("percentunit", 0),
    shows="Published rate as a share of the application's rate.",
    bad="a topic that matters below the others.",
    then="raise its weight or min_rate_hz.",
    is_table=True,
)

_WITHHELD = timeseries(
    "Withheld by cause",
    [query(f"sum by (cause) (rate(arpd_topic_withheld_messages_total{{{_TOPIC}}}[$__rate_interval]))", "{{cause}}")],
    Scale("cps", 1),
    shows="Messages that publishers withheld, by cause: the price of the link, the ceiling (rate), a writer that "
    "blocked, a write that failed, a publisher that closed.",
    bad="any blocked or failed. price and rate are arpd at work.",
    then="blocked: a reader does not keep up, or the link loses what RELIABLE repeats. failed: the node's log.",
    is_stacked=True,
    is_table=True,
    colours={"price": BLUE, "rate": ORANGE, "blocked": VERMILLION, "failed": PINK, "closed": GREY},
)

_DEADLINES_MISSED = timeseries(
    "Deadlines missed by topic",
    [query(f"sum by (topic) (rate(arpd_topic_deadlines_missed_total{{{_TOPIC}}}[$__rate_interval]))", "{{topic}}")],
    Scale("cps", 2),
    shows="Offered deadlines missed by each topic's publishers.",
    bad="steady misses on a steady link; some are normal when the link falls, at a swap and in an outage.",
    then="raise program.deadline_slack, or lower the rate the source claims.",
)

_COMMANDS = timeseries(
    "Commands on their way back",
    [query("arpd_link_return_delay_seconds{}", "return delay")],
    Scale("s", 3, (0.1, 0.2)),
    shows="Delay from the peer to the robot above its minimum: the time that a command waits.",
    bad="above 0.1 s: the robot drives on old commands.",
    then="something fills the way back; see 'received' of the link interface.",
    colours={"return delay": BLUE},
)

_LOST = timeseries(
    "Lost on the way",
    [
        query("arpd_link_loss_ratio{}", "lost on the link"),
        query(
            f"{_DROPPED} / (({_DROPPED} + sum(rate(arpd_interface_transmit_packets_total{{}}[$__rate_interval]))) > 0)",
            "dropped by the interface",
        ),
    ],
    Scale("percentunit", 2, (0.01, 0.1)),
    shows="Share of probe packets lost on the link, and of packets that the robot's own interface dropped.",
    bad="above 1 %.",
    then="dropped: the interface's queue is too short or the link too full; lost: improve the radio.",
)

_WAITING = timeseries(
    "Waiting and blocked",
    [
        query(f"sum(arpd_topic_queued_messages{{{_TOPIC}}})", "messages waiting"),
        query(
            f"sum(rate(arpd_topic_publish_blocked_seconds_total{{{_TOPIC}}}[$__rate_interval]))",
            "blocked, seconds per second",
        ),
    ],
    Scale("short", 2),
    shows="Messages in the pacing queues, and the time that publishers spent inside publish().",
    bad="blocked above 0.1 s per second: the middleware's queues are full.",
    then="see 'Queue delay' and 'Withheld by cause'; a reader that stopped reading blocks RELIABLE writers.",
    colours={"messages waiting": BLUE, "blocked, seconds per second": VERMILLION},
)

_ONE_TOPIC = timeseries(
    "$topic",
    [
        query(f"sum(arpd_topic_source_rate_hertz{{{_TOPIC}}})", "source"),
        query(f"sum(arpd_topic_paced_rate_hertz{{{_TOPIC}}} < +Inf)", "allowed"),
        query(f"sum(arpd_topic_published_rate_hertz{{{_TOPIC}}})", "published"),
    ],
    _HERTZ,
    shows="Rates of this topic: of its source, as the price allows (none while unpaced), and as published.",
    bad="published below allowed while the source is above it.",
    then="look at 'Waiting and blocked'.",
    colours={"source": GREY, "allowed": PINK, "published": GREEN},
)
