"""The dashboard of all robots."""

from __future__ import annotations

from typing import TYPE_CHECKING

from scripts.dashboards.document import Section, choice, dashboard, evenly, link_to_dashboard
from scripts.dashboards.fleet_charts import FROM_SERIES, ROBOT, TO_ROBOT, daemons, links, remedies
from scripts.dashboards.panels import (
    ADMITTED,
    BAD_TO_GOOD,
    COUNT,
    QUEUE_DELAY,
    Column,
    Scale,
    instant,
    query,
    stat,
    table,
    timeline,
)
from scripts.dashboards.states import KIND, LINK, STATUS

if TYPE_CHECKING:
    from typing import Unpack

    from scripts.dashboards.panels import Advice, Json

_FROM_ROW = {
    "targetBlank": False,
    "title": "Open ${__data.fields.Robot}",
    "url": TO_ROBOT % ("${__data.fields.Job}", "${__data.fields.Robot}"),
}


def fleet() -> Json:
    """Return the document."""
    return dashboard(
        uid="arpd-fleet",
        title="arpd / Fleet",
        description="Every robot under arpd, side by side: which one needs attention? A click on a robot opens it.",
        since="now-1h",
        variables=(
            choice("job", "arpd_ready", label="Job", is_multiple=True),
            choice("instance", "up", 'job=~"$job"', label="Instance", is_multiple=True),
        ),
        sections=(
            Section(
                title="Which robot needs attention?",
                lines=(
                    (4, evenly(_UP, _SILENT, _CUT_OFF, _SHORT, _BEHIND, _ALERTS)),
                    (10, evenly(_ROBOTS)),
                    (9, evenly(_LINK_STATES)),
                ),
            ),
            links(),
            remedies(),
            daemons(),
        ),
        links=(link_to_dashboard("arpd-robot", "One robot", "One robot in detail"),),
    )


def _count(
    title: str, expression: str, *, limits: tuple[float, float] | None = (1, 1), **advice: Unpack[Advice]
) -> Json:
    return stat(title, [instant(f"{expression} or vector(0)", "robots")], Scale("short", 0, limits), **advice)


_UP = _count(
    "Robots that answer",
    "sum(up{})",
    shows="Robots that answered Prometheus's last scrape.",
    bad="fewer than you run.",
    then="the table below shows which ones are missing.",
    limits=None,
)

_SILENT = _count(
    "Robots that do not answer",
    "count(up{} == 0)",
    shows="Targets of Prometheus that did not answer the last scrape.",
    bad="any robot that should be on.",
    then="is the robot on and in the network? Then `systemctl status arpd` on it.",
)

_CUT_OFF = _count(
    "Links in outage",
    'sum(arpd_link_state{state="outage"})',
    shows="Robots whose link carries nothing now.",
    bad="any.",
    then="open the robot; several at once: look at the access point.",
)

_SHORT = _count(
    "Robots that give up floors",
    'sum(arpd_allocation_status{status="degraded"})',
    shows="Robots whose link cannot carry the floors of their topics.",
    bad="any, for longer than a minute.",
    then="open the robot; lower min_rate_hz of what matters least, or improve its link.",
)

_BEHIND = _count(
    "Robots behind their plan",
    "count(arpd_publishers_managed{} - arpd_publishers_confirmed{} > 0)",
    shows="Robots with a publisher that does not announce the plan in force.",
    bad="any, for longer than ten seconds.",
    then="open the robot and see 'Publishers refused'.",
)

_ALERTS = _count(
    "Alerts firing",
    'sum(ALERTS{alertname=~"Arpd.*", alertstate="firing"})',
    shows="arpd's alerts that fire, of all robots.",
    bad="any.",
    then="the table says whose; each alert has a runbook line.",
)


def _of(expression: str) -> str:
    return f"max by ({ROBOT}) ({expression})"


_ROBOTS = table(
    "Robots",
    (
        Column(title="Robot", label="instance", links=(_FROM_ROW,)),
        Column(title="Job", label="job", width=90),
        Column(title="Answers", expression=_of("up{}"), scale=Scale("short", 0, (0.5, 1), BAD_TO_GOOD), width=90),
        Column(title="Link", expression=LINK.expression(ROBOT), states=LINK, width=110),
        Column(
            title="Capacity",
            expression=_of("8 * arpd_link_capacity_bytes_per_second{}"),
            scale=Scale("bps", 1),
            width=110,
        ),
        Column(title="Capacity is", expression=KIND.expression(ROBOT), states=KIND, width=190),
        Column(title="Queue delay", expression=_of("arpd_link_queue_delay_seconds{}"), scale=QUEUE_DELAY, width=110),
        Column(
            title="Budget",
            expression=_of("8 * arpd_link_budget_bytes_per_second{}"),
            scale=Scale("bps", 1),
            width=110,
        ),
        Column(title="Admitted", expression=_of("arpd_gate_ratio{}"), scale=ADMITTED, width=90),
        Column(title="Plan", expression=STATUS.expression(ROBOT), states=STATUS, width=130),
        Column(title="Publishers", expression=_of("arpd_publishers_managed{}"), scale=COUNT, width=100),
        Column(
            title="Not confirmed",
            expression=_of("arpd_publishers_managed{} - arpd_publishers_confirmed{}"),
            scale=Scale("short", 0, (1, 3)),
            width=120,
        ),
        Column(
            title="Alerts",
            expression=f'sum by ({ROBOT}) (ALERTS{{alertname=~"Arpd.*", alertstate="firing"}})'
            " or max by (job, instance) (0 * up{})",
            scale=Scale("short", 0, (1, 1)),
            width=80,
        ),
    ),
    shows="Every robot now, the worst queue first. A click on a name opens it.",
    bad="not up; outage or congested; floors given up; publishers that are not confirmed.",
    then="open the robot: its first row says whether the link is the problem.",
    sort_by="Queue delay",
    is_descending=True,
)


_LINK_STATES = timeline(
    "Link of each robot",
    [(query(LINK.expression(ROBOT), "{{instance}}"), LINK)],
    shows="What each robot's link was doing.",
    bad="vermillion (outage) and orange (congested); several robots at once point at the access point.",
    then="click a robot to open it at this time.",
    links=(FROM_SERIES,),
)
