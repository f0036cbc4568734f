"""The page in a real browser, with a daemon made by hand."""

import re
import shutil
from contextlib import ExitStack, closing
from dataclasses import dataclass, field, replace

import pytest
from playwright.sync_api import sync_playwright

from arpd.model.settings import HttpSettings, OnLost, Settings
from arpd.report.conditions import Condition, Event, Happening, Severity
from arpd.report.history import History
from tests.golden.sample import FINISHED_AT_S, looked
from tests.sample_publishers import publisher
from tests.unit.web_world import HASH, PASSWORD, make_certificate, server_of
from tests.waiting import PATIENCE_S, eventually

HOSTILE = "/<img src=x onerror=alert(1)>\"'&amp;</script><script>alert(2)</script>"
PHONE, DESKTOP = {"width": 390, "height": 844}, {"width": 1440, "height": 900}
SWITCHES = ["--no-sandbox", "--disable-gpu", "--disable-quic", "--disable-background-networking"]
DRAWN = """(selector) => {
  const canvas = document.querySelector(selector);
  const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
  return data.filter((value, at) => at % 4 === 3 && value > 0).length;
}"""


@dataclass
class Daemon:
    """A daemon whose snapshot and clock the tests set."""

    snapshot: object
    history: History = field(default_factory=History)
    late_s: float = 0.0
    server: object = None
    up: ExitStack = field(default_factory=ExitStack)

    def __post_init__(self):
        for second in range(120):
            link = replace(self.snapshot.link, capacity_bytes_per_second=2.5e6 if second < 60 else 6e5)
            self.history.note(self.at(replace(self.snapshot, link=link), second - 119.0))

    def at(self, snapshot, later_s):
        return replace(snapshot, finished_at_s=FINISHED_AT_S + later_s, unix_time_s=self.snapshot.unix_time_s + later_s)

    def start(self, port=0, **options):
        self.server = server_of(
            HttpSettings(port=port, web_config=options.pop("web_config", None)),
            snapshot=lambda: self.snapshot,
            history=self.history,
            clock=lambda: FINISHED_AT_S + self.late_s,
            **options,
        )
        self.up.enter_context(self.server.up())
        return self.server.url

    def stop(self):
        self.up.close()


class Visit:
    """One page that follows its daemon, and all its faults.

    Attributes
    ----------
    complaints : console errors and warnings, exceptions, dialogs, breaches of the content security policy
    requests : every address that the page requested
    """

    def __init__(self, page, url):
        self.page, self.complaints, self.requests = page, [], []
        page.on("console", lambda said: said.type in {"error", "warning"} and self.complaints.append(said.text))
        page.on("pageerror", lambda error: self.complaints.append(str(error)))
        page.on("dialog", lambda dialog: (self.complaints.append(dialog.message), dialog.dismiss()))
        page.on("request", lambda request: self.requests.append(request.url))
        page.goto(url)
        self.await_live()

    def says(self, expression):
        """Return the value of a JavaScript expression."""
        return self.page.evaluate(f"() => {expression}")

    def await_live(self):
        eventually("the page is live", lambda: self.says("document.body.dataset.freshness === 'live'"))

    def await_charts(self):
        eventually("the charts are drawn", lambda: self.says("document.querySelectorAll('canvas').length === 4"))

    def texts(self, selector):
        """Return the text of every visible element, with its white space joined."""
        return [" ".join(text.split()) for text in self.page.locator(selector).all_inner_texts()]

    def drawn(self, selector):
        """Return the number of painted pixels of a canvas."""
        return self.page.evaluate(DRAWN, selector)


@pytest.fixture(scope="module")
def browser():
    path = shutil.which("chromium") or shutil.which("chromium-browser")
    if path is None:
        pytest.skip("chromium is not installed (apt-get install chromium)")
    with (
        sync_playwright() as playwright,
        closing(playwright.chromium.launch(executable_path=path, args=SWITCHES)) as started,
    ):
        yield started


@pytest.fixture
def visit(browser, daemon):
    """Return a function that opens an address, by default the daemon's, in a fresh browser context."""
    with ExitStack() as stack:

        def visit(url=None, *, size=DESKTOP, **options):
            context = browser.new_context(viewport=size, ignore_https_errors=True, **options)
            stack.callback(context.close)
            context.set_default_timeout(PATIENCE_S * 1000)
            return Visit(context.new_page(), url or daemon.server.url)

        yield visit


