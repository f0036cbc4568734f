"""The page in a real browser, with a daemon made by hand."""

from __future__ import annotations

import json
import re
import threading
from contextlib import suppress
from dataclasses import dataclass, field, replace
from http.client import HTTPConnection
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from itertools import pairwise

import pytest
from prometheus_client import CollectorRegistry

from arpd.adapters.http.server import HttpServer
from arpd.report.events import Event, EventKind, Severity
from arpd.report.history import History
from tests.golden.sample import FINISHED_AT_S
from tests.sample_publishers import publisher
from tests.seeing.browser import LEAST_CONTRAST, PHONE, chromium, visit
from tests.unit.web_world import HASH, PASSWORD, make_certificate

HOSTILE = "/<img src=x onerror=alert(1)>\"'&amp;</script><script>alert(2)</script>"


@dataclass
class Daemon:
    """A daemon whose snapshot and clock the tests set."""

    snapshot: object
    history: History = field(default_factory=History)
    late_s: float = 0.0
    server: HttpServer | None = None

    def __post_init__(self):
        for second in range(120):
            link = replace(self.snapshot.link, capacity_bytes_per_second=2.5e6 if second < 60 else 6e5)
            self.history.note(self.at(replace(self.snapshot, link=link), second - 119.0))

    def at(self, snapshot, later_s):
        return replace(snapshot, finished_at_s=FINISHED_AT_S + later_s, unix_time_s=self.snapshot.unix_time_s + later_s)

    def start(self, port=0, **options):
        self.server = HttpServer(
            "127.0.0.1",
            port,
            snapshot=lambda: self.snapshot,
            registry=CollectorRegistry(),
            history=self.history,
            clock=lambda: FINISHED_AT_S + self.late_s,
            **options,
        )
        self.server.start()
        return self.server.url


@pytest.fixture(scope="module")
def browser():
    with chromium() as started:
        yield started


@pytest.fixture
def daemon(sample_snapshot):
    events = tuple(
        Event(number=n, unix_time_s=1.7e9 - 90 + n, kind=kind, severity=severity, text=text)
        for n, kind, severity, text in (
            (1, EventKind.PLAN, Severity.WARNING, "link fell to 4.8 Mbit/s: /camera/image 30 → 2.1 Hz"),
            (2, EventKind.OUTAGE, Severity.ERROR, "the link carries nothing"),
            (3, EventKind.RECOVERED, Severity.INFO, "the link carries again"),
        )
    )
    running = Daemon(replace(sample_snapshot, events=events))
    running.start()
    yield running
    running.server.stop()


LIVE = "document.body.dataset.freshness === 'live'"


def test_the_document_stands_in_its_places(daemon, browser):
    """Verdict, faults, link, rows, log and facts show the document's values; the log has the newest line first."""
    daemon.snapshot = replace(daemon.snapshot, config_error="line 3", lease_s=30.0)
    with visit(browser, daemon.server.url) as seen:
        seen.wait_for(LIVE)
        (verdict,) = seen.texts("#verdict p")
        assert verdict.startswith("The link is the limit")
        assert any("line 3" in notice for notice in seen.texts(".notice[data-mark=error]"))
        tiles = " ".join(seen.texts(".tiles > div"))
        assert "Capacity 4.00 Mbit/s from the peer: 3 trains, median 500 kB/s" in tiles
        assert "Cross traffic 0.50 Mbit/s leaves 3.50 Mbit/s" in tiles
        assert "2 of 3 publishers, 1 of 1 readers confirmed" in tiles
        image, command, *_ = seen.texts("#topics tbody tr")
        assert image == (
            "/camera/image /camera, sensing 30.0 12.5 11.5 link 50.0 % of the link 10 / 10 100 / 100 4 "
            "1799 price 1700, rate 99 1"
        )
        assert "did not match the new writer in 5 s" in command
        assert any("/map is TRANSIENT_LOCAL" in row for row in seen.texts("[aria-labelledby=readers-title] tbody tr"))
        told = (
            "the link carries again",
            "Error: the link carries nothing",
            "Warning: link fell to 4.8 Mbit/s: /camera",
        )
        assert all(text in line for text, line in zip(told, seen.texts("#log li"), strict=True))
        facts = " ".join(seen.texts(".facts > div"))
        assert "after 30.0 s without this daemon" in facts
        assert "edge-c001, last report 12.5 s ago" in facts
        assert seen.complaints == []


