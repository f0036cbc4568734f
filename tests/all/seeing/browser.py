"""The Chromium of apt, without a window, and the faults of a page in it."""

from __future__ import annotations

import shutil
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import pytest
from playwright.sync_api import sync_playwright

from tests.waiting import PATIENCE_S, eventually

if TYPE_CHECKING:
    from collections.abc import Iterator

    from playwright.sync_api import Browser, Page

_SWITCHES = (
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)
PHONE = {"width": 390, "height": 844}
DESKTOP = {"width": 1440, "height": 900}


@contextmanager
def chromium() -> Iterator[Browser]:
    """Start the browser; skip the test without one."""
    path = shutil.which("chromium") or shutil.which("chromium-browser")
    if path is None:
        pytest.skip("chromium is not installed (apt-get install chromium)")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=list(_SWITCHES))
        try:
            yield browser
        finally:
            browser.close()


@dataclass
class Visit:
    """One page, and all its faults.

    Attributes
    ----------
    complaints : console errors and warnings, exceptions, breaches of the content security policy
    requests : every address that the page requested
    """

    page: Page
    complaints: list[str] = field(default_factory=list)
    requests: list[str] = field(default_factory=list)

    def says(self, expression: str) -> Any:
        """Return the value of a JavaScript expression."""
        return self.page.evaluate(f"() => {expression}")

    def await_live(self) -> None:
        """Wait until the page follows its daemon."""
        eventually("the page is live", lambda: self.says("document.body.dataset.freshness === 'live'"))

    def await_charts(self) -> None:
        """Wait until all charts are drawn."""
        eventually("the charts are drawn", lambda: self.says("document.querySelectorAll('canvas').length === 4"))

    def texts(self, selector: str) -> list[str]:
        """Return the text of every visible element, with its white space joined."""
        return [" ".join(text.split()) for text in self.page.locator(selector).all_inner_texts()]

    def drawn(self, selector: str) -> int:
        """Return the number of painted pixels of a canvas."""
        return self.page.evaluate(_DRAWN, selector)


@contextmanager
def visit(browser: Browser, url: str, *, size: dict[str, int] | None = None, **options: Any) -> Iterator[Visit]:
    """Open an address in a fresh browser context.

    Parameters
    ----------
    size : of the window, by default `DESKTOP`
    options : of playwright's ``new_context``: color_scheme, java_script_enabled, http_credentials …
    """
    context = browser.new_context(viewport=size or DESKTOP, ignore_https_errors=True, **options)
    try:
        context.set_default_timeout(PATIENCE_S * 1000)
        seen = Visit(context.new_page())
        seen.page.on("console", lambda said: said.type in {"error", "warning"} and seen.complaints.append(said.text))
        seen.page.on("pageerror", lambda error: seen.complaints.append(str(error)))
        seen.page.on("request", lambda request: seen.requests.append(request.url))
        seen.page.goto(url)
        yield seen
    finally:
        context.close()


_DRAWN = """(selector) => {
  const canvas = document.querySelector(selector);
  const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
  let drawn = 0;
  for (let at = 3; at < data.length; at += 4) if (data[at] > 0) drawn += 1;
  return drawn;
}"""