@pytest.fixture
def daemon(sample_snapshot):
    events = tuple(
        Event(number=n, at_s=910.0 + n, unix_time_s=1.7e9 - 90 + n, kind=kind, severity=severity, text=text)
        for n, kind, severity, text in (
            (1, Happening.PLAN, Severity.WARNING, "link fell to 4.8 Mbit/s: /camera/image 30 → 2.1 Hz"),
            (2, Condition.OUTAGE, Severity.ERROR, "the link carries nothing"),
            (3, Condition.OUTAGE, Severity.INFO, "ended after 9 s: the link carries nothing"),
        )
    )
    running = Daemon(replace(sample_snapshot, events=events))
    running.start()
    yield running
    running.stop()


def test_the_document_stands_in_its_places_and_nobody_else_is_asked(daemon, visit):
    """All show the document's values, the log the newest first; no request to another host, no breach of the policy."""
    settings = Settings(on_lost=OnLost.BASELINE)
    daemon.snapshot = looked(daemon.snapshot, config_error="line 3", settings=settings)
    seen = visit()
    (verdict,) = seen.texts("#verdict p")
    assert verdict.startswith("The link is the limit")
    assert any("line 3" in notice for notice in seen.texts(".notice[data-mark=warning]"))
    tiles = " ".join(seen.texts(".tiles > div"))
    assert "Capacity 4.00 Mbit/s peer: 3 trains, median 500 kB/s" in tiles
    assert "Cross traffic 0.50 Mbit/s leaves 3.50 Mbit/s" in tiles
    assert "2 of 3 publishers confirmed" in tiles
    image, command, *_ = seen.texts("#topics tbody tr")
    assert image.startswith("/camera/image /camera, sensing 30.0 12.5 11.5 link 50.0 % of the link 10 / 10")
    assert "did not match the new writer in 5 s" in command
    told = (
        "ended after 9 s: the link carries nothing",
        "Error: the link carries nothing",
        "Warning: link fell to 4.8 Mbit/s: /camera",
    )
    assert all(text in line for text, line in zip(told, seen.texts("#log li"), strict=True))
    facts = " ".join(seen.texts(".facts > div"))
    assert "after 30.0 s without this daemon" in facts
    assert "edge-c001, last report 12.5 s ago" in facts
    seen.await_charts()
    assert all(seen.drawn(f"#chart-{name} canvas") > 500 for name in ("rate", "delay", "allowed", "topic"))
    asked = {request.removeprefix(daemon.server.url).split("/")[1] for request in seen.requests}
    assert asked <= {"", "api", "assets", "data:,"}
    assert seen.complaints == []


def test_news_does_not_look_like_a_warning(daemon, visit):
    """A finding of severity info beside the verdict has other colours than one of severity warning."""
    look = """(mark) => {
      const notice = document.querySelector(".notice");
      notice.dataset.mark = mark;
      return getComputedStyle(notice).backgroundColor;
    }"""
    daemon.snapshot = looked(daemon.snapshot, config_error="line 3")
    seen = visit()
    assert len({seen.page.evaluate(look, mark) for mark in ("info", "warning", "error")}) == 3


def test_names_from_the_network_stay_text(daemon, visit):
    """Markup in names, reasons and events is shown as it is written, and runs nothing."""
    evil = publisher(HOSTILE, HOSTILE, refusal=HOSTILE, published_rate_hz=1.0)
    observation = replace(daemon.snapshot.observation, publishers=(evil,))
    events = (replace(daemon.snapshot.events[0], text=HOSTILE),)
    link = replace(daemon.snapshot.link, evidence=HOSTILE)
    daemon.snapshot = looked(
        daemon.snapshot, observation=observation, events=events, link=link, interface=HOSTILE, config_error=HOSTILE
    )
    daemon.history.note(daemon.at(daemon.snapshot, 1.0))
    seen = visit()
    eventually("topics can be chosen", lambda: seen.says("document.querySelector('#chosen').options.length > 0"))
    assert seen.page.evaluate("document.querySelectorAll('main img, main script').length") == 0
    assert seen.page.locator("#topics tbody th").inner_text().startswith(HOSTILE)
    assert HOSTILE in seen.page.locator("#log li").inner_text()
    assert seen.complaints == []


