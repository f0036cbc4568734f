"""What the checks of `arpd doctor` judge: this computer, its configuration, and what the daemon tells."""

from __future__ import annotations

import os
from contextlib import suppress
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING

from arpd.cli.client import Daemon
from arpd.cli.options import DEFAULT_CONFIG, DEFAULT_URL, Address, is_missing
from arpd.host.addresses import own_address
from arpd.host.config.load import domain_of_units, load_settings
from arpd.host.config.yaml_source import YamlSource
from arpd.host.discovery import HeardDiscovery, listen
from arpd.host.interface import index_of, interface_to, likeliest_interface, list_interfaces
from arpd.host.services import OF_ARPD, service_states, used_on_base
from arpd.model.errors import ArpdError, ConfigError, NoAnswerError, NotKnownError, UsageError
from arpd.model.quantities import printable
from arpd.model.settings import AUTO, Settings

if TYPE_CHECKING:
    import argparse
    from pathlib import Path

    from arpd.web.api import Status

_ANY = {"0.0.0.0": "127.0.0.1", "::": "::1"}  # noqa: S104 - recognised in the configuration, not bound


class Here:
    """Facts of this computer that several checks judge; those that nobody tells raise NotKnownError."""

    def __init__(self, options: argparse.Namespace) -> None:
        self._options, self._is_remote = options, not options.url.is_here
        states = service_states(*OF_ARPD)
        self.units = {name: unit for name, unit in states.items() if unit.is_installed} if states else None
        self.is_far = options.far or self._is_remote or bool(used_on_base(states))
        self.settings, self._folder = Settings(), DEFAULT_CONFIG.parent
        #: Of each file; None where it is missing, or this user may not read it.
        self.faults: dict[Path, list[str] | None] = {}
        self._read_configuration()
        self.told = self._ask()
        if options.interface and index_of(options.interface) is None:
            there = ", ".join(sorted(list_interfaces() or ()))
            raise UsageError(f"--interface {printable(options.interface)}: there is none here; write one of {there}")
        relay = self.settings.relay
        self.own_end, self.other_end = (relay.base, relay.robot) if self.is_far else (relay.robot, relay.base)
        if self._is_remote:
            self.other_end = options.url.host
        self.found_interface: str = options.interface or self._find_interface()

    @property
    def status(self) -> Status:
        """What the daemon says."""
        if isinstance(self.told, NotKnownError):
            raise self.told
        return self.told

    @property
    def interface(self) -> str:
        """Interface of the link."""
        if not self.found_interface:
            raise NotKnownError("no interface looks like the link; name it with --interface")
        return self.found_interface

    @cached_property
    def heard(self) -> HeardDiscovery:
        """Discovery on the link."""
        if not self._options.listen:
            raise NotKnownError("--listen 0 asks not to listen")
        if (domain_id := domain_of_units()) is None:
            raise NotKnownError("ROS_DOMAIN_ID is no number")
        return listen(self.interface, domain_id, duration_s=self._options.listen)

    def _read_configuration(self) -> None:
        """Read the file of the command line, else those of the units in use; raise where the former is a typo."""
        named, used = self._options.config, {name for name, unit in (self.units or {}).items() if unit.is_used}
        needed = {_file_of(name) for name in used - {"arpd-peer"}}  # which may have none
        paths = {named} if named is not DEFAULT_CONFIG else needed or {DEFAULT_CONFIG}
        # The settings stay those of the last: of the robot that this computer is, not of one that it is the base of.
        for path in sorted(paths, key=lambda each: (each == DEFAULT_CONFIG, each)):
            is_missed = is_missing(path) and (path in needed or path != DEFAULT_CONFIG)
            self.faults[path] = self._faults_of(path) if is_missed or os.access(path, os.R_OK) else None

    def _faults_of(self, path: Path) -> list[str]:
        """Return the faults of a file, and keep the settings of one that has values; raise where its name is a typo."""
        interfaces = None if self.is_far else list_interfaces
        try:
            settings = load_settings(path, interfaces=interfaces, local_domain=domain_of_units())
            self.settings, self._folder = settings, path.parent
            own_address(path, self.settings.relay.link(is_far=self.is_far), is_far=self.is_far)
        except ConfigError as error:
            if path is self._options.config and is_missing(path):
                raise
            return error.faults
        return []

    def _ask(self) -> Status | NotKnownError:
        if self.is_far and not self._is_remote:
            return NotKnownError("only the robot's daemon tells; if its port is open, name it: --url http://ROBOT:9464")
        http, address = self.settings.http, self._options.url
        if address.url == DEFAULT_URL:
            http = replace(http, host=_ANY.get(http.host, http.host))
            url = f"{self._scheme()}://{http.netloc}"
            address = Address(url, http.host, url)
        try:
            with Daemon(self._options, address) as daemon:
                return daemon.status() or NotKnownError(f"the daemon at {address.url} has not finished a tick")
        except UsageError:
            raise
        except ArpdError as error:
            is_silent = isinstance(error, NoAnswerError) and not self._is_remote
            return NotKnownError(f"{error}{' On the base computer, name the robot with --url' if is_silent else ''}")

    def _scheme(self) -> str:
        """Return what the daemon speaks, as far as this user may read the web-config; the key is for arpd alone."""
        if web_config := self.settings.http.web_config:
            with suppress(ConfigError):
                if "tls_server_config" in YamlSource(self._folder / web_config).data:
                    return "https"
        return "http"

    def _find_interface(self) -> str:
        """Return the interface that the daemon or the file names, else that of the route to the other end, or a guess.

        Those of the robot mean nothing on the base computer.
        """
        told = "" if isinstance(self.told, NotKnownError) else self.told.interface
        configured = self.settings.link.interface.replace(AUTO, "")
        for name in () if self.is_far else (told, configured):
            if name and index_of(name) is not None:
                return name
        return (self.other_end and interface_to(self.other_end)) or likeliest_interface() or ""


def _file_of(unit: str) -> Path:
    """Return the configuration that a unit reads; of one with the name of a robot, that robot's."""
    return DEFAULT_CONFIG.parent / unit.partition("@")[2] / DEFAULT_CONFIG.name
