"""Facts of `arpd doctor`, gathered from this computer and from the daemon, and the judgements on them."""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from arpd import __version__
from arpd.adapters.config.domain import local_domain
from arpd.adapters.config.load import load_settings
from arpd.adapters.host import discovery, kernel, wireless
from arpd.adapters.host.interface import index_of, likeliest_interface, list_interfaces
from arpd.adapters.ros import installation
from arpd.adapters.ros.profile import profile_line
from arpd.adapters.ros.rmw import rmw_of
from arpd.adapters.systemd.services import service_states
from arpd.cli.client import DaemonAddress, find, number, rows, text
from arpd.cli.no_daemon import host_of, is_here
from arpd.model.errors import ConfigError, DaemonUnreachableError
from arpd.model.settings import AUTO, Settings
from arpd.report import health_host, health_link
from arpd.report.health import Judgement, Unknown, unknown
from arpd.report.health_host import Unit
from arpd.report.health_link import PeerClock

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping

    from arpd.adapters.systemd.services import ServiceState
    from arpd.report.health_host import NetworkLimits, PythonRos
    from arpd.report.health_link import HeardDiscovery, RadioState

_ANY = {"", "0.0.0.0", "::"}  # noqa: S104 - recognised in the configuration, not bound
UNITS = ("arpd", "arpd-relay", "arpd-peer", "arpd-relay-far")
_UNITS_OF_CEDDP = {"arpd-peer", "arpd-relay-far"}
_WITHOUT_INTERFACE = "no interface looks like the link; name it with --interface"


@dataclass(frozen=True, kw_only=True, slots=True)
class Asked:
    """Request of the command line.

    Parameters
    ----------
    daemon : where to ask the daemon
    has_own_url : whether the user named that address
    config_path : configuration file
    interface : link interface here, empty = find it
    is_far : whether this computer is the CEDDP, as the user says
    listen_s : time to listen to discovery, 0 = do not (s)
    """

    daemon: DaemonAddress
    has_own_url: bool
    config_path: Path
    interface: str = ""
    is_far: bool = False
    listen_s: float = 6.0


@dataclass(frozen=True, kw_only=True, slots=True)
class Senses:
    """Readers of everything outside the daemon, so that a test can replace each."""

    limits: Callable[[], NetworkLimits] = kernel.read_limits
    mtu: Callable[[str], int | Unknown] = kernel.read_mtu
    route_mtu: Callable[[str], int | None] = kernel.route_mtu
    is_own_address: Callable[[str], bool] = kernel.is_own_address
    interface_to: Callable[[str], str | None] = kernel.interface_to
    likeliest_interface: Callable[[], str | None] = likeliest_interface
    is_clock_synchronised: Callable[[], bool | None] = kernel.is_clock_synchronised
    radio: Callable[[str], RadioState | None] = wireless.read_radio
    radios_beneath: Callable[[str], list[str]] = wireless.radios_beneath
    listen: Callable[[str, int, float], HeardDiscovery | Unknown] = lambda interface, domain, duration_s: (
        discovery.listen(interface, domain, duration_s=duration_s)
    )
    units: Callable[[], Mapping[str, ServiceState]] = lambda: service_states(*UNITS)
    ros: Callable[[], list[PythonRos | Unknown]] = lambda: [installation.read_ros(), *_system_ros()]
    distros: Callable[[], list[str]] = installation.installed_distros
    environment: Mapping[str, str] = field(default_factory=lambda: os.environ)


@dataclass(frozen=True, kw_only=True, slots=True)
class Checkup:
    """All judgements on one computer."""

    is_far: bool
    interface: str
    judgements: tuple[Judgement, ...]


def check_up(asked: Asked, senses: Senses) -> Checkup:
    """Read everything, and judge it."""
    url_host = host_of(asked.daemon.url)
    is_remote = bool(url_host) and not is_here(asked.daemon.url, is_own_address=senses.is_own_address)
    installed = _installed(senses.units())
    is_far = asked.is_far or is_remote or _is_ceddp(installed)
    settings, faults = _configuration(asked.config_path, is_far=is_far)
    status = _status(asked, settings, is_far=is_far, is_remote=is_remote)
    relay = settings.relay
    other = (url_host if is_remote else relay.robot) if is_far else relay.ceddp
    interface = asked.interface
    if not interface:
        told = "" if is_far or isinstance(status, Unknown) else text(status, "interface")
        configured = "" if is_far or settings.link.interface == AUTO else settings.link.interface
        interface = _interface(senses, names=(told, configured), other=other)
    heard = _heard(asked, senses, interface)
    pythons, distros = senses.ros(), senses.distros()
    judgements = (
        *health_link.judge_clock(_clocks(status), is_synchronised=senses.is_clock_synchronised(), is_far=is_far),
        *_of_interface(senses, interface, other),
        health_host.judge_buffers(limits := senses.limits()),
        health_host.judge_fragments(limits),
        health_link.judge_discovery(heard, interface=interface, has_two_ends=relay.link_domain is not None),
        health_link.judge_transports(heard),
        health_host.judge_profile(_lacking(status), line=profile_line()),
        health_host.judge_ros(pythons[0], distro=senses.environment.get("ROS_DISTRO", ""), installed=distros),
        health_host.judge_numpy([one for one in pythons if not isinstance(one, Unknown)], installed=distros),
        _rmw(status, pythons[0]),
        health_host.judge_versions(
            __version__, status if isinstance(status, Unknown) else text(status, "version"), is_far=is_far
        ),
        *health_host.judge_units(installed),
        health_host.judge_configuration(str(asked.config_path), faults, is_far=is_far),
    )
    return Checkup(is_far=is_far, interface=interface, judgements=judgements)


