"""The page: its places, its assets, and how they are served."""

import re
from html.parser import HTMLParser
from pathlib import Path

import pytest

from tests.golden.sample import EVENT, changed, status_of
from tests.unit.web_world import running

WEB = Path(__file__).parents[3] / "arpd" / "web"


@pytest.fixture
def get():
    """Return a function that asks the server for a path."""
    with running() as world:
        yield world.get


# -- assets


def test_everything_the_page_names_is_served(get):
    """Scripts and styles are found from the page, and a browser that has them is told that they have not changed."""
    page = get("/").text
    named = re.findall(r'(?:src|href)="(assets/[^"]+)"', page)
    assert len(named) == 7
    for path in named:
        answer = get(f"/{path}")
        assert answer.status == 200
        assert answer.headers["Cache-Control"] == "no-cache"
        assert answer.headers["X-Content-Type-Options"] == "nosniff"
        assert get(f"/{path}", **{"If-None-Match": answer.headers["ETag"]}).status == 304
    for other in ("nothing.js", "../handlers.py", "%2e%2e/handlers.py", "%00"):
        assert get(f"/assets/{other}").status in (403, 404)


def test_the_page_says_what_works_without_scripts(get):
    """Without JavaScript one sentence names the command, and the policy forbids inline scripts."""
    page = get("/")
    assert "<code>arpd status</code>" in re.search(r"<noscript>(.*?)</noscript>", page.text, re.DOTALL)[1]
    policy = page.headers["Content-Security-Policy"]
    assert policy.startswith("default-src 'none'; script-src 'self'; style-src 'self';")


def test_the_page_names_nobody_else():
    """No file has an address of another host, anything inline, or a path from the root, which a proxy may change."""
    ours = (WEB / "assets").glob("*.*")
    for path in ours:
        text = path.read_text()
        assert not re.search(r"https?://|//[a-z]+\.", text), path
        assert "innerHTML" not in text
        assert not re.search(r"""(?:href=|src=|ask\(|fetch\(|import |from )["'`]/""", text), path
        assert not re.search(r"\son\w+=|style=|<style|<script>", text), path


# -- places


class _Places(HTMLParser):
    """Collects the paths that the page takes from the document; those of a row begin with its list's."""

    def __init__(self):
        super().__init__()
        self.paths = set()
        self.rows = []

    def handle_starttag(self, tag, attrs):
        named = dict(attrs)
        paths = {
            named[name].partition("|")[0]
            for name in ("data-field", "data-mark-field", "data-show", "data-hide", "data-rows", "data-sort")
            if name in named
        }
        within = ["topics"] if "data-sort" in named else self.rows
        self.paths |= {".".join((*within, path)) for path in paths}
        if tag == "template":
            self.rows.append(named["data-rows"])

    def handle_endtag(self, tag):
        if tag == "template":
            self.rows.pop()


def test_every_place_of_the_page_is_in_the_document():
    """Each path of page.html exists in a full document."""
    document = status_of(changed(config_error="line 3", events=(EVENT,)), now_s=1000.25)
    places = _Places()
    places.feed((WEB / "assets/page.html").read_text())
    assert len(places.paths) > 60
    for path in places.paths:
        value = document
        for key in path.split("."):
            value = value[0] if isinstance(value, list) else value
            assert key in value, path
            value = value[key]
