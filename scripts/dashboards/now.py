"""The robot's dashboard, first part: is the link the problem, and what did arpd decide."""

from __future__ import annotations

from typing import TYPE_CHECKING

from scripts.dashboards.document import Section
from scripts.dashboards.panels import (
    BAD_TO_GOOD,
    Advice,
    alert_list,
    instant,
    query,
    stat,
    timeline,
    timeseries,
)
from scripts.dashboards.states import (
    BINDING,
    BLUE,
    GREEN,
    GREY,
    INTERFACE,
    KIND,
    LINK,
    ORANGE,
    PINK,
    SKY,
    STATUS,
)

if TYPE_CHECKING:
    from scripts.dashboards.panels import Json

_ROBOT = "job, instance"
# What every source together would put on the link if nothing held it back; wire headers are not counted.
_DEMAND = """8 * sum(
  arpd_topic_source_rate_hertz{direction!="local"}
  * arpd_topic_payload_bytes{direction!="local"}
  * clamp_min(arpd_topic_remote_readers{direction!="local"}, 1)
)"""


def now() -> Section:
    """Return the section that answers in ten seconds."""
    numbers = (
        (4, _link_state()),
        (4, _capacity_now()),
        (4, _queue_delay_now()),
        (4, _gate_now()),
        (4, _confirmed_now()),
        (4, _alerts_now()),
    )
    curves = ((12, _capacity()), (6, _queue_delay()), (6, _gate()))
    return Section(
        title="Is the link the problem, and what did arpd decide?",
        lines=((4, numbers), (7, ((16, _states()), (8, _alerts()))), (9, curves)),
    )


def _link_state() -> Json:
    return stat(
        "Link",
        Advice(
            shows="What the link is doing now. App-limited: it carries all it is given, and could carry more.",
            bad="outage, or congested for more than a few seconds.",
            then="look at capacity against plan below; in an outage, at the interface, the access point and the peer.",
        ),
        [query(LINK.expression(_ROBOT), "link")],
        unit="short",
        states=LINK,
    )


def _capacity_now() -> Json:
    return stat(
        "Capacity",
        Advice(
            shows="Wire bits per second that arpd believes the link carries.",
            bad="far below what this place usually has; compare with an earlier day.",
            then="move the robot or the access point; raise weights of the topics that matter most.",
        ),
        [query("8 * arpd_link_capacity_bytes_per_second{}", "capacity")],
        unit="bps",
        decimals=1,
    )


def _queue_delay_now() -> Json:
    return stat(
        "Queue delay",
        Advice(
            shows="How much longer a packet takes now than in the best moment of the last ten seconds.",
            bad="above 0.1 s for longer than a second: something fills the link faster than it drains.",
            then="see whether arpd's own topics do (delivered near capacity) or foreign traffic does.",
        ),
        [query("arpd_link_queue_delay_seconds{}", "delay")],
        unit="s",
        decimals=3,
        limits=(0.1, 0.25),
    )


def _gate_now() -> Json:
    return stat(
        "Gate",
        Advice(
            shows="Factor that holds every paced rate down while the link recovers; 100 % is open.",
            bad="below 50 % for more than a few seconds; it should open by itself when the queue is gone.",
            then="if it stays low the plan is too large for the link: see 'New plans' and 'Plan changes refused'.",
        ),
        [query("arpd_gate_ratio{}", "gate")],
        unit="percentunit",
        decimals=0,
        limits=(0.5, 0.95),
        colours=BAD_TO_GOOD,
    )


def _confirmed_now() -> Json:
    return stat(
        "Publishers not confirmed",
        Advice(
            shows="Managed publishers that do not yet announce the plan in force.",
            bad="above 0 for more than ten seconds.",
            then="see 'Publishers refused' for the reason, 'The plan reaches the nodes' for nodes that hang.",
        ),
        [query("arpd_publishers_managed{} - arpd_publishers_confirmed{}", "publishers")],
        unit="short",
        decimals=0,
        limits=(1, 3),
    )


