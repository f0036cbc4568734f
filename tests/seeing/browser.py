"""The Chromium of apt, without a window, and the faults of a page in it."""

from __future__ import annotations

import shutil
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import pytest
from playwright.sync_api import sync_playwright

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
# Contrast that text needs against its background (WCAG 2.2 AA, 1.4.3 and 1.4.11).
LEAST_CONTRAST = 4.5


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

    def wait_for(self, expression: str, *, timeout_s: float = 30.0) -> None:
        """Wait until a JavaScript expression is true."""
        self.page.wait_for_function(f"() => {expression}", timeout=timeout_s * 1000)

    def texts(self, selector: str) -> list[str]:
        """Return the text of every visible element, with its white space joined."""
        return [" ".join(text.split()) for text in self.page.locator(selector).all_inner_texts()]

    def last_status(self) -> dict[str, Any]:
        """Cut the page off, from the stream first, and return its last status document, which it goes on showing."""
        answers: list[Any] = []
        self.page.on("response", lambda answer: answer.url.endswith("/api/v1/status") and answers.append(answer.json()))
        # Without the stream, whose events playwright cannot read, the page asks for each document.
        self.page.route("**/api/v1/stream", lambda route: route.abort())
        with self.page.expect_response("**/api/v1/status"):
            self.page.reload()
        self.page.context.set_offline(True)
        self.wait_for("document.body.dataset.freshness === 'lost'")
        return answers[-1]

    def least_contrast(self) -> tuple[float, str]:
        """Return the lowest contrast of any text against its background, and the text."""
        ratio, text = self.page.evaluate(_CONTRAST)
        return ratio, text

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

# For every visible text: its colour over the backgrounds of its elements, by the formula of WCAG 2.
_CONTRAST = """() => {
  const parse = (color) => (color.match(/[\\d.]+/g) ?? []).map(Number);
  const over = ([r, g, b, a = 1], under) => [r, g, b].map((part, index) => part * a + under[index] * (1 - a));
  const luminance = (color) => {
    const [r, g, b] = color.map((part) => (part /= 255) <= 0.04045 ? part / 12.92 : ((part + 0.055) / 1.055) ** 2.4);
    return 0.2126 * r + 0.7152 * g + 0.0722 * b;
  };
  const background = (element) => {
    const chain = [];
    for (let at = element; at; at = at.parentElement) chain.unshift(parse(getComputedStyle(at).backgroundColor));
    return chain.reduce((under, color) => over(color, under), [255, 255, 255]);
  };
  let least = [Infinity, "no text at all"];
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (walker.nextNode()) {
    const element = walker.currentNode.parentElement;
    if (!walker.currentNode.data.trim() || !element.checkVisibility() || element.closest(".unseen")) continue;
    const behind = background(element);
    const front = over(parse(getComputedStyle(element).color), behind);
    const [light, dark] = [luminance(front), luminance(behind)].sort((a, b) => b - a);
    const ratio = (light + 0.05) / (dark + 0.05);
    if (ratio < least[0]) least = [ratio, walker.currentNode.data.trim()];
  }
  return least;
}"""
