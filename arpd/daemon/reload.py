"""The configuration in force, and its reloads."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING

from arpd.host.config.keys import changes
from arpd.host.config.load import in_force
from arpd.model.errors import ConfigError
from arpd.model.quantities import printable

if TYPE_CHECKING:
    from collections.abc import Callable

    from arpd.model.settings import Settings

log = logging.getLogger(__name__)

_LONGEST_PATH = 4096
_MOST_FAULTS = 20  # logged; `arpd check` names all


class Configuration:
    """Settings in force, their file, and the results of reloads.

    Parameters
    ----------
    settings : first settings
    path : their file
    wall_clock : Unix time (s)

    Attributes
    ----------
    error : first fault of the last reload, which the status shows; empty when it succeeded
    loaded_at_s : Unix time at which the settings in force were read (s)
    awaiting_restart : keys whose new value takes effect after a restart
    """

    def __init__(self, settings: Settings, *, path: str, wall_clock: Callable[[], float]) -> None:
        self.settings = settings
        self.path = printable(path, longest=_LONGEST_PATH)  # a name that is no UTF-8 is no JSON
        self.error = ""
        self.loaded_at_s = wall_clock()
        self.awaiting_restart: tuple[str, ...] = ()
        self._wall_clock = wall_clock

    def reload(self, load: Callable[[], Settings], *, take: Callable[[Settings], None]) -> bool:
        """Take a new configuration whole, or keep the old one whole.

        Keys that are read only at start keep their old value until a restart.

        Parameters
        ----------
        load : reads and checks the new configuration; raises ConfigError
        take : brings settings into force everywhere, or raises and changes nothing

        Returns
        -------
        Whether the new configuration is in force.
        """
        try:
            wanted = load()
        except ConfigError as error:
            for fault in error.faults[:_MOST_FAULTS]:
                log.error("%s", fault)  # noqa: TRY400 - the fault names its place; a traceback would bury it
            if (more := len(error.faults) - _MOST_FAULTS) > 0:
                log.error("%d more faults; arpd check shows all", more)  # noqa: TRY400 - the same
            self.error = error.faults[0]
            return False
        before, fresh = self.settings, in_force(self.settings, wanted)
        if fresh != before:
            take(fresh)
        self.settings = fresh
        for key, change in changes(before, fresh).items():
            log.info("reloaded: %s: %s", key, change)
        waiting = changes(fresh, wanted)
        for key, change in waiting.items():
            log.warning("%s: %s; takes effect after a restart", key, change)
        self.awaiting_restart = tuple(waiting)
        self.error = ""
        self.loaded_at_s = self._wall_clock()
        return True
