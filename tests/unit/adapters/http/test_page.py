"""The page: its rendering, its assets, and how they are served."""

from __future__ import annotations

import gzip
import hashlib
import json
import re
import subprocess
from dataclasses import replace
from http.client import HTTPConnection
from pathlib import Path
from types import SimpleNamespace

import playwright
import pytest
from prometheus_client import CollectorRegistry

from arpd.adapters.http.answers import PATHS, label
from arpd.adapters.http.bundle import Bundle
from arpd.adapters.http.page import FORMATS, render_page
from arpd.adapters.http.request import read_request
from arpd.adapters.http.server import HttpServer
from arpd.report.history import History
from arpd.report.status import status_document
from tests.visible import fields, visible

WEB = Path(__file__).parents[4] / "arpd" / "adapters" / "http"
VENDORED = WEB / "assets" / "vendor" / "uplot-1.6.32"


@pytest.fixture
def get(sample_snapshot):
    """Return a function that asks the server for a path."""
    history = History()
    for second in range(30):
        history.note(replace(sample_snapshot, finished_at_s=float(second)))
    server = HttpServer("127.0.0.1", 0, snapshot=lambda: sample_snapshot, registry=CollectorRegistry(), history=history)
    server.start()

    def ask(path, **headers):
        connection = HTTPConnection("127.0.0.1", server.port, timeout=5.0)
        connection.request("GET", path, headers=headers)
        answer = connection.getresponse()
        return SimpleNamespace(status=answer.status, headers=answer.headers, body=answer.read())

    yield ask
    server.stop()


# -- assets


def test_what_is_vendored_is_what_its_readme_says():
    """Each vendored file has the SHA-256 that stands beside it, and the licence is there."""
    lines = [line.split() for line in (VENDORED / "README.md").read_text().splitlines() if line[4:68].isalnum()]
    listed = {name: digest for digest, name in lines}
    assert set(listed) == {"uPlot.iife.min.js", "uPlot.min.css", "LICENSE"}
    assert {path.name for path in VENDORED.iterdir()} == {*listed, "README.md"}
    for name, digest in listed.items():
        assert hashlib.sha256((VENDORED / name).read_bytes()).hexdigest() == digest
    assert "MIT License" in (VENDORED / "LICENSE").read_text()


def test_everything_the_page_names_is_served_and_kept(get):
    """Scripts and styles lie under a path of their content, may be kept for good, and are found from the page."""
    page = get("/").body.decode()
    named = re.findall(r'(?:src|href)="(assets/[^"]+)"', page)
    assert len(named) == 6
    for path in named:
        answer = get(f"/{path}")
        assert answer.status == 200
        assert answer.headers["Cache-Control"] == "private, max-age=31536000, immutable"
        assert answer.headers["X-Content-Type-Options"] == "nosniff"
    assert get("/").headers["Cache-Control"] == get("/api/v1/history").headers["Cache-Control"] == "no-store"
    assert get("/assets/0123456789abcdef/page.js").status == 404
    assert get(f"/{named[0]}/../page.html").status == 404


def test_the_page_names_nobody_else():
    """Page, styles and scripts contain no address of another host, and nothing inline."""
    ours = [WEB / "page.html", *(WEB / "assets").glob("*.*")]
    for path in ours:
        text = path.read_text()
        assert not re.search(r"https?://|//[a-z]+\.", text), path
        assert "innerHTML" not in text
        assert not re.search(r"\son\w+=|style=|<style|<script>", text), path


def test_the_path_of_the_assets_follows_their_content(tmp_path, monkeypatch):
    """A changed script has another path, so no browser runs the old one."""
    (tmp_path / "assets").mkdir()
    script = tmp_path / "assets" / "page.js"
    script.write_text("one")
    monkeypatch.setattr("arpd.adapters.http.bundle.files", lambda _package: tmp_path)
    first = Bundle()
    script.write_text("two")
    second = Bundle()
    assert first.base != second.base
    asset = second.get(f"{second.base}page.js")
    assert asset is not None
    assert asset.body == b"two"
    script.write_text("one")
    assert Bundle().base == first.base


def test_paths_in_metrics_stay_few():
    """Every path, also an unknown one, has one of few labels."""
    assert label("/assets/0123/page.js") == label("/assets/never/was.js") == "/assets/"
    assert label("/api/v1/history") in PATHS
    assert label("/etc/passwd") == "other"


# -- compression


@pytest.mark.parametrize(
    ("header", "takes"),
    [
        ("gzip", True),
        ("br, GZIP;q=0.5", True),
        ("gzip;q=0", False),
        ("gzip;q=0.000", False),
        ("identity", False),
        ("", False),
    ],
)
def test_gzip_is_for_those_who_take_it(header, takes):
    """Only a client that accepts gzip gets it."""
    raw = iter([f"GET / HTTP/1.1\r\nHost: x\r\nAccept-Encoding: {header}\r\n\r\n".encode()])
    assert read_request(lambda _most: next(raw)).takes_gzip is takes


