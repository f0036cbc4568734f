"""Take pictures of a real run of arpd: the page, on a desk and on a phone, and `arpd top`.

The demo's robot meets a slower link, an outage and a slower link again; then come the pictures. Needs network
namespaces (root) and the Chromium of apt.
"""

from __future__ import annotations

import argparse
import io
import math
import re
import shutil
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, closing
from functools import partial
from pathlib import Path

from PIL import Image
from playwright.sync_api import Browser, Page, ViewportSize, sync_playwright
from rich._export_format import CONSOLE_SVG_FORMAT
from rich.console import Console
from rich.screen import Screen

from arpd.cli.client import Daemon
from arpd.cli.frame import Frame
from arpd.cli.options import read_address
from arpd.cli.output import progress
from arpd.model.errors import ArpdError
from scripts.bench.links import MBIT
from scripts.bench.report import REPO
from scripts.bench.robots import demo_robot
from scripts.bench.sides import SIDES
from scripts.bench.world import world_of
from scripts.netns.simlink import available
from scripts.robot.demo import DemoError
from scripts.robot.proxy import HTTP_PORT, window

_FAST, _SLOW, _OUT = (20 * MBIT, 0.0), (5 * MBIT, 0.0), (2000.0, 1.0)
_COURSE = [(0.0, *_FAST), (30.0, *_SLOW), (55.0, *_OUT), (66.0, *_SLOW), (72.0, *_FAST), (97.0, *_SLOW)]
_DURATION_S = 120.0
_SWITCHES = ["--no-sandbox", "--disable-gpu", "--disable-quic", "--disable-background-networking"]
_COLUMNS, _LINES = 126, 36
_FONT = "DejaVu Sans Mono, Liberation Mono, monospace"


def main() -> int:
    argparse.ArgumentParser(prog="scripts/screenshots", description=__doc__).parse_args()
    try:
        run_and_take(REPO / "scripts" / "pictures")
    except ArpdError as error:
        print(f"scripts/screenshots: {error}", file=sys.stderr)
        return error.exit_code
    return 0


def run_and_take(folder: Path) -> None:
    usable, reason = available()
    if not usable:
        raise DemoError(f"a real run needs network namespaces ({reason}); run this as root")
    chromium = shutil.which("chromium") or shutil.which("chromium-browser")
    if chromium is None:
        raise DemoError("chromium is not installed; apt-get install chromium")
    logs = Path(tempfile.mkdtemp(prefix="arpd-screenshots-"))
    print(f"logs in {logs}", file=sys.stderr)
    with (
        world_of(demo_robot(), SIDES["two_ends"], rate=_FAST[0], logs=logs) as world,
        ExitStack() as stack,
        window(world.link.robot, HTTP_PORT) as url,
        progress("the robot at work", total=_DURATION_S) as shown,
        sync_playwright() as playwright,
        closing(playwright.chromium.launch(executable_path=chromium, args=_SWITCHES)) as browser,
    ):
        world.start(stack)
        world.begin(math.inf)
        desk = _open(browser, url, {"width": 1280, "height": 1030})
        phone = _open(browser, url, {"width": 390, "height": 1180}, scale=1.25)
        events = [(float(at_s), partial(shown, at_s, "")) for at_s in range(int(_DURATION_S))]
        world.follow(_COURSE, time.monotonic(), _DURATION_S, events=events)
        desk.wait_for_timeout(1500)  # one or two looks, so that the charts are up to date
        _write(folder / "page.png", desk.screenshot())
        _write(folder / "page-phone.png", phone.screenshot())
        with ThreadPoolExecutor() as elsewhere:  # playwright has this thread's event loop
            frame = elsewhere.submit(_asked, url).result()
        _write(folder / "top.png", _drawn(browser, frame))
    for path in sorted(folder.glob("*.png")):
        print(f"{path}: {path.stat().st_size / 1024:.0f} KiB")


def _open(browser: Browser, url: str, size: ViewportSize, *, scale: float = 1.0) -> Page:
    page = browser.new_context(viewport=size, color_scheme="light", device_scale_factor=scale).new_page()
    page.goto(url)
    page.wait_for_function("() => document.body.dataset.freshness === 'live' && document.querySelector('canvas')")
    return page


def _asked(url: str) -> Frame:
    with Daemon(argparse.Namespace(url=read_address(url), cacert=None, user="")) as daemon:
        return Frame(status=daemon.status(), history=daemon.history(), url="http://robot.local:9464")


def _drawn(browser: Browser, frame: Frame) -> bytes:
    """Draw a frame of `arpd top` as a terminal would."""
    console = Console(record=True, width=_COLUMNS, height=_LINES, file=io.StringIO(), force_terminal=True)
    console.print(Screen(frame))
    # Without rich's web fonts, which the browser would download.
    plain = re.sub(r"@font-face \{\{.*?\}\}\n", "", CONSOLE_SVG_FORMAT, flags=re.DOTALL).replace("Fira Code", _FONT)
    page = browser.new_context(device_scale_factor=1).new_page()
    page.set_content(f"<body style='margin:0'>{console.export_svg(title='arpd top', code_format=plain)}</body>")
    picture = page.locator("svg.rich-terminal")
    picture.evaluate("(svg) => { svg.style.width = '1280px'; svg.style.display = 'block'; }")
    return picture.screenshot(omit_background=True)


def _write(path: Path, png: bytes) -> None:
    """Write a picture with 128 colours, enough for a screenshot of text."""
    colours = Image.open(io.BytesIO(png)).convert("RGB")
    colours.quantize(128, method=Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE).save(path, optimize=True)


if __name__ == "__main__":
    sys.exit(main())