def test_values_are_written_for_a_reader(daemon, browser):
    """Values have three digits, units and no exponents; null is a word."""
    cases = {
        "number": {9.9999: "10.0", 0.125: "0.13", 99.95: "100", 1234.5: "1235", 10**9: "1000000000"},
        "mbit": {600_000: "4.80 Mbit/s"},
        "ms": {0.0125: "12.5 ms", None: "–"},
        "percent": {0.995: "99.5 %"},
        "pace": {None: "unpaced", 12.5: "12.5"},
        "period": {None: "none", 62_500_000: "62.5"},
        "text": {"": "", None: "–"},
        "words": {"desired_rate": "desired rate"},
        "state": {"app_limited": "not filled", "steady": "steady"},
    }
    script = """async (cases) => {
      const { FORMATS } = await import(document.querySelector("[href$='/fields.js']").href);
      return cases.map(([format, value]) => FORMATS[format](value));
    }"""
    asked = [(format_, value, said) for format_, each in cases.items() for value, said in each.items()]
    asked += [
        ("counts", {"rate": 3, "price": 0, "late_by": 1}, "rate\u00a03, late by\u00a01"),
        ("list", ["a_b", "c"], "a b, c"),
    ]
    with visit(browser, daemon.server.url) as seen:
        told = seen.page.evaluate(script, arg=[case[:2] for case in asked])
        assert list(zip(asked, told, strict=True)) == [(case, case[2]) for case in asked]


def test_topics_sort_and_filter(daemon, browser):
    """A click or key on a column's head sorts by it, largest first, words find rows, and the address keeps both."""
    rows = "[...document.querySelectorAll('#topics tbody th > span')].map((name) => name.textContent)"
    crowd = tuple(publisher("/driver", f"/sensor_{n}", published_rate_hz=float(n)) for n in range(100))
    daemon.snapshot = replace(daemon.snapshot, observation=replace(daemon.snapshot.observation, publishers=crowd))
    with visit(browser, daemon.server.url) as seen:
        seen.wait_for(LIVE)
        assert seen.page.evaluate(rows) == [f"/sensor_{n}" for n in range(100)]
        head = seen.page.locator("th[data-sort=published_rate_hz]")
        head.locator("button").press("Enter")
        assert head.get_attribute("aria-sort") == "descending"
        assert seen.page.evaluate(rows)[:2] == ["/sensor_99", "/sensor_98"]
        seen.page.get_by_label("Find").fill("driver _1")
        assert seen.page.evaluate(rows) == [f"/sensor_{n}" for n in (*range(19, 9, -1), 1)]
        assert seen.texts("#found") == ["11 of 100"]
        seen.page.reload()
        seen.wait_for(LIVE)
        assert seen.page.evaluate(rows)[-1] == "/sensor_1"
        head.locator("button").click()
        assert head.get_attribute("aria-sort") == "ascending"
        assert seen.page.evaluate(rows)[0] == "/sensor_1"
        assert seen.complaints == []


def test_charts_zoom(daemon, browser):
    """Dragging over a chart shows that time in all of them, a double click all of it, and buttons the last part."""
    with visit(browser, daemon.server.url) as seen:
        seen.wait_for("document.querySelectorAll('canvas').length === 4")
        shown, area = seen.page.locator("#shown"), seen.page.locator("#chart-rate .u-over")
        pressed = "document.querySelector('[data-span][aria-pressed=true]')?.dataset.span"
        box = area.bounding_box()
        seen.page.mouse.move(box["x"] + box["width"] / 4, box["y"] + 20)
        seen.page.mouse.down()
        seen.page.mouse.move(box["x"] + box["width"] / 2, box["y"] + 30, steps=4)
        seen.page.mouse.up()
        assert re.search(r"\d\d:\d\d:\d\d to ", shown.inner_text())
        assert seen.page.evaluate(pressed) is None
        area.dblclick()
        assert seen.page.evaluate(pressed) == "600"
        seen.page.get_by_role("button", name="30 s").click()
        assert seen.page.evaluate(pressed) == "30"
        assert seen.complaints == []


