"""The demo robot: its configuration and its topics, from demo.yaml."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from arpd.host.config.load import load_settings
from arpd.sim.robot import configured_topics

if TYPE_CHECKING:
    from arpd.model.settings import Settings
    from arpd.sim.result import SimTopic

DEMO_CONFIG = Path(__file__).with_name("demo.yaml")
COMMAND_TOPIC = "/cmd_vel"  # the only actuation topic


@cache
def demo_settings() -> Settings:
    """Return the demo robot's configuration."""
    return load_settings(DEMO_CONFIG, interfaces=None)


@cache
def demo_topics() -> tuple[SimTopic, ...]:
    """Return the demo robot's topics."""
    return configured_topics(demo_settings(), actuation={COMMAND_TOPIC})