def test_it_says_when_the_daemon_is_gone_and_recovers_by_itself(daemon, visit):
    """Without an answer the page greys out and counts the age, as when no tick finishes; then it is live again."""
    port = daemon.server.port
    seen = visit()

    def is_now(freshness):
        return seen.says("document.body.dataset.freshness") == freshness

    daemon.stop()
    eventually("the page misses its daemon", lambda: is_now("lost"))
    assert "the daemon cannot be reached · as of" in seen.page.locator("#freshness").inner_text()
    assert "grayscale" in seen.says("getComputedStyle(document.querySelector('main')).filter")
    before = seen.page.locator("#freshness").inner_text()
    eventually("the age grows", lambda: seen.page.locator("#freshness").inner_text() != before)
    daemon.start(port)
    seen.await_live()
    daemon.late_s = 30.0
    eventually("the page sees that the daemon hangs", lambda: is_now("stale"))
    said = seen.page.locator("#freshness").inner_text()
    assert "no tick finishes" in said
    assert int(re.search(r"(\d+) s ago", said)[1]) >= 30


def test_nobody_asks_while_nobody_looks(daemon, visit):
    """A hidden page asks for nothing; visible again, it asks at once."""
    hide = """(isHidden) => {
      Object.defineProperty(document, "hidden", { value: isHidden, configurable: true });
      document.dispatchEvent(new Event("visibilitychange"));
    }"""
    seen, other = visit(), visit()
    seen.page.evaluate(hide, arg=True)
    asked = len(seen.requests)
    for fault in ("line 3", "line 4"):
        daemon.snapshot = looked(daemon.snapshot, config_error=fault)
        eventually(f"{fault} is shown", lambda fault=fault: any(fault in text for text in other.texts(".notice")))
    assert not any("line 4" in text for text in seen.texts(".notice"))
    assert len(seen.requests) <= asked + 1  # one may have been under way
    assert seen.requests.count(f"{daemon.server.url}/") == 1
    with seen.page.expect_request("**/api/v1/status"):
        seen.page.evaluate(hide, arg=False)


def test_a_clock_that_is_set_back_freezes_nothing(daemon, visit):
    """After the robot's clock went back by seconds or an hour, charts and freshness go on."""
    seen = visit()
    seen.await_charts()
    times = "document.querySelector('#text-rate').textContent"
    for back_s, capacity in ((3.0, 7.5e5), (3600.0, 8.75e5)):
        link = replace(daemon.snapshot.link, capacity_bytes_per_second=capacity)
        daemon.snapshot = replace(daemon.snapshot, link=link, unix_time_s=daemon.snapshot.unix_time_s - back_s)
        daemon.history.note(replace(daemon.snapshot, finished_at_s=FINISHED_AT_S + capacity))
        shown = f"{capacity * 8e-6:.2f} Mbit/s now"
        eventually(f"the chart has {shown}", lambda shown=shown: shown in seen.says(times))
        seen.await_live()
    assert seen.complaints == []


def test_the_times_of_an_axis_stay_apart_on_another_day(daemon, visit):
    """Where the browser's day is not the robot's, which may have no battery for its clock, no two times overlap."""
    seen = visit(size={"width": 1000, "height": 800})
    seen.await_charts()
    seen.page.evaluate("""() => {
      globalThis.times = [];
      const fill = CanvasRenderingContext2D.prototype.fillText;
      CanvasRenderingContext2D.prototype.fillText = function (text, x, y) {
        if (text.includes(":")) times.push({ canvas: this.canvas, x, width: this.measureText(text).width });
        return fill.call(this, text, x, y);
      };
    }""")
    seen.page.locator("[data-span='120']").click()
    eventually("the axes are drawn", lambda: seen.says("times.length > 20"))
    assert seen.says("""times.every((one, at) => {
      const next = times[at + 1];
      return next?.canvas !== one.canvas || next.x <= one.x || next.x - one.x > one.width;
    })""")


def test_a_hundred_topics_stay_readable(daemon, visit):
    """A hundred topics are sorted by a column and found by words, and the table scrolls inside itself."""
    many = tuple(publisher(f"/n{n % 7}", f"/t{n}", source_rate_hz=float(n)) for n in range(100))
    daemon.snapshot = replace(daemon.snapshot, observation=replace(daemon.snapshot.observation, publishers=many))
    seen = visit()
    eventually("all are there", lambda: len(seen.texts("#topics tbody th")) == 100)
    assert seen.texts("#topics tbody th")[2].startswith("/t2 ")
    seen.page.locator("th[data-sort='confirmed.source_rate_hz'] button").click()
    assert seen.texts("#topics tbody th")[0].startswith("/t99 ")
    seen.page.locator("#find").fill("n3 t9")
    assert [text.split()[0] for text in seen.texts("#topics tbody th")] == ["/t94"]
    assert seen.texts("#found") == ["1 of 100"]
    assert seen.says("document.querySelector('.tall').clientHeight <= 0.9 * innerHeight")