def test_nothing_is_asked_of_anybody_else(daemon, browser):
    """The page follows the daemon without a request to another host, an error, or a breach of its policy."""
    with visit(browser, daemon.server.url) as seen:
        seen.wait_for(LIVE)
        seen.wait_for("document.querySelectorAll('canvas').length === 4")
        assert all(seen.drawn(f"#chart-{name} canvas") > 500 for name in ("rate", "delay", "gate", "topic"))
        assert {request.removeprefix(daemon.server.url).split("/")[1] for request in seen.requests} <= {
            "",
            "api",
            "assets",
            "data:,",
        }
        assert seen.complaints == []


def test_names_from_the_network_stay_text(daemon, browser):
    """Markup in names, reasons and events is shown as it is written, and runs nothing."""
    evil = publisher(HOSTILE, HOSTILE, refusal=HOSTILE, published_rate_hz=1.0)
    observation = replace(daemon.snapshot.observation, publishers=(evil,))
    events = (replace(daemon.snapshot.events[0], text=HOSTILE),)
    link = replace(daemon.snapshot.link, evidence=HOSTILE)
    daemon.snapshot = replace(
        daemon.snapshot, observation=observation, events=events, link=link, interface=HOSTILE, config_error=HOSTILE
    )
    daemon.history.note(daemon.at(daemon.snapshot, 1.0))
    with visit(browser, daemon.server.url) as seen:
        seen.page.on("dialog", lambda dialog: (seen.complaints.append(dialog.message), dialog.dismiss()))
        seen.wait_for(LIVE)
        seen.wait_for("document.querySelector('#chosen').options.length > 0")
        assert seen.page.evaluate("document.querySelectorAll('main img, main script').length") == 0
        assert seen.page.locator("#topics tbody th").inner_text().startswith(HOSTILE)
        assert HOSTILE in seen.page.locator("#log li").inner_text()
        assert seen.complaints == []


def test_it_says_when_the_daemon_is_gone_and_recovers_by_itself(daemon, browser):
    """Without an answer the page greys out and counts the age; when the daemon is back it is live again."""
    port = daemon.server.port
    with visit(browser, daemon.server.url) as seen:
        seen.wait_for(LIVE)
        daemon.server.stop()
        seen.wait_for("document.body.dataset.freshness === 'lost'")
        assert "the daemon cannot be reached · as of" in seen.page.locator("#freshness").inner_text()
        assert "grayscale" in seen.page.evaluate("getComputedStyle(document.querySelector('main')).filter")
        before = seen.page.locator("#freshness").inner_text()
        seen.wait_for(f"document.querySelector('#freshness').textContent !== {json.dumps(before)}")
        daemon.start(port)
        seen.wait_for(LIVE)


def test_it_says_when_the_daemon_hangs(daemon, browser):
    """A daemon that answers while no tick finishes is stale, and the page shows its age."""
    daemon.late_s = 30.0
    with visit(browser, daemon.server.url) as seen:
        seen.wait_for("document.body.dataset.freshness === 'stale'")
        said = seen.page.locator("#freshness").inner_text()
        assert "no tick finishes" in said
        assert int(re.search(r"(\d+) s ago", said)[1]) >= 30


def test_a_daemon_that_starts_comes_alive(daemon, browser):
    """Before the first tick the page says so, and after it fills itself."""
    first, daemon.snapshot = daemon.snapshot, None
    with visit(browser, daemon.server.url) as seen:
        seen.wait_for("document.body.dataset.freshness === 'lost'")
        assert "no tick has finished yet" in seen.page.locator("#verdict").inner_text()
        assert "the daemon is starting" in seen.page.locator("#freshness").inner_text()
        daemon.snapshot = first
        seen.wait_for(LIVE)
        assert seen.texts("#topics tbody th")[0].startswith("/camera/image")


def test_a_slow_first_answer_is_waited_for(daemon, browser):
    """While the first answer takes longer than a period, nothing fails, and then the page is live."""
    with visit(browser, daemon.server.url) as seen:
        seen.page.route("**/api/v1/stream", lambda route: (seen.page.wait_for_timeout(1500), route.continue_()))
        seen.page.reload()
        seen.wait_for(LIVE)
        assert seen.complaints == []


def test_a_page_without_the_stream_asks_every_few_seconds(daemon, browser):
    """It stays live, and does not fill the link with questions, when its stream is refused."""
    with visit(browser, daemon.server.url) as seen:
        seen.page.route("**/api/v1/stream", lambda route: route.fulfill(status=503))
        seen.page.reload()
        seen.wait_for(LIVE)
        asked = len(seen.requests)
        seen.page.wait_for_timeout(6000)
        assert 2 <= len(seen.requests) - asked <= 8


