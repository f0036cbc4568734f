"""The Markdown files of the repository: links lead somewhere, named files exist, and tables agree with the code."""

import re
from collections import Counter
from functools import cache
from itertools import pairwise
from pathlib import Path
from urllib.parse import unquote

import pytest
from markdown_it import MarkdownIt

from arpd.report.conditions import MESSAGE_IDS, Condition, Happening

REPO = Path(__file__).resolve().parents[2]
FOLDERS = ("arpd", "docs", "etc", "scripts", "systemd", "tests")
DOCUMENTS = sorted([*REPO.glob("*.md"), *(path for folder in FOLDERS for path in (REPO / folder).rglob("*.md"))])
_PATH = re.compile(rf"(?:{'|'.join(FOLDERS)})(?:/[\w.*-]+)+/?")


@cache
class Document:
    """What a Markdown file links to, what can be linked to in it, and what it shows as code."""

    def __init__(self, path):
        self.links, self.anchors, self.code, headings = [], set(), [], Counter()
        tokens = MarkdownIt().parse(path.read_text(encoding="utf-8"))
        for before, token in pairwise([*tokens[:1], *tokens]):
            for part in (token, *(token.children or ())):
                self.links += [part.attrs[name] for name in ("href", "src") if name in part.attrs]
                if part.type in {"html_block", "html_inline"}:
                    self.links += re.findall(r"<(?:img|a)\b[^>]*?\b(?:src|href)=\"([^\"]+)\"", part.content)
                    self.anchors |= set(re.findall(r"<a\s+(?:id|name)=\"([^\"]+)\"", part.content))
                elif "code" in part.type or part.type == "fence":
                    self.code.append(part.content)
            if token.children and before.type == "heading_open":
                # GitHub's rule: lower case, no punctuation, a hyphen for each space, and a number where it is repeated.
                title = "".join(part.content for part in token.children if part.type in {"text", "code_inline"})
                name = re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-")
                self.anchors.add(f"{name}-{headings[name]}" if headings[name] else name)
                headings[name] += 1


def leads_somewhere(path, target):
    """Return whether a link of a document leads to the web, or to a file of the repository and an anchor in it."""
    if re.match(r"[a-z][a-z0-9+.-]*:|//", target, re.IGNORECASE):
        return True
    name, _, anchor = unquote(target).partition("#")
    there = (path.parent / name).resolve() if name else path
    is_there = not name.startswith("/") and there.is_relative_to(REPO) and there.exists()
    return is_there and (not anchor or (there.suffix == ".md" and anchor in Document(there).anchors))


def name_of(path):
    return str(path.relative_to(REPO))


def table(markdown, heading):
    """Return the rows of the first table under a heading, without its own head."""
    _, _, below = markdown.partition(f"\n{heading}\n")
    lines = re.search(r"^\|.*?(?=\n[^|]|\Z)", below, re.DOTALL | re.MULTILINE)
    assert lines, heading
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[0].splitlines()[2:]]


def documented(name):
    return (REPO / name).read_text(encoding="utf-8")


@pytest.mark.parametrize("path", DOCUMENTS, ids=name_of)
def test_every_relative_link_leads_somewhere(path):
    """File and anchor of every link exist."""
    assert [target for target in Document(path).links if not leads_somewhere(path, target)] == []


@pytest.mark.parametrize("path", DOCUMENTS, ids=name_of)
def test_every_named_file_exists(path):
    """Every file or folder of the repository that a document names in code exists; ``*`` may replace a part of one."""
    words = {word.strip("\"'(),;:") for text in Document(path).code for word in text.split()}
    named = sorted(word for word in words if _PATH.fullmatch(word))
    assert [name for name in named if not any(REPO.glob(name.rstrip("/")))] == []


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
