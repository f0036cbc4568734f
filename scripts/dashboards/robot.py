"""The dashboard of one robot."""

from __future__ import annotations

from typing import TYPE_CHECKING

from scripts.dashboards.document import choice, dashboard, link_to_dashboard
from scripts.dashboards.effect import each_topic, effect
from scripts.dashboards.now import now
from scripts.dashboards.swaps import swaps
from scripts.dashboards.upkeep import configuration, daemon
from scripts.dashboards.why import why

if TYPE_CHECKING:
    from scripts.dashboards.panels import Json


def robot() -> Json:
    """Return the document."""
    return dashboard(
        uid="arpd-robot",
        title="arpd / Robot",
        description="One robot under arpd: is the link the problem, what did arpd decide, why, and did it help?",
        since="now-15m",
        variables=(
            choice("job", "arpd_ready", label="Job", is_multiple=True),
            choice("instance", "arpd_ready", 'job=~"$job"', label="Instance", is_multiple=False),
            choice(
                "topic",
                "arpd_topic_source_rate_hertz",
                'job=~"$job", instance=~"$instance"',
                label="Topic",
                is_multiple=True,
            ),
        ),
        sections=(now(), why(), effect(), each_topic(), swaps(), daemon(), configuration()),
        links=(link_to_dashboard("arpd-fleet", "All robots", "Every robot that runs arpd, side by side"),),
    )