def test_the_log_moves_on(daemon, browser):
    """Changes take lines from the front of the log, add them at its end, and change rows in between."""
    events = daemon.snapshot.events
    with visit(browser, daemon.server.url) as seen:
        seen.wait_for(LIVE)
        for number in range(4, 7):
            new = replace(events[0], number=number, text=f"new line {number}")
            events = (*events[1:], new)
            daemon.snapshot = daemon.at(replace(daemon.snapshot, events=events), number)
            seen.wait_for(f"document.querySelector('#log li').textContent.includes('new line {number}')")
            for line, event in zip(seen.texts("#log li"), reversed(events), strict=True):
                assert event.text in line
        assert seen.requests.count(f"{daemon.server.url}/api/v1/stream") == 1


def test_nobody_asks_while_nobody_looks(daemon, browser):
    """A hidden page neither listens nor reloads; visible again, it asks at once."""
    with visit(browser, daemon.server.url) as seen:
        seen.wait_for(LIVE)
        hide = """(isHidden) => {
          Object.defineProperty(document, "hidden", { value: isHidden, configurable: true });
          document.dispatchEvent(new Event("visibilitychange"));
        }"""
        seen.page.evaluate(hide, arg=True)
        seen.page.wait_for_timeout(300)  # for a request under way
        asked = len(seen.requests)
        seen.page.wait_for_timeout(2500)  # two events would have come, and a reload of the page without scripts
        assert len(seen.requests) == asked
        assert seen.requests.count(f"{daemon.server.url}/") == 1
        with seen.page.expect_request("**/api/v1/stream"):
            seen.page.evaluate(hide, arg=False)


def test_a_screen_reader_hears_changes_and_not_numbers(daemon, browser):
    """The one live region speaks when the headline changes, not when a number does."""
    with visit(browser, daemon.server.url) as seen:
        seen.wait_for("document.querySelector('#announcement').textContent !== ''")
        spoken = seen.page.locator("#announcement").text_content()
        link = replace(daemon.snapshot.link, queue_delay_s=0.021)
        daemon.snapshot = replace(daemon.snapshot, link=link)
        seen.wait_for("document.querySelector('#verdict').textContent.includes('21 ms')")
        assert seen.page.locator("#announcement").text_content() == spoken
        assert seen.page.evaluate("document.querySelectorAll('[aria-live], [role=alert], [role=status]').length") == 1


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_everything_can_be_read(daemon, browser, scheme):
    """In both schemes every text has the contrast WCAG asks for, also what warns and what is old."""
    gone = replace(daemon.snapshot.observation, counters=None)
    with visit(browser, daemon.server.url, color_scheme=scheme) as seen:
        seen.wait_for(LIVE)
        ratios = [seen.least_contrast()]
        daemon.snapshot = replace(daemon.snapshot, observation=gone, config_error="line 3")
        seen.wait_for("document.querySelector('#verdict').dataset.mark === 'error'")
        ratios.append(seen.least_contrast())
        daemon.late_s = 30.0
        seen.wait_for("document.body.dataset.freshness === 'stale'")
        ratios.append(seen.least_contrast())
        assert min(ratios)[0] >= LEAST_CONTRAST, ratios


def test_no_width_overflows(daemon, browser):
    """From a small phone to a wide screen the page itself never scrolls sideways; wide tables do inside."""
    with visit(browser, daemon.server.url, size=PHONE) as seen:
        seen.wait_for("document.querySelectorAll('canvas').length === 4")
        for width in (390, 320, 700, 1000, 1920):
            seen.page.set_viewport_size({"width": width, "height": 800})
            seen.wait_for("document.documentElement.scrollWidth <= document.documentElement.clientWidth")
            assert seen.page.locator("#topics tbody th").first.bounding_box()["width"] > 80, width


def test_without_scripts_it_is_one_sentence_that_renews_itself(daemon, browser):
    """Without JavaScript the page has the verdict and a link to the status as JSON, and reloads itself."""
    with visit(browser, daemon.server.url, size=PHONE, java_script_enabled=False) as seen:
        assert seen.texts("#verdict p")[0].startswith("The link is the limit")
        assert seen.page.locator("noscript a[href='api/v1/status']").is_visible()
        assert not seen.page.locator("#live").is_visible()
        with seen.page.expect_navigation(timeout=20_000):
            pass


