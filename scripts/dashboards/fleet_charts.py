"""Charts of all robots, one line for each."""

from __future__ import annotations

from typing import TYPE_CHECKING

from scripts.dashboards.document import Section
from scripts.dashboards.panels import (
    Advice,
    bars,
    query,
    timeseries,
)

if TYPE_CHECKING:
    from scripts.dashboards.panels import Json

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
        title="Links",
        lines=(
            (8, ((12, _capacity()), (12, _queue_delay()))),
            (8, ((8, _gate()), (8, _lost()), (8, _return_delay()))),
        ),
    )


def remedies() -> Section:
    """Return the section on what arpd does."""
    return Section(
        title="What arpd does about it",
        lines=(
            (8, ((8, _plans()), (8, _kept()), (8, _drops()))),
            (8, ((8, _swap_failures()), (8, _deadlines_missed()), (8, _events()))),
        ),
    )


def daemons() -> Section:
    """Return the section on the daemons themselves."""
    return Section(title="The daemons", lines=((8, ((8, _tick()), (8, _cpu()), (8, _memory()))),))


def _lines(
    title: str,
    advice: Advice,
    expression: str,
    *,
    unit: str,
    decimals: int,
    limits: tuple[float, float] | None = None,
    most: float | None = None,
) -> Json:
    return timeseries(
        title,
        advice,
        [query(expression, "{{instance}}")],
        unit=unit,
        decimals=decimals,
        limits=limits,
        most=most,
        links=(FROM_SERIES,),
    )


def _capacity() -> Json:
    return _lines(
        "Capacity of each robot",
        Advice(
            shows="Bits per second that each link is believed to carry.",
            bad="all falling together: they share a channel. One alone: its place or its radio.",
            then="click a robot to open it at this time.",
        ),
        "8 * arpd_link_capacity_bytes_per_second{}",
        unit="bps",
        decimals=1,
    )


def _queue_delay() -> Json:
    return _lines(
        "Queue delay of each robot",
        Advice(
            shows="One-way delay above its minimum of the last ten seconds.",
            bad="plateaus above 0.1 s.",
            then="click a robot to open it at this time.",
        ),
        "arpd_link_queue_delay_seconds{}",
        unit="s",
        decimals=3,
        limits=(0.1, 0.25),
    )


def _gate() -> Json:
    return _lines(
        "Gate of each robot",
        Advice(
            shows="Factor on every paced rate above its floor.",
            bad="below 50 % for longer than seconds.",
            then="click a robot to open it at this time.",
        ),
        "arpd_gate_ratio{}",
        unit="percentunit",
        decimals=0,
        most=1,
    )


def _lost() -> Json:
    return _lines(
        "Lost on the link of each robot",
        Advice(
            shows="Share of probe packets that never arrived; nothing while too few were sent to tell.",
            bad="above 1 %.",
            then="improve that robot's radio: distance, channel, antenna.",
        ),
        "arpd_link_loss_ratio{}",
        unit="percentunit",
        decimals=2,
        limits=(0.01, 0.1),
    )


def _return_delay() -> Json:
    return _lines(
        "Commands on their way back, each robot",
        Advice(
            shows="How much longer than at best the way to the robot takes.",
            bad="above 0.1 s: the robot drives on old commands.",
            then="click a robot to open it at this time.",
        ),
        "arpd_link_return_delay_seconds{}",
        unit="s",
        decimals=3,
        limits=(0.1, 0.2),
    )


def _often(title: str, advice: Advice, metric: str, matchers: str = "") -> Json:
    expression = f"sum by ({ROBOT}) (increase({metric}{{{matchers}}}[$__rate_interval]))"
    return bars(title, advice, [query(expression, "{{instance}}")], links=(FROM_SERIES,))


def _plans() -> Json:
    return _often(
        "New plans of each robot",
        Advice(
            shows="Plans made, of whatever cause.",
            bad="more than two a minute for long: that robot's plan flaps.",
            then="click a robot to open it and see 'New plans'.",
        ),
        "arpd_levels_total",
    )


def _kept() -> Json:
    return _lines(
        "Samples sent by each robot",
        Advice(
            shows="Of the messages that applications gave, those written to the link.",
            bad="one robot far below its usual.",
            then="click a robot to open it at this time.",
        ),
        f"sum by ({ROBOT}) (rate(arpd_topic_published_messages_total{{}}[$__rate_interval]))"
        f" / (sum by ({ROBOT}) (rate(arpd_topic_offered_messages_total{{}}[$__rate_interval])) > 0)",
        unit="percentunit",
        decimals=0,
    )


def _drops() -> Json:
    return _lines(
        "Drops that arpd did not choose",
        Advice(
            shows="Messages not sent because a writer blocked or a write failed.",
            bad="any, for longer than seconds.",
            then="click a robot to open it and see 'Drops by cause'.",
        ),
        f'sum by ({ROBOT}) (rate(arpd_topic_drops_total{{cause=~"blocked|failed"}}[$__rate_interval]))',
        unit="cps",
        decimals=2,
    )


def _swap_failures() -> Json:
    return _often(
        "Swaps that failed, each robot",
        Advice(
            shows="QoS swaps that did not end well; superseded ones (a newer plan came first) are left out.",
            bad="any, again and again.",
            then="click a robot to open it and see 'Swaps'.",
        ),
        "arpd_topic_swap_failures_total",
        'reason!="superseded"',
    )


def _deadlines_missed() -> Json:
    return _lines(
        "Deadlines missed by each robot",
        Advice(
            shows="Deadlines that publishers offered and missed.",
            bad="steady misses.",
            then="click a robot to open it and see 'Deadlines missed by topic'.",
        ),
        f"sum by ({ROBOT}) (rate(arpd_topic_deadlines_missed_total{{}}[$__rate_interval]))",
        unit="cps",
        decimals=2,
    )


def _events() -> Json:
    return _often(
        "Events that call for somebody",
        Advice(
            shows="Outages, lost peers, failed swaps and reloads, floors given up.",
            bad="any that comes back.",
            then="click a robot to open it; its page tells each event in a sentence.",
        ),
        "arpd_events_total",
        'event=~"outage|peer_lost|swap_failed|reload_failed|infeasible"',
    )


def _tick() -> Json:
    return _lines(
        "Time a tick takes, 99 % below",
        Advice(
            shows="99 % of each daemon's ticks take less than this.",
            bad="above 0.05 s: a tick has 0.1 s.",
            then="that computer is too busy, or has too many topics.",
        ),
        f"histogram_quantile(0.99, sum by (le, {ROBOT}) "
        "(rate(arpd_tick_duration_seconds_bucket{}[$__rate_interval])))",
        unit="s",
        decimals=4,
        limits=(0.05, 0.1),
    )


def _cpu() -> Json:
    return _lines(
        "CPU of each daemon",
        Advice(
            shows="Part of one core that each daemon uses.",
            bad="one far above the others.",
            then="click a robot to open it and see 'The daemon itself'.",
        ),
        "rate(process_cpu_seconds_total{}[$__rate_interval])",
        unit="percentunit",
        decimals=1,
    )


def _memory() -> Json:
    return _lines(
        "Memory of each daemon",
        Advice(
            shows="Resident memory of each daemon.",
            bad="one that grows for hours.",
            then="please report it, with `arpd status --json`.",
        ),
        "process_resident_memory_bytes{}",
        unit="bytes",
        decimals=0,
    )
