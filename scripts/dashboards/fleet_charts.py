"""Charts of all robots, one line for each."""

from __future__ import annotations

from typing import TYPE_CHECKING

from scripts.dashboards.document import Section, evenly
from scripts.dashboards.panels import QUEUE_DELAY, Scale, bars, query, timeseries

if TYPE_CHECKING:
    from typing import Unpack

    from scripts.dashboards.panels import Advice, Json

# Filled in with where job and instance come from.
TO_ROBOT = "/d/arpd-robot?var-datasource=${datasource}&var-job=%s&var-instance=%s&${__url_time_range}"
FROM_SERIES = {
    "targetBlank": False,
    "title": "Open ${__field.labels.instance}",
    "url": TO_ROBOT % ("${__field.labels.job}", "${__field.labels.instance}"),
}
ROBOT = "job, instance"


def links() -> Section:
    """Return the section on what the links carry."""
    return Section(
        title="Links", lines=((8, evenly(_CAPACITY, _QUEUE_DELAY)), (8, evenly(_ADMITTED, _LOST, _RETURN_DELAY)))
    )


def remedies() -> Section:
    """Return the section on what arpd does."""
    return Section(
        title="What arpd does about it",
        lines=((8, evenly(_PLANS, _KEPT, _WITHHELD)), (8, evenly(_FAILURES, _DEADLINES_MISSED, _EVENTS))),
    )


def daemons() -> Section:
    """Return the section on the daemons themselves."""
    return Section(title="The daemons", lines=((8, evenly(_TICK, _CPU, _MEMORY)),))


def _lines(title: str, expression: str, scale: Scale, **advice: Unpack[Advice]) -> Json:
    return timeseries(title, [query(expression, "{{instance}}")], scale, links=(FROM_SERIES,), **advice)


_CAPACITY = _lines(
    "Capacity of each robot",
    "8 * arpd_link_capacity_bytes_per_second{}",
    Scale("bps", 1),
    shows="What each link carries by arpd's estimate, in wire bits per second.",
    bad="all fall together: they share a channel. One falls alone: its place or its radio.",
    then="click a robot to open it at this time.",
)

_QUEUE_DELAY = _lines(
    "Queue delay of each robot",
    "arpd_link_queue_delay_seconds{}",
    QUEUE_DELAY,
    shows="One-way delay above its minimum of the last ten seconds.",
    bad="plateaus above 0.1 s.",
    then="click a robot to open it at this time.",
)

_ADMITTED = _lines(
    "Admitted, each robot",
    "arpd_gate_ratio{}",
    Scale("percentunit", 0, most=1),
    shows="Part of the traffic above the floors that fits into the robot's budget; 100 %: no topic is slowed.",
    bad="far below the other robots; at 0 % only floors are left.",
    then="click a robot to open it at this time.",
)

_LOST = _lines(
    "Lost on the link of each robot",
    "arpd_link_loss_ratio{}",
    Scale("percentunit", 2, (0.01, 0.1)),
    shows="Share of probe packets that never arrived; nothing while too few were sent.",
    bad="above 1 %.",
    then="improve that robot's radio: distance, channel, antenna.",
)

_RETURN_DELAY = _lines(
    "Commands on their way back, each robot",
    "arpd_link_return_delay_seconds{}",
    Scale("s", 3, (0.1, 0.2)),
    shows="Delay from the peer to the robot above its minimum.",
    bad="above 0.1 s: the robot drives on old commands.",
    then="click a robot to open it at this time.",
)


def _often(title: str, metric: str, matchers: str = "", **advice: Unpack[Advice]) -> Json:
    expression = f"sum by ({ROBOT}) (increase({metric}{{{matchers}}}[$__rate_interval]))"
    return bars(title, [query(expression, "{{instance}}")], links=(FROM_SERIES,), **advice)


_PLANS = _often(
    "New plans of each robot",
    "arpd_plans_total",
    shows="Plans made, for any cause.",
    bad="more than two a minute for minutes: that robot's plan flaps.",
    then="click a robot to open it and see 'New plans'.",
)

_KEPT = _lines(
    "Samples sent by each robot",
    f"sum by ({ROBOT}) (rate(arpd_topic_published_messages_total{{}}[$__rate_interval]))"
    f" / (sum by ({ROBOT}) (rate(arpd_topic_offered_messages_total{{}}[$__rate_interval])) > 0)",
    Scale("percentunit", 0),
    shows="Share of the applications' messages that was written to the link.",
    bad="one robot far below its usual.",
    then="click a robot to open it at this time.",
)

_WITHHELD = _lines(
    "Withheld by a writer that blocked or failed",
    f'sum by ({ROBOT}) (rate(arpd_topic_withheld_messages_total{{cause=~"blocked|failed"}}[$__rate_interval]))',
    Scale("cps", 2),
    shows="Messages withheld because a writer blocked or a write failed; arpd did not choose that.",
    bad="any, for more than a few seconds.",
    then="click a robot to open it and see 'Withheld by cause'.",
)

_FAILURES = _often(
    "Swaps that failed, each robot",
    "arpd_topic_swap_failures_total",
    'reason!="superseded"',
    shows="QoS swaps that failed, without superseded ones (a newer plan came first).",
    bad="any, again and again.",
    then="click a robot to open it and see 'Swaps'.",
)

_DEADLINES_MISSED = _lines(
    "Deadlines missed by each robot",
    f"sum by ({ROBOT}) (rate(arpd_topic_deadlines_missed_total{{}}[$__rate_interval]))",
    Scale("cps", 2),
    shows="Deadlines that publishers offered and missed.",
    bad="steady misses.",
    then="click a robot to open it and see 'Deadlines missed by topic'.",
)

_EVENTS = _often(
    "Events that need attention",
    "arpd_events_total",
    'event=~"outage|peer_lost|swap_failed|reload_failed|infeasible"',
    shows="Outages, lost peers, failed swaps and reloads, floors given up.",
    bad="any that comes back.",
    then="click a robot to open it; its page says each event in a sentence.",
)

_TICK = _lines(
    "Time a tick takes, 99 % below",
    f"histogram_quantile(0.99, sum by (le, {ROBOT}) (rate(arpd_tick_duration_seconds_bucket{{}}[$__rate_interval])))",
    Scale("s", 4, (0.05, 0.1)),
    shows="99 % of each daemon's ticks take less than this.",
    bad="above 0.05 s: a tick has 0.1 s.",
    then="that computer is too busy, or has too many topics.",
)

_CPU = _lines(
    "CPU of each daemon",
    "rate(process_cpu_seconds_total{}[$__rate_interval])",
    Scale("percentunit", 1),
    shows="Part of one core that each daemon uses.",
    bad="one far above the others.",
    then="click a robot to open it and see 'The daemon itself'.",
)

_MEMORY = _lines(
    "Memory of each daemon",
    "process_resident_memory_bytes{}",
    Scale("bytes", 0),
    shows="Resident memory of each daemon.",
    bad="one that grows for hours.",
    then="please report it, with `arpd status --json`.",
)
