"""Facts of `arpd doctor`, gathered from this computer and from the daemon, and the list of its checks."""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from arpd import __version__
from arpd.cli.options import host_of, is_here
from arpd.host import discovery, kernel, wireless
from arpd.host.config.load import load_settings, local_domain
from arpd.host.interface import index_of, likeliest_interface, list_interfaces
from arpd.host.services import service_states
from arpd.model.errors import ArpdError, ConfigError, UsageError
from arpd.model.settings import AUTO, Settings
from arpd.report import health_host, health_link
from arpd.report.health import Facts, NotKnownError, PeerClock, Unit, Unknown, unknown
from arpd.ros import installation
from arpd.ros.profile import profile_line
from arpd.ros.rmw import rmw_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from arpd.cli.client import DaemonAddress
    from arpd.host.services import ServiceState
    from arpd.report.health import Finding, HeardDiscovery, NetworkLimits, PythonRos, RadioState
    from arpd.web.api.status import Status

_Fact = TypeVar("_Fact")
_ANY = {"", "0.0.0.0", "::"}  # noqa: S104 - recognised in the configuration, not bound
UNITS = ("arpd", "arpd-relay", "arpd-peer", "arpd-relay-far")
_UNITS_OF_BASE = {"arpd-peer", "arpd-relay-far"}
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
    is_far : whether this computer is the base computer, as the user says
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
    """All findings on one computer, by the name of the check."""

    is_far: bool
    interface: str
    findings: Mapping[str, Finding]


_CHECKS: tuple[Callable[[Facts], Finding | None], ...] = (
    health_link.clock,
    health_link.power_save,
    health_link.signal,
    health_link.region,
    health_link.mtu,
    health_host.receive_buffers,
    health_host.fragments,
    health_link.discovery,
    health_link.transports,
    health_host.profile,
    health_host.ros,
    health_host.numpy,
    health_host.rmw,
    health_host.versions,
    health_host.units,
    health_host.configuration,
)


def check_up(asked: Asked, senses: Senses) -> Checkup:
    """Read everything, and check it."""
    facts = gather(asked, senses)
    findings = {}
    for check in _CHECKS:
        try:
            found = check(facts)
        except NotKnownError as error:
            found = unknown(str(error))
        if found is not None:
            findings[check.__name__.replace("_", " ")] = found
    return Checkup(is_far=facts.is_far, interface=facts.interface, findings=findings)


def gather(asked: Asked, senses: Senses) -> Facts:
    """Read every fact."""
    url_host = host_of(asked.daemon.url)
    is_remote = bool(url_host) and not is_here(asked.daemon.url, is_own_address=senses.is_own_address)
    units = _installed(senses.units())
    is_far = asked.is_far or is_remote or _is_base(units)
    settings, faults = _configuration(asked.config_path, is_far=is_far)
    status = _status(asked, settings, is_far=is_far, is_remote=is_remote)
    relay = settings.relay
    other = (url_host if is_remote else relay.robot) if is_far else relay.base
    told = "" if is_far or isinstance(status, Unknown) else status.interface
    configured = "" if is_far or settings.link.interface == AUTO else settings.link.interface
    interface = asked.interface or _interface(senses, names=(told, configured), other=other)
    without, pythons = Unknown(_WITHOUT_INTERFACE), senses.ros()
    told_rmw = None if isinstance(status, Unknown) else status.rmw
    own_rmw = "" if isinstance(pythons[0], Unknown) else pythons[0].rmw
    return Facts(
        is_far=is_far,
        interface=interface,
        has_two_ends=relay.link_domain is not None,
        config_path=str(asked.config_path),
        faults=faults,
        version=__version__,
        daemon_version=_of(status, lambda told: told.version),
        clocks=_of(status, _clocks),
        is_clock_synchronised=senses.is_clock_synchronised(),
        lacking=_of(status, lambda told: sorted({each.node for each in told.topics if each.lacks_profile})),
        profile_line=profile_line(),
        rmw=told_rmw.name if told_rmw else own_rmw,
        rmw_refusal=told_rmw.refusal if told_rmw else rmw_of(own_rmw).refusal if own_rmw else "",
        rmw_is_the_daemons=told_rmw is not None,
        radios=_radios(senses, interface) if interface else without,
        mtu_bytes=senses.mtu(interface) if interface else without,
        route_mtu_bytes=senses.route_mtu(other) if other else None,
        limits=senses.limits(),
        heard=_heard(asked, senses, interface),
        pythons=pythons,
        distro=senses.environment.get("ROS_DISTRO", ""),
        distros=senses.distros(),
        units=units,
    )


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


