"""Fenced blocks of the documents that a user follows, and what a test does with each line of them."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

REPO = Path(__file__).resolve().parents[2]
#: What a user follows from an empty computer to a topic under arpd's care, in this order.
SECTIONS = (
    ("README.md", "Install"),
    ("README.md", "Put topics under arpd's care"),
    ("README.md", "Configure"),
    ("docs/operating.md", "The Fast DDS profile"),
)
DRY_RUN = re.compile(r"scripts/install\.sh --dry-run")
PROFILE = re.compile(r"export FASTRTPS_DEFAULT_PROFILES_FILE=.*fastdds\.xml.*")
COMMAND = re.compile(r"arpd [a-z].*")
#: Lines that are not executed, and why.
ELSEWHERE = {
    re.compile(r"sudo scripts/install\.sh( --ceddp| --robot)?"): "tests/system/test_install.py, in a container",
    re.compile(r"sudo scripts/uninstall\.sh"): "tests/system/test_install.py, in a container",
    re.compile(r"scripts/deb"): "tests of the Debian package, in a container",
    re.compile(r"sudo apt install \./arpd-ros_\S+\.deb"): "tests of the Debian package, in a container",
    re.compile(r"sudo systemctl (enable --now|start|restart|reload) arpd.*"): "needs units; tests/system has them",
    re.compile(r"sudo apt install ros-jazzy-\S+"): "ROS is there already",
    re.compile(
        r"(git clone|cd|colcon build|source install|\. install|ros2 (run|launch)) .*"
    ): "tests of the ROS package",
}
_FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


@dataclass(frozen=True, kw_only=True, slots=True)
class Block:
    """A fenced block.

    Parameters
    ----------
    place : document and line of its first line, for a failure
    language : as the fence says, empty if it says none
    text : the lines between the fences
    """

    place: str
    language: str
    text: str

    @property
    def commands(self) -> list[str]:
        """Lines of a shell, without comments and without their prompts."""
        if self.language in {"python", "yaml"}:
            return []
        lines = (re.sub(r"(^|\s+)#.*", "", line).removeprefix("$ ").strip() for line in self.text.splitlines())
        return [line for line in lines if line]


def blocks(sections=SECTIONS, *, repo=REPO):
    """Return the blocks of the sections, in order; fail where a section is gone or has none."""
    return [block for name, heading in sections for block in _section(repo, name, heading)]


def _section(repo, name, heading):
    document = (repo / name).read_text(encoding="utf-8")
    found = re.search(rf"^## {re.escape(heading)}\n(.*?)(?=^## |\Z)", document, re.MULTILINE | re.DOTALL)
    assert found, f"{name} has no section called {heading!r}; name what replaces it in {__name__}.SECTIONS"
    inside = [
        Block(
            place=f"{name}:{document.count(chr(10), 0, found.start(1) + fence.start(2)) + 1}",
            language=fence[1],
            text=fence[2],
        )
        for fence in _FENCE.finditer(found[1])
    ]
    marks = len(re.findall(r"^\s*(?:```|~~~)", found[1], re.MULTILINE))
    assert marks == 2 * len(inside), f"section {heading!r} of {name} has a fence that is indented or not closed"
    assert inside, f"section {heading!r} of {name} has no fenced block any more"
    return inside


def unknown(found):
    """Return the lines and blocks that nobody handles, each with its place."""
    told = []
    for block in found:
        if block.language not in {"", "bash", "sh", "console", "python", "yaml"}:
            told.append(f"{block.place}: a block in {block.language!r}")
        told += (f"{block.place}: {line}" for line in block.commands if not is_known(line))
    return told


def is_known(line):
    """Return whether a line of a shell is executed here, or by other tests."""
    return any(pattern.fullmatch(line) for pattern in (DRY_RUN, PROFILE, COMMAND, *ELSEWHERE))


def lines(found, pattern):
    """Return the shell lines that a pattern describes."""
    return [line for block in found for line in block.commands if pattern.fullmatch(line)]
