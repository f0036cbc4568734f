"""The robot's dashboard, last part: the daemon itself, its configuration and its events."""

from __future__ import annotations

from typing import TYPE_CHECKING

from scripts.dashboards.document import Section, evenly
from scripts.dashboards.panels import BAD_TO_GOOD, Column, Scale, bars, instant, query, ranking, stat, table, timeseries
from scripts.dashboards.states import BLUE, GREEN, GREY, ORANGE, VERMILLION

if TYPE_CHECKING:
    from scripts.dashboards.panels import Json


def daemon() -> Section:
    """Return the section on the health of arpd itself."""
    return Section(
        title="The daemon itself",
        lines=(
            (8, evenly(_TICK, _LATENESS, _SOLVE_TIME)),
            (8, evenly(_SOLVES, _CPU, _MEMORY)),
            (8, evenly(_SCRAPE, _HTTP, _NOT_BELIEVED)),
        ),
    )


def configuration() -> Section:
    """Return the section on configuration and events."""
    numbers = ((6, _LAST_RELOAD), (6, _RELOAD_AGE), (6, _AWAITING_RESTART), (6, _UP))
    return Section(
        title="Configuration and events",
        lines=((4, numbers), (9, ((12, _EVENTS), (6, _EVENTS_IN_ALL), (6, _RELOADS))), (5, evenly(_VERSIONS))),
    )


def _quantiles(metric: str) -> list[Json]:
    rates = f"sum by (le) (rate({metric}_bucket{{}}[$__rate_interval]))"
    return [query(f"histogram_quantile({share}, {rates})", legend) for share, legend in ((0.5, "half"), (0.99, "99 %"))]


_TICK = timeseries(
    "Time a tick takes",
    _quantiles("arpd_tick_duration_seconds"),
    Scale("s", 4, (0.05, 0.1)),
    shows="Half of the ticks, and 99 % of them, take less than this.",
    bad="99 % above 0.05 s: a tick has 0.1 s.",
    then="the computer is too busy or has too many topics; see CPU, and `systemd-cgtop`.",
    colours={"half": BLUE, "99 %": ORANGE},
)

_LATENESS = timeseries(
    "Lateness of ticks",
    [
        *_quantiles("arpd_tick_lateness_seconds"),
        query("rate(arpd_ticks_late_total{}[$__rate_interval])", "late per second"),
        query("rate(arpd_tick_failures_total{}[$__rate_interval])", "failed per second"),
    ],
    Scale("s", 4),
    shows="How much later than planned ticks begin, and how many of them fail or begin half a period late.",
    bad="99 % above 0.05 s, or any failed tick.",
    then="failed: the log has the reason. Late: give arpd more CPU weight.",
    colours={"half": BLUE, "99 %": ORANGE, "late per second": GREY, "failed per second": VERMILLION},
)

_SOLVE_TIME = timeseries(
    "Time a solve takes",
    _quantiles("arpd_solve_duration_seconds"),
    Scale("s", 5),
    shows="Half of the solves of the program, and 99 % of them, take less than this.",
    bad="a large part of a tick's 0.1 s.",
    then="set program.backend: exact.",
    colours={"half": BLUE, "99 %": ORANGE},
)

_SOLVES = bars(
    "Solves that went wrong",
    [
        query("sum by (backend) (increase(arpd_solve_failures_total{}[$__rate_interval]))", "{{backend}} failed"),
        query(
            "sum by (backend) (increase(arpd_solves_infeasible_total{}[$__rate_interval]))", "{{backend}} infeasible"
        ),
        query("increase(arpd_cross_check_disagreements_total{}[$__rate_interval])", "disagreements"),
    ],
    shows="Solver failures, programs whose floors do not fit, and answers that the exact solver contradicted.",
    bad="disagreements or failures; infeasible only means that the floors exceed the link.",
    then="infeasible: lower min_rate_hz. The others: the exact answer was used; please report it.",
)

_CPU = timeseries(
    "CPU of the daemon",
    [query("rate(process_cpu_seconds_total{}[$__rate_interval])", "cores")],
    Scale("percentunit", 1),
    shows="Share of one core that arpd uses.",
    bad="above 50 % on a Pi for long.",
    then="'Scrape' and 'HTTP requests' show whether somebody asks too often, 'Messages refused' shows a flood.",
    colours={"cores": BLUE},
)

_MEMORY = timeseries(
    "Memory",
    [query("process_resident_memory_bytes{}", "daemon"), query("arpd_memory_available_bytes{}", "available to all")],
    Scale("bytes", 0),
    shows="Memory of the daemon, and what the robot's computer has left.",
    bad="a daemon that grows for hours; less available than program.memory_reserve: arpd then cuts depths.",
    then="growth: please report it. Little left: find the process (`systemd-cgtop -m`).",
    colours={"daemon": BLUE, "available to all": GREEN},
)