def test_no_chart_shows_a_topic_that_is_gone_as_it_is_now(daemon, visit):
    """Where two nodes publish one topic the choice names them; where all have left the chart goes, and its sentence."""
    both = tuple(publisher(f"/n{n}", "/t", source_rate_hz=5.0) for n in range(2))
    seen, before = visit(), daemon.snapshot
    seen.await_charts()
    names = "[...document.querySelectorAll('select option')].map((option) => option.text).join()"
    sentence = "document.querySelector('#text-topic').textContent"
    for later_s, publishers, offered in ((5.0, both, "/t (/n0),/t (/n1)"), (10.0, (), "")):
        observation = replace(before.observation, publishers=publishers)
        daemon.snapshot = replace(before, observation=observation, unix_time_s=before.unix_time_s + later_s)
        eventually("they are named", lambda offered=offered: seen.says(names) == offered)
        assert ("5.00 Hz now" in seen.says(sentence)) is bool(publishers)
    assert seen.says(sentence) == ""
    assert seen.says("document.querySelector('#chart-topic').childElementCount") == 0
    assert seen.complaints == []


def test_a_gap_does_not_take_the_rates_of_a_topic(daemon, visit):
    """After a gap, as of a page that was in the background, the chart still has what it saw of the topic before."""
    before = daemon.snapshot

    def goes_on(later_s, rate_hz):
        one = publisher("/n", "/t", source_rate_hz=rate_hz)
        observation = replace(before.observation, publishers=(one,))
        now = replace(before, observation=observation, finished_at_s=FINISHED_AT_S + later_s)
        daemon.snapshot = replace(now, unix_time_s=before.unix_time_s + later_s)
        daemon.history.note(daemon.snapshot)

    def sentence():
        return seen.says("document.querySelector('#text-topic').textContent")

    goes_on(0.0, 55.0)
    seen = visit()
    eventually("the topic is drawn", lambda: "source 55.0 Hz now" in sentence())
    goes_on(4.0, 77.0)
    eventually("the page follows", lambda: "source 77.0 Hz now" in sentence())
    goes_on(20.0, 33.0)
    eventually("the page follows after the gap", lambda: "source 33.0 Hz now" in sentence())
    assert "33.0 to 77.0" in sentence()
    assert seen.complaints == []


def test_no_width_overflows(daemon, visit):
    """From a small phone to a wide screen the page itself never scrolls sideways; wide tables do inside."""
    seen = visit(size=PHONE)
    seen.await_charts()
    for width in (390, 320, 700, 1000, 1920):
        seen.page.set_viewport_size({"width": width, "height": 800})
        eventually(
            f"it fits into {width}",
            lambda: seen.says("document.documentElement.scrollWidth <= document.documentElement.clientWidth"),
        )
        assert seen.page.locator("#topics tbody th").first.bounding_box()["width"] > 80, width


def test_the_keyboard_reaches_everything(daemon, visit):
    """Tab goes over the skip link, the choice of the topic, every table and the links, and shows where it is."""
    seen = visit()
    eventually("topics can be chosen", lambda: seen.says("document.querySelector('#chosen').options.length > 0"))
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


def test_it_works_behind_tls_and_a_password(daemon, visit, tmp_path):
    """With TLS and a user, the browser asks once; scripts and documents are let in, too."""
    make_certificate(tmp_path, "server")
    web = tmp_path / "web.yaml"
    web.write_text(
        f"tls_server_config: {{cert_file: server.crt, key_file: server.key}}\nbasic_auth_users: {{robot: '{HASH}'}}\n"
    )
    guarded = Daemon(daemon.snapshot)
    guarded.start(web_config=str(web))
    try:
        credentials = {"username": "robot", "password": PASSWORD}
        seen = visit(guarded.server.url, http_credentials=credentials)
        seen.await_charts()
        assert seen.complaints == []
    finally:
        guarded.stop()
