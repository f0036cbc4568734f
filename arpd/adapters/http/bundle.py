"""The scripts and styles of the page, read once, under a path that changes with their content."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from importlib.resources import files
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from importlib.resources.abc import Traversable

ASSETS_PATH = "/assets/"
_TYPES = {".js": "text/javascript; charset=utf-8", ".css": "text/css; charset=utf-8"}


@dataclass(frozen=True, kw_only=True, slots=True)
class Asset:
    """One file to serve."""

    content_type: str
    body: bytes


class Bundle:
    """The scripts and styles of ``arpd/adapters/http/assets``, vendored ones included.

    Their folder's name is the hash of all of them, so that browsers may cache them without limit, and scripts find each
    other by relative paths.
    """

    def __init__(self) -> None:
        found = dict(sorted(_files(files("arpd.adapters.http").joinpath("assets"))))
        digest = hashlib.sha256()
        for name, asset in found.items():
            digest.update(f"{name}\0{len(asset.body)}\0".encode() + asset.body)
        self.base = f"{ASSETS_PATH}{digest.hexdigest()[:16]}/"
        self._assets = {f"{self.base}{name}": asset for name, asset in found.items()}

    def get(self, path: str) -> Asset | None:
        """Return the asset at a path, None if there is none."""
        return self._assets.get(path)


def _files(folder: Traversable) -> list[tuple[str, Asset]]:
    found = []
    for entry in folder.iterdir():
        if entry.is_dir():
            found += _files(entry)
        elif content_type := _TYPES.get("." + entry.name.rpartition(".")[2]):
            found.append((entry.name, Asset(content_type=content_type, body=entry.read_bytes())))
    return found
