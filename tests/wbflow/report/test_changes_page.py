"""What has changed, on the report's page in a browser: coloured in the view, and beside what was there before."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest

from tests.helpers import made_up_run
from tests.helpers.browser import chromium, until
from tests.wbflow.report.test_report import Keys, settled
from wbflow.pipeline.summaries import ChangesSummary, RecordedChange
from wbflow_stages.exports.view import changes_view
from wbflow_stages.types import NEW, SAME, VANISHED, Changes, GroundGrid

CELL = 0.25
"""One point of each cube of this edge is in the comparison of nights: one of four, as in a real one."""


def changed_bowl() -> Changes:
    """The eastern rim of the bowl is new; a wall 2 m above its middle has vanished."""
    cloud = made_up_run.bowl(20_000)
    _, chosen = np.unique(np.floor(cloud.points / CELL), axis=0, return_index=True)
    points = cloud.points[chosen]
    wall = np.stack([np.zeros(400), np.tile(np.linspace(-1, 1, 20), 20), np.repeat(np.linspace(1, 2, 20), 20)], axis=1)
    label = np.where(points[:, 0] > 4, NEW, SAME)
    count = len(points) + len(wall)
    flat = np.zeros(count, np.float32)
    return Changes(
        True,
        {},
        np.concatenate([points, wall]),
        np.full((count, 3), 120, np.uint8),
        flat,
        flat,
        flat,
        np.concatenate([label, np.full(len(wall), VANISHED)]).astype(np.uint8),
        np.concatenate([label == NEW, np.full(len(wall), 2)]).astype(np.uint16),
        GroundGrid(np.eye(3), 0.0, 0.0, 1.0, 1, 1),
        np.zeros((1, 1), np.float32),
    )


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """A browser that shows the page of a night on which one thing is new, with its picture: red before, green after."""
    crop = np.full((60, 204, 3), 255, np.uint8)
    crop[:, :100] = (0, 0, 200)
    crop[:, 104:] = (0, 200, 0)
    change = RecordedChange("new", 6.0, 0.0, 1.0, length=2.0, width=1.5, height=0.5, id="C7")
    summary = ChangesSummary(compared=True, count=1, changes={"C7": change}, files=("change-C7.jpg",))
    night = replace(made_up_run.record(made_up_run.names(5)), reference="20261031T031500Z", results={"changes": summary})
    page = made_up_run.page(
        tmp_path_factory.mktemp("page"),
        night,
        points=20_000,
        changes=changes_view(changed_bowl()),
        crop=cv2.imencode(".jpg", crop)[1].tobytes(),
    )
    with chromium(900, 700) as driver:
        driver.get(page.as_uri())
        until(driver, "return document.querySelector('#view').dataset.state === 'ready'")
        yield driver


def test_all_points_of_what_is_new_are_coloured_and_no_others(browser: Any) -> None:
    settled(browser, lambda: browser.execute_script("document.querySelector('[data-mode=change]').click()"))
    found = browser.execute_script("""
        const set = view.sets.find(s => s.name === "product"), p = set.points, out = [];
        for (let i = 0; i < p.n; i++) {
          const pixel = set.pixels.change[i], red = pixel & 255, blue = pixel >> 16 & 255;
          out.push([measure.world([p.at[3 * i], p.at[3 * i + 1], p.at[3 * i + 2]])[0], red > blue + 40 ? 1 : 0]);
        }
        return out;""")
    x, coloured = np.array(found).T
    assert coloured[x > 4.3].mean() > 0.99, "points that are not in the comparison are coloured by their neighbours"
    assert coloured[x < 3.7].max() == 0
    assert browser.find_element("css selector", ".key.changes").is_displayed()
    browser.execute_script("document.querySelector('[data-mode=photograph]').click()")
    assert not browser.find_element("css selector", ".key.changes").is_displayed()


def test_what_has_vanished_is_drawn_where_it_was(browser: Any) -> None:
    shown = browser.execute_script("""
        const points = view.sets.find(s => s.name === "change").points;
        return Array.from({length: points.n}, (_, i) => measure.world([0, 1, 2].map(k => points.at[3 * i + k])));""")
    places = np.array(shown)
    assert len(places) == 400
    assert np.abs(places[:, 0]).max() < 0.01 and places[:, 2].min() > 0.99


def test_the_slider_on_a_change_wipes_from_the_night_before_to_this_one(browser: Any) -> None:
    until(browser, "return document.querySelectorAll('.wipe.laid').length === 2")
    both = browser.find_element("css selector", ".finding.change .both")
    assert [date.text for date in both.find_elements("css selector", ".date")] == ["2026-10-31", "2026-12-09"]
    pixel = "const c = arguments[0].querySelector(arguments[1]); return [...c.getContext('2d').getImageData(50, 30, 1, 1).data]"
    red, green = (browser.execute_script(pixel, both, name) for name in ("canvas.then", ".now canvas"))
    assert red[0] > 150 > red[1] and green[1] > 150 > green[0]
    handle = both.find_element("css selector", "input")
    browser.execute_script("arguments[0].scrollIntoView({block: 'center'})", handle)
    handle.send_keys(Keys.END)
    clip = "return getComputedStyle(arguments[0].querySelector('.now')).clipPath"
    assert browser.execute_script(clip, both).endswith("100%)")
    handle.send_keys(Keys.HOME)
    assert browser.execute_script(clip, both).endswith(" 0%)")
    browser.execute_script("arguments[0].parentNode.querySelector('.shot').click()", both)
    assert browser.execute_script("return document.querySelector('#large').open"), (
        "both nights side by side, as large as they are"
    )
    browser.execute_script("document.querySelector('#large').close()")


def test_a_picture_of_one_night_alone_stays_as_it_is(browser: Any) -> None:
    halves = browser.execute_script("""
        const canvas = document.createElement("canvas"); canvas.width = 200; canvas.height = 60;
        const pen = canvas.getContext("2d"); pen.fillStyle = "#a33"; pen.fillRect(0, 0, 200, 60);
        const image = new Image(); image.src = canvas.toDataURL();
        return image.decode().then(() => halvesOf(image));""")
    assert halves is None
