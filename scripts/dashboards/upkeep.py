"""The robot's dashboard, last part: the daemon itself, its configuration and its events."""

from __future__ import annotations

from typing import TYPE_CHECKING

from scripts.dashboards.document import Section
from scripts.dashboards.panels import (
    BAD_TO_GOOD,
    Advice,
    Column,
    bars,
    instant,
    query,
    ranking,
    stat,
    table,
    timeseries,
)
from scripts.dashboards.states import BLUE, GREEN, GREY, ORANGE, VERMILLION

if TYPE_CHECKING:
    from scripts.dashboards.panels import Json


def daemon() -> Section:
    """Return the section on whether arpd itself is well."""
    return Section(
        title="The daemon itself",
        lines=(
            (8, ((8, _tick()), (8, _lateness()), (8, _solve_time()))),
            (8, ((8, _solves()), (8, _cpu()), (8, _memory()))),
            (8, ((8, _scrape()), (8, _http()), (8, _not_believed()))),
        ),
    )


def configuration() -> Section:
    """Return the section on configuration and events."""
    numbers = ((6, _last_reload()), (6, _reload_age()), (6, _awaiting_restart()), (6, _up()))
    return Section(
        title="Configuration and events",
        lines=(
            (4, numbers),
            (9, ((12, _events()), (6, _events_in_all()), (6, _reloads()))),
            (5, ((24, _versions()),)),
        ),
    )


def _quantiles(metric: str) -> list[Json]:
    rates = f"sum by (le) (rate({metric}_bucket{{}}[$__rate_interval]))"
    return [query(f"histogram_quantile({share}, {rates})", legend) for share, legend in ((0.5, "half"), (0.99, "99 %"))]


def _tick() -> Json:
    return timeseries(
        "Time a tick takes",
        Advice(
            shows="Half of the ticks, and 99 % of them, take less than this.",
            bad="99 % above 0.05 s: a tick has 0.1 s.",
            then="the computer is too busy or has too many topics; see CPU, and `systemd-cgtop`.",
        ),
        _quantiles("arpd_tick_duration_seconds"),
        unit="s",
        decimals=4,
        limits=(0.05, 0.1),
        colours={"half": BLUE, "99 %": ORANGE},
    )


def _lateness() -> Json:
    return timeseries(
        "Lateness of ticks",
        Advice(
            shows="How much later than planned ticks begin, and how many of them fail or begin half a period late.",
            bad="99 % above 0.05 s, or any failed tick.",
            then="failed: the log has the reason. Late: give arpd more CPU weight.",
        ),
        [
            *_quantiles("arpd_tick_lateness_seconds"),
            query("rate(arpd_ticks_late_total{}[$__rate_interval])", "late per second"),
            query("rate(arpd_tick_failures_total{}[$__rate_interval])", "failed per second"),
        ],
        unit="s",
        decimals=4,
        colours={"half": BLUE, "99 %": ORANGE, "late per second": GREY, "failed per second": VERMILLION},
    )


def _solve_time() -> Json:
    return timeseries(
        "Time a solve takes",
        Advice(
            shows="Half of the solves of the program, and 99 % of them, take less than this.",
            bad="a large part of a tick's 0.1 s.",
            then="set program.backend: exact.",
        ),
        _quantiles("arpd_solve_duration_seconds"),
        unit="s",
        decimals=5,
        colours={"half": BLUE, "99 %": ORANGE},
    )


def _solves() -> Json:
    return bars(
        "Solves that went wrong",
        Advice(
            shows="Solver failures, plans for which not everything asked for fits, and answers that the exact solver "
            "contradicted.",
            bad="disagreements or failures; infeasible only says that the floors exceed the link.",
            then="infeasible: lower min_rate_hz. The others: the exact answer was used; please report it.",
        ),
        [
            query("sum by (backend) (increase(arpd_solve_failures_total{}[$__rate_interval]))", "{{backend}} failed"),
            query(
                "sum by (backend) (increase(arpd_solves_infeasible_total{}[$__rate_interval]))",
                "{{backend}} infeasible",
            ),
            query("increase(arpd_cross_check_disagreements_total{}[$__rate_interval])", "disagreements"),
        ],
    )


def _cpu() -> Json:
    return timeseries(
        "CPU of the daemon",
        Advice(
            shows="Part of one core that arpd uses.",
            bad="above 50 % on a Pi for long.",
            then="see 'Scrape' and 'HTTP requests' for who asks too often, and 'Not believed' for a flood.",
        ),
        [query("rate(process_cpu_seconds_total{}[$__rate_interval])", "cores")],
        unit="percentunit",
        decimals=1,
        colours={"cores": BLUE},
    )


def _memory() -> Json:
    return timeseries(
        "Memory",
        Advice(
            shows="Memory of the daemon, and what the robot computer has left.",
            bad="a daemon that grows for hours; available below program.memory_reserve, when depths are cut.",
            then="growth: please report it. Little left: find the process (`systemd-cgtop -m`).",
        ),
        [
            query("process_resident_memory_bytes{}", "daemon"),
            query("arpd_memory_available_bytes{}", "available to all"),
        ],
        unit="bytes",
        decimals=0,
        colours={"daemon": BLUE, "available to all": GREEN},
    )


def _scrape() -> Json:
    return timeseries(
        "Scrape",
        Advice(
            shows="Time Prometheus's scrape took, and how old the picture was that it got.",
            bad="scrapes near their timeout; a picture older than 1 s: ticks have stopped.",
            then="if ticks have stopped, `journalctl -u arpd`; the watchdog restarts it after 10 s.",
        ),
        [
            query("scrape_duration_seconds{}", "scrape"),
            query("arpd_snapshot_age_seconds{}", "age of the picture"),
        ],
        unit="s",
        decimals=3,
        limits=(0.5, 1),
        colours={"scrape": BLUE, "age of the picture": GREY},
    )