def _alerts_now() -> Json:
    return stat(
        "Alerts firing",
        Advice(
            shows="arpd's alerts that fire for this robot, as Prometheus evaluates them.",
            bad="any.",
            then="read them in the list below; each has a runbook line.",
        ),
        [instant('sum(ALERTS{alertname=~"Arpd.*", alertstate="firing"}) or vector(0)', "alerts")],
        unit="short",
        decimals=0,
        limits=(1, 1),
    )


def _states() -> Json:
    return timeline(
        "Link and plan",
        Advice(
            shows="Link, its interface, how its capacity is known, whether the plan keeps every floor, what limits it.",
            bad="vermillion and orange: outage or congestion, floors given up, a capacity that nobody measured.",
            then="find the first row that turned bad; the rows below it follow from it.",
        ),
        [
            (query(LINK.expression(_ROBOT), "link"), LINK),
            (query(INTERFACE.expression("job, instance, interface"), "{{interface}}"), INTERFACE),
            (query(KIND.expression(_ROBOT), "capacity is"), KIND),
            (query(STATUS.expression(_ROBOT), "plan"), STATUS),
            (query(BINDING.expression(_ROBOT), "limited by"), BINDING),
        ],
    )


def _alerts() -> Json:
    return alert_list(
        "Alerts",
        Advice(
            shows="arpd's alerts of this robot that fire or are about to.",
            bad="any that fires; pending ones may still go away.",
            then="open it: its runbook line says what to do. Empty though 'Alerts firing' is not: switch on 'Manage "
            "alerts via Alerting UI' in the data source.",
        ),
    )


def _capacity() -> Json:
    return timeseries(
        "Capacity, demand and what arrives",
        Advice(
            shows="What the link carries, what the plan was made for, what all sources would send unhindered (payload "
            "only), what the peer received, and traffic that is not arpd's.",
            bad="delivered below the plan while sources want more, or a plan above the capacity for over two seconds.",
            then="demand above capacity is what arpd is for. Much foreign traffic: move it off this link.",
        ),
        [
            query("8 * arpd_link_capacity_bytes_per_second{}", "capacity"),
            query("8 * arpd_level_bytes_per_second{}", "plan made for"),
            query("8 * arpd_allocation_capacity_bytes_per_second{}", "may be used now"),
            query("8 * arpd_link_delivery_rate_bytes_per_second{}", "delivered"),
            query("8 * arpd_link_foreign_bytes_per_second{}", "foreign"),
            query(_DEMAND, "demand"),
        ],
        unit="bps",
        decimals=1,
        is_table=True,
        colours={
            "capacity": BLUE,
            "plan made for": PINK,
            "may be used now": SKY,
            "delivered": GREEN,
            "foreign": ORANGE,
            "demand": GREY,
        },
    )


def _queue_delay() -> Json:
    return timeseries(
        "Queue delay over time",
        Advice(
            shows="One-way delay above its minimum of the last ten seconds.",
            bad="plateaus above 0.1 s; a short peak as the link falls is how arpd notices.",
            then="if plateaus last, lower link.headroom so that less of the link is planned.",
        ),
        [query("arpd_link_queue_delay_seconds{}", "queue delay")],
        unit="s",
        decimals=3,
        limits=(0.1, 0.25),
        colours={"queue delay": BLUE},
    )


def _gate() -> Json:
    return timeseries(
        "Gate over time",
        Advice(
            shows="Factor on every paced rate above its floor. It reacts within a tenth of a second, without a swap.",
            bad="saw-teeth: the link swings faster than plans can follow.",
            then="a lower link.headroom leaves room for the swings.",
        ),
        [query("arpd_gate_ratio{}", "gate")],
        unit="percentunit",
        decimals=0,
        most=1,
        is_step=True,
        colours={"gate": BLUE},
    )