def test_the_keyboard_reaches_everything(daemon, browser):
    """Tab goes over the skip link, the choice of the topic, every table and the links, and shows where it is."""
    with visit(browser, daemon.server.url) as seen:
        seen.wait_for("document.querySelector('#chosen').options.length > 0")
        stops = []
        for _ in range(14):
            seen.page.keyboard.press("Tab")
            stops.append(
                seen.page.evaluate(
                    "[document.activeElement.localName, getComputedStyle(document.activeElement).outlineStyle]"
                )
            )
        assert {"a", "select", "div"} <= {name for name, _ in stops}
        assert all(outline != "none" for name, outline in stops if name != "body")


def test_landmarks_headings_and_tables_are_named(daemon, browser):
    """The page has its landmarks, headings in order, captions and scopes, and each chart a text that says the same."""
    with visit(browser, daemon.server.url) as seen:
        seen.wait_for("document.querySelectorAll('canvas').length === 4")
        query = seen.page.evaluate
        assert [
            query(f"document.querySelectorAll('{name}').length") for name in ("header", "main", "footer", "h1")
        ] == [1] * 4
        levels = query("[...document.querySelectorAll('h1, h2, h3')].map((h) => Number(h.localName[1]))")
        assert all(later - earlier <= 1 for earlier, later in pairwise(levels))
        assert query("[...document.querySelectorAll('.scroll th')].every((th) => th.scope)")
        assert query("[...document.querySelectorAll('.scroll table')].every((t) => t.caption.textContent)")
        named = "(chart) => document.getElementById(chart.getAttribute('aria-labelledby')).textContent"
        texts = query(f"[...document.querySelectorAll('.chart')].map({named})")
        assert "to 20.0; budget 3.40 Mbit/s now, 3.40 to 3.40; delivered" in texts[0]
        assert all(texts)


class _Prefix(BaseHTTPRequestHandler):
    """A reverse proxy that serves the daemon under /robots/seven/."""

    upstream = 0

    def do_GET(self):
        if not self.path.startswith("/robots/seven/"):
            self.send_error(404)
            return
        connection = HTTPConnection("127.0.0.1", self.upstream, timeout=10)
        connection.request("GET", self.path.removeprefix("/robots/seven"))
        answer = connection.getresponse()
        self.send_response(answer.status)
        for name, value in answer.getheaders():
            if name not in {"Connection", "Date", "Server", "Transfer-Encoding"}:
                self.send_header(name, value)
        self.end_headers()
        with suppress(OSError):
            while part := answer.read1():
                self.wfile.write(part)

    def log_message(self, *args):
        pass


def test_it_works_under_a_path_of_a_proxy(daemon, browser):
    """Behind a reverse proxy under a path, the page finds everything relative to itself."""
    handler = type("Handler", (_Prefix,), {"upstream": daemon.server.port})
    proxy = ThreadingHTTPServer(("127.0.0.1", 0), handler)
    threading.Thread(target=proxy.serve_forever, daemon=True).start()
    try:
        with visit(browser, f"http://127.0.0.1:{proxy.server_port}/robots/seven/") as seen:
            seen.wait_for(LIVE)
            seen.wait_for("document.querySelectorAll('canvas').length === 4")
            assert seen.complaints == []
    finally:
        proxy.shutdown()
        proxy.server_close()


def test_it_works_behind_tls_and_a_password(daemon, browser, tmp_path):
    """With TLS and a user, the browser asks once; scripts and events are let in, too."""
    make_certificate(tmp_path, "server")
    web = tmp_path / "web.yaml"
    web.write_text(
        f"tls_server_config: {{cert_file: server.crt, key_file: server.key}}\nbasic_auth_users: {{robot: '{HASH}'}}\n"
    )
    guarded = Daemon(daemon.snapshot)
    guarded.start(web_config=web)
    try:
        credentials = {"username": "robot", "password": PASSWORD}
        with visit(browser, guarded.server.url, http_credentials=credentials) as seen:
            seen.wait_for(LIVE)
            seen.wait_for("document.querySelectorAll('canvas').length === 4")
            assert seen.complaints == []
    finally:
        guarded.server.stop()