def _http() -> Json:
    return timeseries(
        "HTTP requests",
        Advice(
            shows="Requests by answer, and connections that got none.",
            bad="401 or 429 again and again, or refused connections: somebody tries to get in, or asks too often.",
            then="see the log for addresses; http.web_config says who may.",
        ),
        [
            query("sum by (code) (rate(arpd_http_requests_total{}[$__rate_interval]))", "{{code}}"),
            query("sum(rate(arpd_http_connections_refused_total{}[$__rate_interval]))", "no answer"),
        ],
        unit="reqps",
        decimals=2,
    )


def _not_believed() -> Json:
    return timeseries(
        "Not believed",
        Advice(
            shows="Messages from the ROS network that arpd did not believe, by reason, per second.",
            bad="source, rate or quota: a node speaks in another's name, or floods.",
            then="find the node (`ros2 node list`); SROS 2 shuts it out (etc/sros2).",
        ),
        [query("sum by (reason) (rate(arpd_messages_refused_total{}[$__rate_interval]))", "{{reason}}")],
        unit="cps",
        decimals=2,
        is_stacked=True,
    )


def _last_reload() -> Json:
    return stat(
        "Last reload",
        Advice(
            shows="Whether the configuration file as last read is in force.",
            bad="refused: an older configuration is in force, whole.",
            then="`arpd check /etc/arpd/arpd.yaml` names every fault; then `systemctl reload arpd`.",
        ),
        [query("arpd_config_last_reload_successful{}", "last reload")],
        unit="short",
        words={
            "0": {"color": VERMILLION, "index": 0, "text": "refused"},
            "1": {"color": GREEN, "index": 1, "text": "in force"},
        },
    )


def _reload_age() -> Json:
    return stat(
        "Configuration read",
        Advice(
            shows="How long ago the configuration in force was read.",
            bad="longer ago than your last change of it.",
            then="`systemctl reload arpd`.",
        ),
        [instant("time() - arpd_config_last_reload_success_timestamp_seconds{}", "ago")],
        unit="dtdurations",
        decimals=0,
    )


def _awaiting_restart() -> Json:
    return stat(
        "Keys that await a restart",
        Advice(
            shows="Keys of the file that a reload cannot take.",
            bad="above 0 when you expect the file to be in force.",
            then="`systemctl status arpd` names them; `systemctl restart arpd`.",
        ),
        [query("arpd_config_keys_awaiting_restart{}", "keys")],
        unit="short",
        decimals=0,
        limits=(1, 5),
    )


def _up() -> Json:
    return stat(
        "Answers Prometheus",
        Advice(
            shows="Part of the scrapes in the time shown that arpd answered.",
            bad="below 100 %: the daemon, the robot or the way to it was down; the charts have gaps there.",
            then="`systemctl status arpd` on the robot; the target's error in Prometheus under Status, Targets.",
        ),
        [instant("avg_over_time(up{}[$__range])", "answered")],
        unit="percentunit",
        decimals=1,
        limits=(0.95, 0.999),
        colours=BAD_TO_GOOD,
    )


def _events() -> Json:
    return bars(
        "Decision log",
        Advice(
            shows="Events of arpd's decision log; their sentences are on the robot's page and in the journal.",
            bad="outage, peer_lost, swap_failed, reload_failed, infeasible.",
            then="`journalctl -u arpd ARPD_EVENT=outage` tells when and why in plain words.",
        ),
        [query("sum by (event) (increase(arpd_events_total{}[$__rate_interval]))", "{{event}}")],
    )


def _events_in_all() -> Json:
    return ranking(
        "Events in the time shown",
        Advice(
            shows="How often each kind of event occurred in the time shown.",
            bad="many of plan and confirmed on a link that stands still; any failure.",
            then="see 'New plans' for what caused them.",
        ),
        [instant("sort_desc(sum by (event) (increase(arpd_events_total{}[$__range])))", "{{event}}")],
        unit="short",
    )


def _reloads() -> Json:
    return bars(
        "Reloads",
        Advice(
            shows="Reloads of the configuration and of http.web_config, those refused, and keys that changed.",
            bad="failed.",
            then="the log names file, line and key.",
        ),
        [
            query("sum(increase(arpd_config_reloads_total{}[$__rate_interval]))", "reloads"),
            query("sum(increase(arpd_config_reload_failures_total{}[$__rate_interval]))", "failed"),
            query("sum by (effect) (increase(arpd_config_changed_keys_total{}[$__rate_interval]))", "keys {{effect}}"),
        ],
    )


def _versions() -> Json:
    return table(
        "Versions",
        Advice(
            shows="Version of arpd and of its Python, the middleware of ROS, and whether it allows QoS swaps.",
            bad="swaps: no. Topics are then paced and gated only, and depths stay.",
            then="use Fast DDS, the only middleware for which swaps were measured.",
        ),
        (
            Column(title="Robot", label="instance"),
            Column(
                title="arpd",
                label="version",
                expression="max by (job, instance, version, python) (arpd_build_info{})",
            ),
            Column(title="Python", label="python"),
            Column(
                title="Middleware",
                label="rmw",
                expression="max by (job, instance, rmw, swaps) (arpd_rmw_info{})",
            ),
            Column(title="QoS swaps", label="swaps"),
        ),
        sort_by="Robot",
        is_descending=False,
    )