_SCRAPE = timeseries(
    "Scrape",
    [query("scrape_duration_seconds{}", "scrape"), query("arpd_snapshot_age_seconds{}", "age of the snapshot")],
    Scale("s", 3, (0.5, 1)),
    shows="Duration of Prometheus's scrape, and age of the snapshot that it got.",
    bad="scrapes near their timeout; a snapshot older than 1 s: ticks have stopped.",
    then="if ticks have stopped, `journalctl -u arpd`; the watchdog restarts it after 10 s.",
    colours={"scrape": BLUE, "age of the snapshot": GREY},
)

_HTTP = timeseries(
    "HTTP requests",
    [
        query("sum by (code) (rate(arpd_http_requests_total{}[$__rate_interval]))", "{{code}}"),
        query("sum(rate(arpd_http_connections_refused_total{}[$__rate_interval]))", "no answer"),
    ],
    Scale("reqps", 2),
    shows="Requests by answer, and connections that got none.",
    bad="401 or 429 again and again, or refused connections: somebody tries to get in, or asks too often.",
    then="see the log for addresses; http.web_config says who may.",
)

_NOT_BELIEVED = timeseries(
    "Messages refused",
    [query("sum by (reason) (rate(arpd_messages_refused_total{}[$__rate_interval]))", "{{reason}}")],
    Scale("cps", 2),
    shows="Messages from the ROS network that arpd refused, by reason, per second.",
    bad="source, rate or quota: a node uses another node's name, or floods.",
    then="find the node (`ros2 node list`); SROS 2 shuts it out (etc/sros2).",
    is_stacked=True,
)

_LAST_RELOAD = stat(
    "Last reload",
    [query("arpd_config_last_reload_successful{}", "last reload")],
    Scale("short"),
    shows="Whether the configuration file as last read is in force.",
    bad="refused: an older configuration is in force, whole.",
    then="`arpd check /etc/arpd/arpd.yaml` names every fault; then `systemctl reload arpd`.",
    words={
        "0": {"color": VERMILLION, "index": 0, "text": "refused"},
        "1": {"color": GREEN, "index": 1, "text": "in force"},
    },
)

_RELOAD_AGE = stat(
    "Configuration read",
    [instant("time() - arpd_config_last_reload_success_timestamp_seconds{}", "ago")],
    Scale("dtdurations", 0),
    shows="How long ago the configuration in force was read.",
    bad="longer ago than your last change of it.",
    then="`systemctl reload arpd`.",
)

_AWAITING_RESTART = stat(
    "Keys that await a restart",
    [query("arpd_config_keys_awaiting_restart{}", "keys")],
    Scale("short", 0, (1, 5)),
    shows="Keys of the file that a reload cannot take.",
    bad="above 0 when you expect the file to be in force.",
    then="`systemctl status arpd` names them; `systemctl restart arpd`.",
)

_UP = stat(
    "Answers Prometheus",
    [instant("avg_over_time(up{}[$__range])", "answered")],
    Scale("percentunit", 1, (0.95, 0.999), BAD_TO_GOOD),
    shows="Share of the scrapes that arpd answered, over the time shown.",
    bad="below 100 %: the daemon, the robot or the way to it was down; the charts have gaps.",
    then="`systemctl status arpd` on the robot; the target's error in Prometheus under Status, Targets.",
)

_EVENTS = bars(
    "Decision log",
    [query("sum by (event) (increase(arpd_events_total{}[$__rate_interval]))", "{{event}}")],
    shows="Events of arpd's decision log; their sentences are on the robot's page and in the journal.",
    bad="outage, peer_lost, swap_failed, reload_failed, infeasible.",
    then="`journalctl -u arpd ARPD_EVENT=outage` says when and why in plain words.",
)

_EVENTS_IN_ALL = ranking(
    "Events in the time shown",
    [instant("sort_desc(sum by (event) (increase(arpd_events_total{}[$__range])))", "{{event}}")],
    Scale("short"),
    shows="How often each kind of event occurred in the time shown.",
    bad="many of plan and confirmed on a steady link; any failure.",
    then="see 'New plans' for the causes.",
)

_RELOADS = bars(
    "Reloads",
    [
        query("sum(increase(arpd_config_reloads_total{}[$__rate_interval]))", "reloads"),
        query("sum(increase(arpd_config_reload_failures_total{}[$__rate_interval]))", "failed"),
        query("sum by (effect) (increase(arpd_config_changed_keys_total{}[$__rate_interval]))", "keys {{effect}}"),
    ],
    shows="Reloads of the configuration and of http.web_config, those refused, and keys that changed.",
    bad="failed.",
    then="the log names file, line and key.",
)

_VERSIONS = table(
    "Versions",
    (
        Column(title="Robot", label="instance"),
        Column(title="arpd", label="version", expression="max by (job, instance, version, python) (arpd_build_info{})"),
        Column(title="Python", label="python"),
        Column(title="Middleware", label="rmw", expression="max by (job, instance, rmw, swaps) (arpd_rmw_info{})"),
        Column(title="QoS swaps", label="swaps"),
    ),
    shows="Version of arpd and of its Python, the middleware of ROS, and whether it allows QoS swaps.",
    bad="swaps: no. arpd then only paces topics, and depths stay.",
    then="use Fast DDS, the only middleware for which swaps were measured.",
    sort_by="Robot",
    is_descending=False,
)
