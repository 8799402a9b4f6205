"""The page of `wbflow edit` in Chromium, operated with mouse and keyboard as by someone who sets up a site."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.helpers import edit_site
from tests.helpers.browser import PATIENCE_S, chromium

webdriver = pytest.importorskip("selenium.webdriver")
Keys = pytest.importorskip("selenium.webdriver.common.keys").Keys


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium(1200, 800) as driver:
        yield driver


@dataclass
class Page:
    """A browser that has the edit page of a site open."""

    browser: Any
    file: Path
    address: str

    @property
    def canvas(self) -> Any:
        return self.browser.find_element("css selector", "#picture")

    def run(self, script: str, *given: Any) -> Any:
        return self.browser.execute_script(script, *given)

    def until(self, script: str, *given: Any) -> Any:
        end = time.monotonic() + PATIENCE_S
        while not (found := self.run(script, *given)):
            assert time.monotonic() < end, (script, self.message)
            time.sleep(0.05)
        return found

    def at(self, x: float, y: float) -> Any:
        """An action chain that moves the pointer to a pixel of the capture."""
        u, v, wide, high = self.run("return [...toScreen(...arguments), canvas.clientWidth, canvas.clientHeight]", x, y)
        return webdriver.ActionChains(self.browser, duration=0).move_to_element_with_offset(
            self.canvas, round(u - wide / 2), round(v - high / 2)
        )

    def click(self, *pixels: tuple[float, float]) -> None:
        for x, y in pixels:
            before = self.run("return JSON.stringify([edit.marks, edit.draft, edit.chosen])")
            self.at(x, y).click().perform()
            self.until("return JSON.stringify([edit.marks, edit.draft, edit.chosen]) !== arguments[0]", before)

    def keys(self, *keys: str) -> None:
        self.canvas.send_keys(*keys)

    def tool(self, name: str) -> None:
        self.browser.find_element("css selector", f"[data-tool={name}]").click()

    def to(self, camera: str) -> None:
        """Press Tab until the page shows the camera."""
        while self.run("return edit.camera") != camera:
            self.keys(Keys.TAB)
        self.ready(camera)

    def ready(self, camera: str) -> None:
        self.until("return canvas.dataset.camera === arguments[0] && !looking && edit.seen?.camera === arguments[0]", camera)

    def save(self) -> str:
        self.run("say('')")
        self.browser.find_element("css selector", "[data-do=save]").click()
        self.until("return !document.querySelector('#message').hidden")
        return self.message

    @property
    def message(self) -> str:
        return str(self.run("return document.querySelector('#message').textContent"))

    @property
    def data(self) -> Any:
        return yaml.safe_load(self.file.read_text())


@pytest.fixture
def page(browser: Any, tmp_path: Path) -> Iterator[Page]:
    file = edit_site.write(tmp_path / "harbour")
    with edit_site.served(file) as server:
        browser.get(server.address)
        page = Page(browser, file, server.address)
        page.ready("gate")
        yield page
        browser.execute_script("edit.saved = packed()")  # without unsaved changes, no dialog holds the page back
        browser.get("about:blank")


def test_the_page_loads_only_local_content_and_logs_no_errors(page: Page) -> None:
    page.to("shed")
    messages = [json.loads(entry["message"])["message"] for entry in page.browser.get_log("performance")]
    asked = {m["params"]["request"]["url"] for m in messages if m["method"] == "Network.requestWillBeSent"}
    ours = {url for url in asked if not url.startswith(("data:", "about:"))}
    assert all(url.startswith("http://127.0.0.1:") for url in ours)
    assert page.browser.get_log("browser") == []


def test_a_privacy_polygon_is_drawn_undone_drawn_again_and_saved(page: Page) -> None:
    corners = [(100.0, 60.0), (160.0, 60.0), (160.0, 110.0), (100.0, 110.0)]
    page.tool("privacy")
    page.click(*corners)
    page.keys(Keys.ENTER)
    page.until("return mine().privacy.length === 2")
    page.keys(Keys.CONTROL + "z" + Keys.NULL)
    page.until("return mine().privacy.length === 1")
    page.click(*corners, (210.0, 90.0))
    page.keys(Keys.BACKSPACE)
    page.until("return edit.draft.corners.length === 4")
    page.click(corners[0])
    page.until("return mine().privacy.length === 2")
    assert page.save().startswith("Saved ")
    drawn = page.data["cameras"][0]["privacy"]
    assert drawn[0] == [[0.0, 0.7], [0.3, 0.65], [0.3, 1.0], [0.0, 1.0]], "the one in shares of the picture stays as it was"
    assert [v for corner in drawn[1] for v in corner] == pytest.approx([v for corner in corners for v in corner], abs=0.6)
    assert "# the neighbour's garden" in page.file.read_text()
    page.tool("select")
    page.click((130.0, 85.0))
    page.keys(Keys.DELETE)
    page.until("return mine().privacy.length === 1")


def test_escape_discards_an_unfinished_polygon(page: Page) -> None:
    page.tool("mask")
    page.click((100, 60), (160, 60))
    page.keys(Keys.ESCAPE)
    assert page.run("return edit.draft === null && mine().mask.length === 0")
    assert not page.browser.find_element("css selector", "[data-do=save]").is_enabled()


def test_a_mask_is_drawn_and_its_corner_dragged(page: Page) -> None:
    page.to("shed")
    page.tool("mask")
    page.click((200, 40), (300, 40), (300, 100))
    page.keys(Keys.ENTER)
    page.until("return mine().mask.length === 1")
    page.at(300, 100).click_and_hold().perform()
    page.at(280, 150).release().perform()
    corner = page.until("return mine().mask[0].corners[2]")
    assert corner == pytest.approx([280, 150], abs=0.6)
    assert page.save().startswith("Saved ")
    assert page.data["cameras"][3] == {"id": "shed", "mask": "masks/shed.png"}


def test_a_control_point_is_placed_in_three_pictures_by_guides_with_residuals(page: Page) -> None:
    X = [-1.5, 0.5, 0.8]
    page.tool("point")
    x, y = edit_site.seen("gate", X)
    page.click((x, y))
    page.to("roof")
    line = page.until("return edit.seen.guide.lines?.[0]")
    x, y = edit_site.seen("roof", X)
    assert min((a - x) ** 2 + (b - y) ** 2 for a, b in line) < 5**2, "the epipolar line leads past it"
    page.click((x, y))
    page.to("mast")
    at = page.until("return edit.seen.guide.at")
    assert at == pytest.approx(edit_site.seen("mast", X), abs=4)
    page.click(tuple(at))
    page.until("return Object.keys(edit.seen.residuals[1].pixels).length === 3")
    chosen = page.browser.find_element("css selector", "#points li.chosen")
    assert "px" in chosen.text
    for name, value in zip("xyz", X, strict=True):
        chosen = page.browser.find_element("css selector", "#points li.chosen")
        field = chosen.find_element("css selector", f"input[placeholder={name}]")
        field.send_keys(str(value))
    field.send_keys(Keys.ENTER)
    page.until("return edit.seen.residuals[1].metres !== null")
    off = page.run("return edit.seen.residuals[1].metres")
    assert off < 0.15
    page.until("return document.querySelector('#points li.chosen').textContent.includes('mm')")
    assert page.save().startswith("Saved ")
    written = page.data["control_points"][1]
    assert written["position"] == X
    assert sorted(written["pixels"]) == ["gate", "mast", "roof"]


def test_a_control_point_without_coordinates_is_marked_and_the_rest_is_saved(page: Page) -> None:
    page.tool("point")
    page.click((100, 90))
    page.tool("privacy")
    page.click((200, 60), (260, 60), (260, 110))
    page.keys(Keys.ENTER)
    message = page.save()
    assert message.startswith("Saved ")
    assert "Not saved: control point point-2: its coordinates are missing" in message
    assert len(page.data["cameras"][0]["privacy"]) == 2
    assert len(page.data["control_points"]) == 1
    row = page.browser.find_element("css selector", "#points li.fault")
    assert "its coordinates are missing" in row.text
    assert len(row.find_elements("css selector", "input[aria-invalid=true]")) == 3
    assert page.browser.find_element("css selector", "[data-do=save]").is_enabled()
    fields = row.find_elements("css selector", ".place input")
    fields[0].send_keys("1.5", Keys.TAB)
    assert page.run("return document.activeElement.placeholder") == "y", "the list is not built anew while somebody types"
    page.run("document.activeElement.blur()")
    assert page.run("return document.querySelector('#points li.fault .place input').value") == "1.5"
    for name, value in zip("yz", ("2", "0.5"), strict=True):
        row = page.browser.find_element("css selector", "#points li.fault")
        row.find_element("css selector", f"input[placeholder={name}]").send_keys(value, Keys.ENTER)
    assert "Not saved: control point point-2: fewer than two cameras see it" in page.save()
    page.browser.find_element("css selector", "#points li.fault input").click()
    page.tool("point")
    page.to("roof")
    page.click((120, 70))
    assert page.save() == f"Saved {page.file}"
    assert page.data["control_points"][1]["position"] == [1.5, 2, 0.5]
    assert page.browser.find_elements("css selector", "#points li.fault") == []


def test_what_others_change_in_the_file_meanwhile_is_kept_beside_what_is_drawn(page: Page) -> None:
    page.tool("privacy")
    page.click((200, 60), (260, 60), (260, 110))
    page.keys(Keys.ENTER)
    page.file.write_text(page.file.read_text().replace("least_m: 0.5", "least_m: 0.7").replace("- id: bolt ", "- id: hook "))
    message = page.save()
    assert message.startswith("Saved ") and "their changes are kept, too" in message
    assert len(page.data["cameras"][0]["privacy"]) == 2
    assert page.data["zones"][0]["least_m"] == 0.7
    page.until("return edit.marks.points[0].id === 'hook' && mine().privacy.length === 2")


def test_a_file_that_is_invalid_now_costs_nothing_of_what_is_drawn(page: Page) -> None:
    page.tool("privacy")
    page.click((200, 60), (260, 60), (260, 110))
    page.keys(Keys.ENTER)
    page.file.write_text(page.file.read_text().replace("resolution: 1600", "resolution: many"))
    message = page.save()
    assert "resolution" in message and "mend it, then save again: what is drawn here is kept" in message
    page.file.write_text(edit_site.SITE)
    assert page.save().startswith("Saved ")
    assert len(page.data["cameras"][0]["privacy"]) == 2


def test_a_zone_is_drawn_on_the_ground_and_shown_in_the_other_pictures(page: Page) -> None:
    page.to("roof")
    corners = [[-2.0, -2.0], [2.0, -2.0], [2.0, 1.0]]
    page.tool("zone")
    page.click(*[(x, y) for x, y in (edit_site.seen("roof", [*corner, 0.0]) for corner in corners)])
    page.keys(Keys.ENTER)
    page.until("return edit.marks.zones.length === 2")
    page.to("mast")
    page.until("return edit.seen.zones.length === 2")
    seen = page.run("return edit.seen.zones[1].corners")
    for at, corner in zip(seen, corners, strict=True):
        assert at == pytest.approx(edit_site.seen("mast", [*corner, 0.0]), abs=3)
    page.to("shed")
    page.at(160, 90).click().perform()
    page.until("return document.querySelector('#message').textContent.includes('poses')")
    assert page.save().startswith("Saved ")
    assert page.data["zones"][1]["name"] == "zone-2"


def test_the_picture_is_zoomed_and_moved_without_drawing(page: Page) -> None:
    page.tool("privacy")
    before = page.run("return edit.at.scale")
    page.keys("+")
    assert page.run("return edit.at.scale") == pytest.approx(1.25 * before)
    origin = webdriver.common.actions.wheel_input.ScrollOrigin.from_element(page.canvas)
    webdriver.ActionChains(page.browser).scroll_from_origin(origin, 0, -300).perform()
    page.until("return edit.at.scale > 1.5 * arguments[0]", before)
    x = page.run("return edit.at.x")
    page.at(160, 90).click_and_hold().move_by_offset(60, 10).release().perform()
    page.until("return Math.abs(edit.at.x - arguments[0] - 60) < 2", x)
    assert page.run("return edit.draft === null")
    page.keys("0")
    assert page.run("return edit.at.scale") == pytest.approx(before)


def test_the_done_button_ends_the_editor(page: Page) -> None:
    page.browser.find_element("css selector", "[data-do=done]").click()
    page.until("return document.body.textContent.includes('has ended')")
