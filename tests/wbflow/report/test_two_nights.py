"""Two nights in one view in a browser: a slider wipes between them, they blink, and heights and pictures are compared."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.helpers import made_up_run
from tests.helpers.browser import chromium, until
from tests.wbflow.report.test_report import Keys, settled, webdriver


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """A browser that shows the page of a night with a reference."""
    night = replace(made_up_run.record(made_up_run.names(5)), reference="20261031T031500Z")
    page = made_up_run.page(tmp_path_factory.mktemp("page"), night, points=20_000)
    with chromium(900, 700) as driver:
        driver.get(page.as_uri())
        until(driver, "return document.querySelector('#view').dataset.state === 'ready'")
        yield driver


@pytest.fixture(autouse=True)
def _as_it_was(browser: Any) -> Iterator[None]:
    until(browser, "return !!window.nights")
    yield
    browser.execute_script("nights.blink(false); nights.show(0); document.querySelector('[data-mode=photograph]').click()")


def slider(browser: Any) -> Any:
    return browser.find_element("css selector", ".nights input")


def test_the_slider_wipes_from_one_night_to_the_other(browser: Any) -> None:
    tonight = settled(browser, lambda: None)
    webdriver.ActionChains(browser, duration=20).click(slider(browser)).perform()
    half = settled(browser, lambda: None)
    assert 0.3 < browser.execute_script("return view.wipe") < 0.7, "the middle was clicked"
    then = settled(browser, lambda: slider(browser).send_keys(Keys.END))
    assert browser.execute_script("return view.wipe") == 1
    assert len({tonight, half, then}) == 3
    shown = "return [...document.querySelectorAll('.nights .shown')].map(e => e.textContent)"
    assert browser.execute_script(shown) == ["2026-10-31"]
    assert settled(browser, lambda: slider(browser).send_keys(Keys.HOME)) == tonight
    assert browser.execute_script(shown) == ["2026-12-09"]


def test_the_nights_blink_until_the_button_is_clicked_again(browser: Any) -> None:
    button = browser.find_element("css selector", "[data-do=blink]")
    browser.execute_script("arguments[0].focus()", button)
    button.send_keys(Keys.SPACE)
    assert button.get_attribute("aria-pressed") == "true"
    until(browser, "return view.wipe === 1")
    until(browser, "return view.wipe === 0")
    button.click()
    assert button.get_attribute("aria-pressed") == "false"


def test_the_difference_mode_shows_height_differences_between_the_nights(browser: Any) -> None:
    browser.find_element("css selector", "[data-mode=difference]").click()
    settled(browser, lambda: None)
    found = browser.execute_script("""
        const p = view.sets.find(s => s.name === "product").points, l = p.layers.difference, t = view.scene.axes, out = [];
        for (let i = 0; i < p.n; i++) out.push([measure.world([p.at[3 * i], p.at[3 * i + 1], p.at[3 * i + 2]])[0],
          l.low + (l.high - l.low) * l.of[i] / 255]);
        return out;""")
    x, difference = np.array(found).T
    assert np.median(difference[x > 4.5]) == pytest.approx(2.0, abs=0.25)
    assert np.median(np.abs(difference[x < 3.5])) < 0.1
    assert browser.find_element("css selector", ".legend").is_displayed()


def test_a_link_restores_the_slider_and_the_colour_mode(browser: Any) -> None:
    slider(browser).send_keys(Keys.END, *[Keys.ARROW_LEFT] * 30)
    browser.find_element("css selector", "[data-mode=difference]").click()
    browser.execute_script("document.querySelector('[data-do=link]').click()")
    link = browser.find_element("css selector", "[data-do=link]").get_attribute("data-copied")
    browser.execute_script("nights.show(0); document.querySelector('[data-mode=photograph]').click()")
    browser.execute_script("location.hash = ''; location.hash = arguments[0]", link.partition("#")[2])
    until(browser, "return view.wipe === 0.7 && view.mode === 'difference'")
    assert slider(browser).get_attribute("value") == "70"


def test_the_pictures_of_a_camera_are_overlaid_and_aligned(browser: Any) -> None:
    card = browser.find_element("css selector", "#camera-1")
    summary = card.find_element("css selector", "details:has(.both) summary")
    browser.execute_script("arguments[0].scrollIntoView({block: 'center'})", summary)
    summary.send_keys(Keys.ENTER)
    both = card.find_element("css selector", ".both")
    now, then = (both.find_element("css selector", name) for name in (".now", ".then"))
    until(browser, f"return document.querySelector('#camera-1 .now img').clientWidth === {round(both.rect['width'])}")
    handle = both.find_element("css selector", "input")
    handle.send_keys(Keys.HOME)
    clip = "return getComputedStyle(arguments[0]).clipPath"
    assert browser.execute_script(clip, now).endswith(" 0%)")
    handle.send_keys(Keys.END)
    assert browser.execute_script(clip, now).endswith("100%)")
    # on the other night the camera was turned 2 degrees to the right, so its picture has to lie further right
    across = "return new DOMMatrix(getComputedStyle(arguments[0]).transform).m41 / arguments[0].clientWidth"
    moved = browser.execute_script(across, then)
    assert moved == pytest.approx(np.tan(np.radians(2.0)) * 500 / 640, rel=0.4)
    other = browser.find_element("css selector", "#camera-2 .then")
    assert browser.execute_script("return arguments[0].style.transform", other) == "", "it has not turned"


def test_a_night_without_a_reference_has_no_slider(tmp_path: Path) -> None:
    page = made_up_run.page(tmp_path, made_up_run.record(made_up_run.names(3)), nights=0).read_text()
    assert 'class="nights"' not in page and 'class="both"' not in page and 'data-mode="difference"' not in page
