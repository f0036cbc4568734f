"""The dashboard of all robots."""

from __future__ import annotations

from typing import TYPE_CHECKING

from scripts.dashboards.document import Section, choice, dashboard, link_to_dashboard
from scripts.dashboards.fleet_charts import FROM_SERIES, ROBOT, TO_ROBOT, daemons, links, remedies
from scripts.dashboards.panels import (
    BAD_TO_GOOD,
    Advice,
    Column,
    instant,
    query,
    stat,
    table,
    timeline,
)
from scripts.dashboards.states import KIND, LINK, STATUS

if TYPE_CHECKING:
    from scripts.dashboards.panels import Json

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
        description="Every robot under arpd, side by side: which one needs somebody? A click on a robot opens it.",
        since="now-1h",
        variables=(
            choice("job", "arpd_ready", label="Job", is_multiple=True),
            choice("instance", "up", 'job=~"$job"', label="Instance", is_multiple=True),
        ),
        sections=(
            Section(
                title="Which robot needs somebody?",
                lines=(
                    (4, ((4, _up()), (4, _silent()), (4, _cut_off()), (4, _short()), (4, _behind()), (4, _alerts()))),
                    (10, ((24, _robots()),)),
                    (9, ((24, _link_states()),)),
                ),
            ),
            links(),
            remedies(),
            daemons(),
        ),
        links=(link_to_dashboard("arpd-robot", "One robot", "One robot in detail"),),
    )


def _count(title: str, advice: Advice, expression: str, *, limits: tuple[float, float] | None = (1, 1)) -> Json:
    return stat(
        title, advice, [instant(f"{expression} or vector(0)", "robots")], unit="short", decimals=0, limits=limits
    )


def _up() -> Json:
    return _count(
        "Robots that answer",
        Advice(
            shows="Robots that answered Prometheus's last scrape.",
            bad="fewer than you run.",
            then="the table below shows which ones are missing.",
        ),
        "sum(up{})",
        limits=None,
    )


def _silent() -> Json:
    return _count(
        "Robots that do not answer",
        Advice(
            shows="Targets of Prometheus that did not answer the last scrape.",
            bad="any that is not switched off on purpose.",
            then="is the robot on and in the network? Then `systemctl status arpd` on it.",
        ),
        "count(up{} == 0)",
    )


def _cut_off() -> Json:
    return _count(
        "Links in outage",
        Advice(
            shows="Robots whose link carries nothing now.",
            bad="any.",
            then="open the robot; several at once: look at the access point.",
        ),
        'sum(arpd_link_state{state="outage"})',
    )


def _short() -> Json:
    return _count(
        "Plans that give up floors",
        Advice(
            shows="Robots whose link does not even carry the least their topics asked for.",
            bad="any, for longer than a minute.",
            then="open the robot; lower min_rate_hz of what matters least, or improve its link.",
        ),
        'sum(arpd_allocation_status{status="degraded"})',
    )


def _behind() -> Json:
    return _count(
        "Robots behind their plan",
        Advice(
            shows="Robots of which a publisher does not announce the plan in force.",
            bad="any, for longer than ten seconds.",
            then="open the robot and see 'Publishers refused'.",
        ),
        "count(arpd_publishers_managed{} - arpd_publishers_confirmed{} > 0)",
    )


def _alerts() -> Json:
    return _count(
        "Alerts firing",
        Advice(
            shows="arpd's alerts that fire, of all robots.",
            bad="any.",
            then="the table says whose; each alert has a runbook line.",
        ),
        'sum(ALERTS{alertname=~"Arpd.*", alertstate="firing"})',
    )


def _robots() -> Json:
    def of(expression: str) -> str:
        return f"max by ({ROBOT}) ({expression})"

    return table(
        "Robots",
        Advice(
            shows="Every robot now, the worst queue first. A click on a name opens it.",
            bad="not up; outage or congested; floors given up; publishers that are not confirmed.",
            then="open the robot: its first row says whether the link is the problem.",
        ),
        (
            Column(title="Robot", label="instance", links=(_FROM_ROW,)),
            Column(title="Job", label="job", width=90),
            Column(title="Answers", expression=of("up{}"), decimals=0, limits=(0.5, 1), colours=BAD_TO_GOOD, width=90),
            Column(title="Link", expression=LINK.expression(ROBOT), states=LINK, width=110),
            Column(
                title="Capacity",
                expression=of("8 * arpd_link_capacity_bytes_per_second{}"),
                unit="bps",
                decimals=1,
                width=110,
            ),
            Column(title="Capacity is", expression=KIND.expression(ROBOT), states=KIND, width=190),
            Column(
                title="Queue delay",
                expression=of("arpd_link_queue_delay_seconds{}"),
                unit="s",
                decimals=3,
                limits=(0.1, 0.25),
                width=110,
            ),
            Column(
                title="Gate",
                expression=of("arpd_gate_ratio{}"),
                unit="percentunit",
                decimals=0,
                limits=(0.5, 0.95),
                colours=BAD_TO_GOOD,
                width=80,
            ),
            Column(title="Plan", expression=STATUS.expression(ROBOT), states=STATUS, width=130),
            Column(title="Publishers", expression=of("arpd_publishers_managed{}"), decimals=0, width=100),
            Column(
                title="Not confirmed",
                expression=of("arpd_publishers_managed{} - arpd_publishers_confirmed{}"),
                decimals=0,
                limits=(1, 3),
                width=120,
            ),
            Column(
                title="Alerts",
                expression=f'sum by ({ROBOT}) (ALERTS{{alertname=~"Arpd.*", alertstate="firing"}})'
                " or max by (job, instance) (0 * up{})",
                decimals=0,
                limits=(1, 1),
                width=80,
            ),
        ),
        sort_by="Queue delay",
        is_descending=True,
    )


def _link_states() -> Json:
    return timeline(
        "Link of each robot",
        Advice(
            shows="What each robot's link was doing.",
            bad="vermillion (outage) and orange (congested); several robots at once point at the access point.",
            then="click a robot to open it at this time.",
        ),
        [(query(LINK.expression(ROBOT), "{{instance}}"), LINK)],
        links=(FROM_SERIES,),
    )