def test_answers_get_smaller_and_stay_the_same(get):
    """A large answer comes in gzip with the same content; a small one as it is."""
    plain, small = get("/api/v1/history"), get("/api/v1/history", **{"Accept-Encoding": "gzip, deflate"})
    assert small.headers["Content-Encoding"] == "gzip"
    assert plain.headers["Content-Encoding"] is None
    assert gzip.decompress(small.body) == plain.body
    assert len(small.body) < len(plain.body) / 4
    assert get("/-/ready", **{"Accept-Encoding": "gzip"}).headers["Content-Encoding"] is None


# -- rendering


def test_every_place_has_a_value_and_a_format(sample_snapshot):
    """Each path of the template exists in a full document, and each format is known."""
    document = json.loads(json.dumps(status_document(sample_snapshot, now_s=1000.25)))
    template = (WEB / "page.html").read_text()
    whole = re.sub(r"<!-- rows .*?<!-- end -->", "", template, flags=re.DOTALL)
    for path, form in re.findall(r"\{\{[=?!]?([\w.]+)(?:\|(\w+))?\}\}", whole):
        value = document
        for key in path.split(".") if path != "assets" else ():
            assert key in value, path
            value = value[key]
        assert not form or form in FORMATS


def test_before_the_first_tick_the_page_says_so():
    """Without a document the page has dashes in place of values."""
    page = render_page(None)
    assert "Starting: no tick has finished yet" in visible(page)
    assert set(fields(page)["gate|percent"]) == {"–"}


def test_markup_from_the_network_is_escaped(sample_snapshot):
    """Every string of the document is written as text, also in attributes."""
    document = status_document(sample_snapshot, now_s=1000.25)

    def spoilt(value):
        if isinstance(value, dict):
            return {key: spoilt(inner) for key, inner in value.items()}
        if isinstance(value, list):
            return [spoilt(inner) for inner in value]
        return '"><script>' if isinstance(value, str) else value

    page = render_page(spoilt(document))
    assert "<script>" not in page
    assert page.count("<script ") == 2


@pytest.mark.parametrize(
    ("form", "value", "said"),
    [
        ("number", 9.9999, "10.0"),
        ("number", 0.125, "0.13"),
        ("number", 1234.5, "1235"),
        ("mbit", 600_000.0, "4.80 Mbit/s"),
        ("ms", 0.0125, "12.5 ms"),
        ("ms", None, "–"),
        ("pace", None, "unpaced"),
        ("period", None, "none"),
        ("period", 62_500_000, "62.5"),
        ("counts", {"rate": 3, "price": 0, "failed": 1}, "rate 3, failed 1"),
        ("state", "app_limited", "not filled"),
        ("time", 1_700_000_000.0, "2023-11-14 22:13:20 UTC"),
    ],
)
def test_values_are_written_for_a_reader(form, value, said):
    """Values have three digits, units and no exponents; null is a word."""
    assert FORMATS[form](value) == said


def test_the_page_shows_the_verdict_and_every_fault(sample_snapshot):
    """The sentences are those of the document, each marked with its severity."""
    document = status_document(replace(sample_snapshot, config_error="line 3", keys_awaiting_restart=("http.port",)))
    page = render_page(document)
    for finding in (document["verdict"], *document["faults"]):
        assert finding["text"] in visible(page)
    assert [fault["severity"] for fault in document["faults"]] == re.findall(
        r'<p class="notice" data-mark-field="severity" data-mark="(error|warning)"', page
    )


# A node comes with playwright, which draws the page in tests/seeing.
NODE = str(Path(playwright.__file__).parent / "driver" / "node")
SAMPLES = [
    *(0, 0.005, 0.125, 0.5, 0.995, 1, 9.994, 9.995, 9.9999, 12.345, 99.94, 99.95, 100.5, 1234.5, 500_000, 10**9),
    *("", "a_b", "app_limited", "peer", "warning", [], ["a_b", "c"], {"rate": 3, "price": 0, "late_by": 1}, None),
]
# Times follow the zone of the browser; the others are written for one kind of value only.
TAKES = {"counts": dict, "list": list, "evidence": str, "state": str, "severity": str, "text": str, "words": str}


def test_the_browser_writes_every_value_as_the_server_does():
    """fields.js has the formats of page.py, and both write the same texts."""
    cases = [
        (form, value)
        for form in FORMATS
        if form != "time"
        for value in SAMPLES
        if value is None or isinstance(value, TAKES.get(form, (int, float)))
    ]
    script = f"""
        import {{ FORMATS }} from {json.dumps((WEB / "assets" / "fields.js").as_uri())};
        const said = {json.dumps(cases)}.map(([form, value]) => FORMATS[form](value));
        console.log(JSON.stringify([Object.keys(FORMATS), said]));
    """
    command = [NODE, "--input-type=module", "--no-warnings", "--eval", script]
    formats, said = json.loads(subprocess.run(command, capture_output=True, check=True, text=True).stdout)
    assert formats == list(FORMATS)
    assert dict(zip(map(repr, cases), said, strict=True)) == {repr(case): FORMATS[case[0]](case[1]) for case in cases}
