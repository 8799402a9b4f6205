"""A headless Chromium for tests of pages."""

from __future__ import annotations

import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

PATIENCE_S = 120.0
"""Longest wait for a page, seconds; the machine may be busy with other things."""


@contextmanager
def chromium(width: int, height: int) -> Iterator[Any]:
    """Start a browser with a window of this size in pixels; skip the test if none is installed."""
    webdriver = pytest.importorskip("selenium.webdriver")
    binary = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    driver = shutil.which("chromedriver")
    if not (binary and driver):
        pytest.skip("there is no chromium with its chromedriver here: scripts/setup.sh installs them for the tests")
    options = webdriver.ChromeOptions()
    options.binary_location = binary
    window = f"--window-size={width},{height}"
    for argument in ("--headless=new", "--no-sandbox", "--disable-gpu", window, "--disable-background-networking"):
        options.add_argument(argument)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    browser = webdriver.Chrome(options=options, service=webdriver.ChromeService(driver))
    try:
        yield browser
    finally:
        browser.quit()


def until(browser: Any, script: str) -> Any:
    """Run a script again and again until its result is true; return that."""
    end = time.monotonic() + PATIENCE_S
    while not (found := browser.execute_script(script)):
        assert time.monotonic() < end, script
        time.sleep(0.05)
    return found