def _is_base(installed: list[Unit] | Unknown) -> bool:
    """Return whether only the units of the base computer are in use here."""
    if isinstance(installed, Unknown):
        return False
    used = {unit.name for unit in installed if unit.is_enabled or unit.active != "inactive"}
    return bool(used) and used <= _UNITS_OF_BASE


def _configuration(path: Path, *, is_far: bool) -> tuple[Settings, list[str] | Unknown]:
    if not os.access(path, os.R_OK):
        return Settings(), Unknown(f"there is no {path}, or this user may not read it")
    try:
        interfaces = None if is_far else list_interfaces
        return load_settings(path, interfaces=interfaces, local_domain=local_domain()), []
    except ConfigError as error:
        return Settings(), error.faults


def _status(asked: Asked, settings: Settings, *, is_far: bool, is_remote: bool) -> Status | Unknown:
    daemon = asked.daemon
    if is_far and not is_remote:
        return Unknown("only the robot's daemon tells; if its port is open, name it: --url http://ROBOT:9464")
    if not asked.has_own_url:
        host = "127.0.0.1" if settings.http.host in _ANY else settings.http.host
        daemon = replace(daemon, url=f"http://{host}:{settings.http.port}")
    try:
        status = daemon.status()
    except UsageError:
        raise
    except ArpdError as error:
        hint = " On the base computer, name the robot with --url" if not is_remote and str(error).endswith("?") else ""
        return Unknown(f"{error}{hint}")
    return status or Unknown(f"the daemon at {daemon.url} has not finished a tick")


def _interface(senses: Senses, *, names: Iterable[str], other: str | None) -> str:
    """Return the first of these interfaces that is here, else that of the route to the other end, else a guess."""
    named = next((name for name in names if name and index_of(name) is not None), "")
    return named or (senses.interface_to(other) if other else None) or senses.likeliest_interface() or ""


def _heard(asked: Asked, senses: Senses, interface: str) -> HeardDiscovery | Unknown:
    if not asked.listen_s:
        return Unknown("--listen 0 asks not to listen")
    if not interface:
        return Unknown(_WITHOUT_INTERFACE)
    if (domain_id := local_domain(senses.environment)) is None:
        return Unknown("ROS_DOMAIN_ID is no number")
    return senses.listen(interface, domain_id, asked.listen_s)


def _of(status: Status | Unknown, read: Callable[[Status], _Fact]) -> _Fact | Unknown:
    return status if isinstance(status, Unknown) else read(status)


def _clocks(status: Status) -> list[PeerClock]:
    return [
        PeerClock(peer=peer.peer, offset_s=peer.clock_offset_seconds, uncertainty_s=peer.clock_uncertainty_seconds)
        for peer in status.peers
    ]


def _radios(senses: Senses, interface: str) -> dict[str, RadioState]:
    return {name: radio for name in (interface, *senses.radios_beneath(interface)) if (radio := senses.radio(name))}


def _system_ros() -> list[PythonRos | Unknown]:
    """Return what the system's Python finds, where that is another one and ROS comes from apt.

    The Python of a virtual environment is a link to the system's, but in another folder, and has other packages.
    """
    own, system = Path(sys.executable), installation.SYSTEM_PYTHON
    is_another = (own.parent.resolve(), own.resolve()) != (system.parent.resolve(), system.resolve())
    if not (system.exists() and is_another and installation.installed_distros()):
        return []
    return [installation.read_ros(str(system))]
