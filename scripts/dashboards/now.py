"""The robot's dashboard, first part: is the link the problem, and what did arpd decide."""

from __future__ import annotations

from scripts.dashboards.document import Section
from scripts.dashboards.panels import (
    ADMITTED,
    QUEUE_DELAY,
    Scale,
    alert_list,
    instant,
    query,
    stat,
    timeline,
    timeseries,
)
from scripts.dashboards.states import BINDING, BLUE, GREEN, GREY, INTERFACE, KIND, LINK, ORANGE, PINK, SKY, STATUS

_ROBOT = "job, instance"
# What all sources would send without limits; wire headers are not counted.
_DEMAND = """8 * sum(
  arpd_topic_source_rate_hertz{direction!="local"}
  * arpd_topic_payload_bytes{direction!="local"}
  * clamp_min(arpd_topic_remote_readers{direction!="local"}, 1)
)"""


def now() -> Section:
    """Return the section that shows the robot's state at a glance."""
    numbers = (
        (4, _LINK_STATE),
        (4, _CAPACITY_NOW),
        (4, _QUEUE_DELAY_NOW),
        (4, _ADMITTED_NOW),
        (4, _CONFIRMED_NOW),
        (4, _ALERTS_NOW),
    )
    curves = ((16, _CAPACITY), (8, _QUEUE_DELAY))
    return Section(
        title="Is the link the problem, and what did arpd decide?",
        lines=((4, numbers), (7, ((16, _STATES), (8, _ALERTS))), (9, curves)),
    )


_LINK_STATE = stat(
    "Link",
    [query(LINK.expression(_ROBOT), "link")],
    Scale("short"),
    shows="What the link is doing now. App-limited: it carries all it is given, and could carry more.",
    bad="outage, or congested for more than a few seconds.",
    then="look at capacity and budget below; in an outage, at the interface, the access point and the peer.",
    states=LINK,
)

_CAPACITY_NOW = stat(
    "Capacity",
    [query("8 * arpd_link_capacity_bytes_per_second{}", "capacity")],
    Scale("bps", 1),
    shows="What the link carries by arpd's estimate, in wire bits per second.",
    bad="far below what this place usually has; compare with an earlier day.",
    then="move the robot or the access point; raise weights of the topics that matter most.",
)

_QUEUE_DELAY_NOW = stat(
    "Queue delay",
    [query("arpd_link_queue_delay_seconds{}", "delay")],
    QUEUE_DELAY,
    shows="One-way delay now, above its minimum of the last ten seconds.",
    bad="above 0.1 s for more than a second: something fills the link faster than it drains.",
    then="find out what fills it: arpd's topics (delivered is near the capacity), or cross traffic.",
)

_ADMITTED_NOW = stat(
    "Admitted",
    [query("arpd_gate_ratio{}", "admitted")],
    ADMITTED,
    shows="Part of the topics' traffic above their floors that fits into the budget; 100 %: no topic is slowed.",
    bad="far below what this place usually has; at 0 % only floors are left.",
    then="see capacity and budget below; 'Topics now' shows who is slowed. Raise weights of what matters most.",
)

_CONFIRMED_NOW = stat(
    "Publishers not confirmed",
    [query("arpd_publishers_managed{} - arpd_publishers_confirmed{}", "publishers")],
    Scale("short", 0, (1, 3)),
    shows="Managed publishers that do not yet announce the plan in force.",
    bad="above 0 for more than ten seconds.",
    then="see 'Publishers refused' for the reason, 'The plan reaches the nodes' for nodes that hang.",
)

_ALERTS_NOW = stat(
    "Alerts firing",
    [instant('sum(ALERTS{alertname=~"Arpd.*", alertstate="firing"}) or vector(0)', "alerts")],
    Scale("short", 0, (1, 1)),
    shows="arpd's alerts that fire for this robot, as Prometheus evaluates them.",
    bad="any.",
    then="read them in the list below; each has a runbook line.",
)

_STATES = timeline(
    "Link and plan",
    [
        (query(LINK.expression(_ROBOT), "link"), LINK),
        (query(INTERFACE.expression("job, instance, interface"), "{{interface}}"), INTERFACE),
        (query(KIND.expression(_ROBOT), "capacity is"), KIND),
        (query(STATUS.expression(_ROBOT), "floors"), STATUS),
        (query(BINDING.expression(_ROBOT), "limited by"), BINDING),
    ],
    shows="Link, its interface, the source of its capacity, whether every floor is kept, and what limits the topics.",
    bad="vermillion and orange: outage or congestion, floors given up, a capacity that is not measured.",
    then="find the first row that turned bad; the rows below it follow from it.",
)

_ALERTS = alert_list(
    "Alerts",
    shows="arpd's alerts of this robot that fire or are about to.",
    bad="any that fires; pending ones may still go away.",
    then="open it: its runbook line says what to do. If this list is empty and 'Alerts firing' is not, switch "
    "on 'Manage alerts via Alerting UI' in the data source.",
)

_CAPACITY = timeseries(
    "Capacity, budget and what arrives",
    [
        query("8 * arpd_link_capacity_bytes_per_second{}", "capacity"),
        query("8 * arpd_link_budget_bytes_per_second{}", "budget"),
        query("8 * arpd_link_delivery_rate_bytes_per_second{}", "delivered"),
        query("8 * arpd_link_foreign_bytes_per_second{}", "cross traffic"),
        query(_DEMAND, "demand"),
        query("8 * arpd_level_bytes_per_second{}", "plan made for"),
    ],
    Scale("bps", 1),
    shows="What the link carries, what the topics may use of it, what the peer received, cross traffic, what all "
    "sources would send without limits (payload only), and the lasting budget that the plan was made for.",
    bad="a budget far below the capacity for seconds: a queue has to drain. Delivered below the budget while sources "
    "want more: the writers block, or the estimate is too high.",
    then="demand above the budget is normal under arpd. Much cross traffic: move it off this link.",
    is_table=True,
    colours={
        "capacity": BLUE,
        "budget": SKY,
        "delivered": GREEN,
        "cross traffic": ORANGE,
        "demand": GREY,
        "plan made for": PINK,
    },
)

_QUEUE_DELAY = timeseries(
    "Queue delay over time",
    [query("arpd_link_queue_delay_seconds{}", "queue delay")],
    QUEUE_DELAY,
    shows="One-way delay above its minimum of the last ten seconds.",
    bad="plateaus above 0.1 s. A short peak is normal when the link falls: arpd measures the fall by it.",
    then="if plateaus last, lower link.headroom so that the topics use less of the link.",
    colours={"queue delay": BLUE},
)