def _installed(states: Mapping[str, ServiceState]) -> list[Unit] | Unknown:
    if not states:
        return Unknown("systemd does not run here, or does not answer")
    return [
        Unit(
            name=name,
            active=state.active,
            is_enabled=state.is_enabled,
            is_looping=state.sub.startswith("auto-restart"),  # systemd 254 and newer have auto-restart-queued, too
        )
        for name, state in states.items()
        if state.is_installed
    ]


def _is_ceddp(installed: list[Unit] | Unknown) -> bool:
    """Return whether only the units of the CEDDP are in use here."""
    if isinstance(installed, Unknown):
        return False
    used = {unit.name for unit in installed if unit.is_enabled or unit.active != "inactive"}
    return bool(used) and used <= _UNITS_OF_CEDDP


def _configuration(path: Path, *, is_far: bool) -> tuple[Settings, list[str] | Unknown]:
    if not os.access(path, os.R_OK):
        return Settings(), Unknown(f"there is no {path}, or this user may not read it")
    try:
        interfaces = None if is_far else list_interfaces
        return load_settings(path, interfaces=interfaces, local_domain=local_domain()), []
    except ConfigError as error:
        return Settings(), error.faults


def _status(asked: Asked, settings: Settings, *, is_far: bool, is_remote: bool) -> dict[str, Any] | Unknown:
    daemon = asked.daemon
    if is_far and not is_remote:
        return Unknown("only the robot's daemon tells; if its port is open, name it: --url http://ROBOT:9464")
    if not asked.has_own_url:
        host = "127.0.0.1" if settings.http.host in _ANY else settings.http.host
        daemon = replace(daemon, url=f"http://{host}:{settings.http.port}")
    try:
        status = daemon.status()
    except DaemonUnreachableError as error:
        hint = " On the CEDDP, name the robot with --url" if not is_remote and str(error).endswith("?") else ""
        return Unknown(f"{error}{hint}")
    return status if "link" in status else Unknown(f"the daemon at {daemon.url} has not finished a tick")


def _interface(senses: Senses, *, names: Iterable[str], other: str | None) -> str:
    """Return the first of these interfaces that is here, else that of the route to the other end, else a guess."""
    named = next((name for name in names if name and index_of(name) is not None), "")
    return named or (senses.interface_to(other) if other else None) or senses.likeliest_interface() or ""


def _of_interface(senses: Senses, interface: str, other: str | None) -> Iterator[Judgement]:
    if not interface:
        yield unknown(health_link.POWER_SAVE, _WITHOUT_INTERFACE)
        yield unknown(health_link.MTU, _WITHOUT_INTERFACE)
        return
    radios = {name: radio for name in (interface, *senses.radios_beneath(interface)) if (radio := senses.radio(name))}
    for name in radios or [interface]:
        yield from health_link.judge_radio(name, radios.get(name))
    yield health_link.judge_mtu(
        interface, senses.mtu(interface), route_bytes=senses.route_mtu(other) if other else None
    )


def _heard(asked: Asked, senses: Senses, interface: str) -> HeardDiscovery | Unknown:
    if not asked.listen_s:
        return Unknown("--listen 0 asks not to listen")
    if not interface:
        return Unknown(_WITHOUT_INTERFACE)
    if (domain_id := local_domain(senses.environment)) is None:
        return Unknown("ROS_DOMAIN_ID is no number")
    return senses.listen(interface, domain_id, asked.listen_s)


def _clocks(status: dict[str, Any] | Unknown) -> list[PeerClock] | Unknown:
    peers = _told(status, "peers", "clock_offset_seconds")
    if isinstance(peers, Unknown):
        return peers
    return [
        PeerClock(
            peer=text(peer, "peer"),
            offset_s=number(peer, "clock_offset_seconds"),
            uncertainty_s=number(peer, "clock_uncertainty_seconds"),
        )
        for peer in peers
    ]


def _lacking(status: dict[str, Any] | Unknown) -> list[str] | Unknown:
    topics = _told(status, "topics", "lacks_profile")
    if isinstance(topics, Unknown):
        return topics
    return sorted({text(topic, "node") for topic in topics if topic["lacks_profile"] is True})


def _told(status: dict[str, Any] | Unknown, name: str, key: str) -> list[dict[str, Any]] | Unknown:
    """Return the objects of a list in the status, unless the daemon is one that does not tell a key of them."""
    if isinstance(status, Unknown):
        return status
    found = rows(status, name)
    if all(key in row for row in found):
        return found
    return Unknown(f"the daemon is an older one ({text(status, 'version')}), which does not tell it")


def _rmw(status: dict[str, Any] | Unknown, python: PythonRos | Unknown) -> Judgement:
    """Judge the daemon's middleware, or, without a daemon, that of this shell."""
    if not isinstance(status, Unknown) and find(status, "rmw") is not None:
        return health_host.judge_rmw(text(status, "rmw", "name"), text(status, "rmw", "refusal"), is_of_daemon=True)
    name = "" if isinstance(python, Unknown) else python.rmw
    return health_host.judge_rmw(name, rmw_of(name).refusal if name else None, is_of_daemon=False)


def _system_ros(
    *,
    own: str = sys.executable,
    system: Path = installation.SYSTEM_PYTHON,
    distros: Callable[[], list[str]] = installation.installed_distros,
    read: Callable[[str], PythonRos | Unknown] = installation.read_ros,
) -> list[PythonRos | Unknown]:
    """Return what the system's Python finds, where that is another one and ROS comes from apt.

    The Python of a virtual environment is a link to the system's, but in another folder, and has other packages.
    """
    folder, file = Path(own).parent.resolve(), Path(own).resolve()
    is_another = system.exists() and (folder, file) != (system.parent.resolve(), system.resolve())
    return [read(str(system))] if is_another and distros() else []
