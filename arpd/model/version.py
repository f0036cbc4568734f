"""The installed version of arpd."""

from __future__ import annotations

from importlib import metadata

VERSION = metadata.version("arpd")
