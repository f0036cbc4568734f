"""The Markdown files of the repository: links lead somewhere, named files exist, and tables agree with the code."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path
from urllib.parse import unquote

import pytest

from arpd.report.conditions import MESSAGE_IDS, Condition, Happening

REPO = Path(__file__).resolve().parents[2]
FOLDERS = ("arpd", "docs", "etc", "scripts", "systemd", "tests")
DOCUMENTS = sorted([*REPO.glob("*.md"), *(path for folder in FOLDERS for path in (REPO / folder).rglob("*.md"))])
_FENCE = re.compile(r"^(```|~~~).*?^\1[^\n]*$", re.DOTALL | re.MULTILINE)
_CODE = re.compile(r"(`+)(?!`)(.+?)(?<!`)\1(?!`)", re.DOTALL)
_LINK = re.compile(r"\[(?:[^\[\]]|\[[^\]]*\])*\]\(\s*<?([^)>\s]+)>?(?:\s+\"[^\"]*\")?\s*\)")
_REFERENCE = re.compile(r"^ {0,3}\[[^\]]+\]:\s*<?(\S+?)>?\s*(?:\"[^\"]*\")?$", re.MULTILINE)
_HTML = re.compile(r"<(?:img|a)\b[^>]*?\b(?:src|href)=\"([^\"]+)\"")
_HEADING = re.compile(r"^ {0,3}#{1,6}\s+(.+?)\s*#*$", re.MULTILINE)
_SCHEME = re.compile(r"[a-z][a-z0-9+.-]*:", re.IGNORECASE)
_PATH = re.compile(rf"(?:{'|'.join(FOLDERS)})(?:/[\w.*-]+)+/?")


def slug(heading: str) -> str:
    """Return a heading's anchor by GitHub's rule: lower case, no punctuation, a hyphen for each space."""
    text = re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", heading)
    text = re.sub(r"(?<!\w)[*_]+|[*_]+(?!\w)", "", text.replace("`", ""))
    return re.sub(r"[^\w\- ]", "", text.lower()).replace(" ", "-")


def anchors(markdown: str) -> set[str]:
    """Return the anchors of a document; a repeated heading gets a number."""
    found: set[str] = set()
    counts: Counter[str] = Counter()
    for heading in _HEADING.findall(_FENCE.sub("", markdown)):
        name = slug(heading)
        found.add(f"{name}-{counts[name]}" if counts[name] else name)
        counts[name] += 1
    return found | set(re.findall(r"<a\s+(?:id|name)=\"([^\"]+)\"", markdown))


def links(markdown: str) -> list[str]:
    """Return the targets of all links and pictures outside code."""
    prose = _CODE.sub("`code`", _FENCE.sub("", markdown))
    return [*_LINK.findall(prose), *_REFERENCE.findall(prose), *_HTML.findall(prose)]


def has_anchor(path: Path, anchor: str) -> bool:
    """Return whether a file is a document with such an anchor."""
    return path.suffix == ".md" and anchor in anchors(path.read_text(encoding="utf-8"))


def broken_links(path: Path) -> list[str]:
    """Return the links of a document that lead nowhere in the repository."""
    wrong = []
    for target in links(path.read_text(encoding="utf-8")):
        if _SCHEME.match(target) or target.startswith("//"):
            continue
        name, _, anchor = unquote(target).partition("#")
        there = (path.parent / name).resolve() if name else path.resolve()
        is_there = not name.startswith("/") and there.is_relative_to(REPO.resolve()) and there.exists()
        if not is_there or (anchor and not has_anchor(there, anchor)):
            wrong.append(target)
    return wrong


def named_paths(markdown: str) -> set[str]:
    """Return the paths of the repository in code, inline or fenced; ``*`` may replace a part of a name."""
    code = [match[0] for match in _FENCE.finditer(markdown)]
    code += [match[2] for match in _CODE.finditer(_FENCE.sub("", markdown))]
    words = {word.strip("\"'(),;:") for text in code for word in text.split()}
    return {word for word in words if _PATH.fullmatch(word)}


def missing_paths(markdown: str) -> list[str]:
    """Return the named paths that do not exist."""
    return sorted(path for path in named_paths(markdown) if not any(REPO.glob(path.rstrip("/"))))


def name_of(path: Path) -> str:
    return str(path.relative_to(REPO))


def table(markdown: str, heading: str) -> list[list[str]]:
    """Return the rows of the first table under a heading, without its own head."""
    _, _, below = markdown.partition(f"\n{heading}\n")
    lines = re.search(r"^\|.*?(?=\n[^|]|\Z)", below, re.DOTALL | re.MULTILINE)
    assert lines, heading
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[0].splitlines()[2:]]


def documented(name: str) -> str:
    return (REPO / name).read_text(encoding="utf-8")


@pytest.mark.parametrize("path", DOCUMENTS, ids=name_of)
def test_every_relative_link_leads_somewhere(path):
    """File and anchor of every link exist."""
    assert broken_links(path) == []


@pytest.mark.parametrize("path", DOCUMENTS, ids=name_of)
def test_every_named_file_exists(path):
    """Every file or folder of the repository that a document names exists."""
    assert missing_paths(path.read_text(encoding="utf-8")) == []


def test_every_documented_metric_is_exposed():
    """Every metric and label in the table of metrics is in `/metrics`."""
    exposed = documented("tests/golden/exposition.txt")
    rows = table(documented("docs/metrics.md"), "## What answers which question")
    told = [each for _, cell in rows for each in re.findall(r"`([^`]+)`", cell)]
    assert len(told) > 30
    for metric in told:
        name, _, labels = metric.removesuffix("}").partition("{")
        name = name.replace("*", r"\w+")
        assert re.search(rf"^# HELP arpd_{name} ", exposed, re.MULTILINE), metric
        samples = re.findall(rf"^arpd_{name}(?:_bucket)?{{(.*)}} ", exposed, re.MULTILINE)
        for label in filter(None, labels.split(",")):
            assert all(f'{label}="' in sample for sample in samples), metric


def test_every_condition_and_event_is_documented():
    """The table has each row of the code with its words, weight, waiting time and MESSAGE_ID."""
    rows = {row[0].strip("`"): row[1:] for row in table(documented("docs/operating.md"), "## Conditions and events")}
    assert list(rows) == [*Condition, *Happening]
    for condition in Condition:
        headline, _, severity, after, number = rows[condition]
        assert headline == condition.headline
        assert severity == f"{condition.severity}{', wrong' if condition.is_wrong else ''}"
        assert after == (f"{condition.holds_s:g} s" if condition.holds_s else "at once")
        assert number.strip("`") == condition.message_id
    for happening in Happening:
        assert rows[happening][-1].strip("`") == MESSAGE_IDS[happening]


def test_every_promise_names_tests_that_exist():
    """A test that is renamed or deleted leaves no promise of tests/README.md behind."""
    named = re.findall(r"`(tests/[\w/]+\.py)(?:::(\w+))?`", documented("tests/README.md"))
    text_of = {file: documented(file) if (REPO / file).exists() else "" for file, _ in named}
    assert len(text_of) > 50
    defined = r"^(?:def|class) {0}\b|^{0} = "
    assert not [pair for pair in named if not re.search(defined.format(pair[1]), text_of[pair[0]], re.MULTILINE)]
