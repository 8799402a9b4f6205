"""Take screenshots of a report in a headless Chromium, and time frames of its turning cloud without a graphics card.

scripts/make_pictures.py runs/latest/report.html --out shots
"""

from __future__ import annotations

import argparse
import shutil
import statistics
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from selenium import webdriver

PARTS = ("#first", "#map", ".part", "#cameras", "#pairs", "#trends", "#time")
TURN = """
const done = arguments[arguments.length - 1], began = performance.now(), view = window.view, all = arguments[0];
view.frames.length = 0;
(function step() {
  if (all) { view.yaw += 0.01; view.moving = false; view.paint(false); } else view.turn(0.01, 0);
  if (performance.now() - began < 3000) requestAnimationFrame(step); else done(view.frames.slice());
})();"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("page", type=Path)
    parser.add_argument("--out", type=Path, default=Path("shots"), help="folder of the pictures (default: shots)")
    parser.add_argument("--size", default="1440x900", help="size of the window (default: 1440x900); 390x844 is that of a phone")
    parser.add_argument("--dark", action="store_true")
    options = parser.parse_args()
    width, height = map(int, options.size.split("x"))
    options.out.mkdir(parents=True, exist_ok=True)
    browser = opened(options.page, width, height, options.dark)
    try:
        for words, every in (("every point", True), ("as many as the view draws while it moves", False)):
            frames = browser.execute_async_script(TURN, every)
            drawn = browser.execute_script("return view.root.dataset.drawn")
            print(
                f"{words}: {int(drawn):,} points, median {statistics.median(frames):.0f} ms a frame, {len(frames)} frames in 3 s"
            )
        browser.execute_script("Object.assign(view, view.home); view.draw()")
        for part in PARTS:
            if browser.execute_script("const e = document.querySelector(arguments[0]); e?.scrollIntoView(); return !!e", part):
                time.sleep(1)
                taken = cv2.imdecode(np.frombuffer(browser.get_screenshot_as_png(), np.uint8), cv2.IMREAD_COLOR)
                assert taken is not None
                cv2.imwrite(str(options.out / f"{part.strip('#.')}.jpg"), taken, [cv2.IMWRITE_JPEG_QUALITY, 80])
        print(f"pictures in {options.out}; messages of the browser: {browser.get_log('browser') or 'none'}")
    finally:
        browser.quit()


def opened(page: Path, width: int, height: int, dark: bool) -> Any:
    """A browser with the page open and its points unpacked."""
    options = webdriver.ChromeOptions()
    options.binary_location = shutil.which("chromium") or "chromium"
    for argument in ("--headless=new", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", f"--window-size={width},{height}"):
        options.add_argument(argument)
    browser = webdriver.Chrome(options=options, service=webdriver.ChromeService(shutil.which("chromedriver")))
    size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 600}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    scheme = {"features": [{"name": "prefers-color-scheme", "value": "dark" if dark else "light"}]}
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", scheme)
    browser.get(page.resolve().as_uri())
    while browser.execute_script("return document.querySelector('#view')?.dataset.state") == "waiting":
        time.sleep(0.2)
    return browser


if __name__ == "__main__":
    main()
