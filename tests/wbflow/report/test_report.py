"""The report page of a night, opened in a browser from disk: 3-D view, measuring, complete content, no network requests."""

from __future__ import annotations

import html
import json
import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.helpers import made_up_run
from tests.helpers.browser import chromium, until
from wbflow.pipeline.summaries import ChangesSummary, RecordedChange
from wbflow.records.findings import Finding, Verdict
from wbflow.records.record import RunRecord
from wbflow.runner.state import Cause

webdriver = pytest.importorskip("selenium.webdriver")
Keys = pytest.importorskip("selenium.webdriver.common.keys").Keys
HOSTILE = ["gate", "\"><script>document.title='taken'</script>", "o'clock\n&amp; {{ 7 * 7 }}", "</script><b>", "yard-2", "yard-3"]


@pytest.fixture(scope="module")
def night() -> RunRecord:
    return made_up_run.record(HOSTILE)


@pytest.fixture(scope="module")
def page(night: RunRecord, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return made_up_run.page(tmp_path_factory.mktemp("page"), night)


@pytest.fixture(scope="module")
def browser(page: Path) -> Iterator[Any]:
    """A browser that has the page open, loaded from disk."""
    with chromium(900, 700) as driver:
        driver.get(page.as_uri())
        until(driver, "return document.querySelector('#view').dataset.state === 'ready'")
        yield driver


PIXELS = """
const canvas = document.querySelector('#view canvas.points'), pen = canvas.getContext('2d');
const data = pen.getImageData(0, 0, canvas.width, canvas.height).data;
let sum = 0, drawn = 0;
for (let i = 0; i < data.length; i += 4) if (data[i + 3]) {
  drawn++;
  sum = (sum * 31 + data[i] * 7 + data[i + 1] * 3 + data[i + 2] + i) % 2147483647;
}
return [drawn, sum];"""
POSE = "return document.querySelector('#view').dataset.pose"


def settled(browser: Any, does: Callable[[], object]) -> tuple[int, int]:
    """Run an action, wait until the view is at rest, and return its number of drawn pixels and a checksum of them."""
    does()
    until(browser, "return !view.moving && !view.dirty && view.root.dataset.mode === view.mode")
    drawn, total = browser.execute_script(PIXELS)
    return drawn, total


def test_the_page_makes_no_requests_and_logs_no_errors(browser: Any, page: Path) -> None:
    messages = [json.loads(entry["message"])["message"] for entry in browser.get_log("performance")]
    asked = {m["params"]["request"]["url"] for m in messages if m["method"] == "Network.requestWillBeSent"}
    assert {url for url in asked if not url.startswith("data:")} == {page.as_uri()}
    assert browser.get_log("browser") == []
    assert "taken" not in browser.title


def test_hidden_elements_are_not_displayed(browser: Any) -> None:
    make = "const image = document.createElement('img'); image.hidden = true; document.body.append(image);"
    assert browser.execute_script(f"{make} return getComputedStyle(image).display") == "none", "a layer of the map, for one"
    shown = "return [...document.querySelectorAll('[hidden]')].filter(e => getComputedStyle(e).display !== 'none').length"
    assert browser.execute_script(shown) == 0


def test_the_cloud_is_drawn_and_turned_with_the_pointer(browser: Any) -> None:
    drawn, first = settled(browser, lambda: None)
    assert drawn > 500
    pose = browser.execute_script(POSE)
    canvas = browser.find_element("css selector", "#view canvas.over")
    drag = webdriver.ActionChains(browser, duration=20).move_to_element(canvas).click_and_hold().move_by_offset(90, 15).release()
    _, turned = settled(browser, drag.perform)
    assert browser.execute_script(POSE) != pose
    assert turned != first
    _, back = settled(browser, lambda: browser.execute_script("Object.assign(view, view.home); view.draw()"))
    assert back == first


def test_colour_modes_look_different_and_have_legends(browser: Any) -> None:
    looks = set()
    for button in browser.find_elements("css selector", "[data-mode]"):
        looks.add(settled(browser, partial(browser.execute_script, "arguments[0].click()", button)))
        assert (button.get_attribute("data-mode") == "photograph") != browser.find_element(
            "css selector", ".legend"
        ).is_displayed()
    assert len(looks) == 5, "photograph, height, confidence, views, sigma"
    browser.execute_script("document.querySelector('[data-mode=photograph]').click()")


def test_a_click_on_a_camera_moves_the_view_to_it(browser: Any) -> None:
    at = browser.execute_script("const s = view.spots.find(s => s.cam.id === 'gate'); return [s.x, s.y, ...view.size]")
    canvas = browser.find_element("css selector", "#view canvas.over")
    across, down = (round(at[k] - at[2 + k] / 2) for k in (0, 1))
    webdriver.ActionChains(browser, duration=0).move_to_element_with_offset(canvas, across, down).click().perform()
    until(browser, "return view.root.dataset.flown === 'gate'")
    eye, stands = browser.execute_script("return [view.eye().eye, view.flown.C]")
    assert eye == pytest.approx(stands, abs=1e-6)
    assert browser.find_element("css selector", ".inset img").is_displayed(), "what it saw stands beside"
    browser.execute_script("document.querySelector('[data-do=home]').click()")
    until(browser, "return view.root.dataset.flown === ''")


def press(browser: Any, does: str) -> None:
    browser.execute_script(f"document.querySelector('[data-do={does}]').click()")


def test_clicked_points_are_measured_and_restored_from_a_link(browser: Any, page: Path) -> None:
    settled(browser, lambda: browser.execute_script("Object.assign(view, view.home); view.draw()"))
    press(browser, "measure")
    canvas = browser.find_element("css selector", "#view canvas.over")
    for across, down in ((0, 0), (40, 6), (10, 30)):
        webdriver.ActionChains(browser, duration=0).move_to_element_with_offset(canvas, across, down).click().perform()
    assert browser.execute_script("return measure.points.length") == 3
    worlds = [np.array(w) for w in browser.execute_script("return measure.points.map(q => measure.world(q.p))")]
    named = dict(browser.execute_script("return measure.figures().map(f => [f[0], f[1]])"))
    assert named["distance"] == pytest.approx(float(np.linalg.norm(worlds[2] - worlds[1])), abs=1e-6)
    assert named["up"] == pytest.approx(float((worlds[2] - worlds[1])[2]), abs=1e-6)
    assert named["across"] == pytest.approx(float(np.linalg.norm((worlds[2] - worlds[1])[:2])), abs=1e-6)
    (a, b) = ((worlds[k] - worlds[0])[:2] for k in (1, 2))
    assert named["area"] == pytest.approx(abs(float(a[0] * b[1] - a[1] * b[0])) / 2, abs=1e-6)
    shown = browser.find_element("css selector", ".measured").text
    assert "distance" in shown
    assert "±" in shown
    press(browser, "link")
    link = browser.find_element("css selector", "[data-do=link]").get_attribute("data-copied")
    pose = browser.execute_script(POSE)
    canvas.send_keys(Keys.BACKSPACE)
    assert browser.execute_script("return measure.points.length") == 2
    canvas.send_keys(Keys.ENTER)
    assert browser.execute_script("return measure.points.length") == 3
    canvas.send_keys(Keys.ESCAPE)
    assert browser.execute_script("return measure.points.length") == 0
    settled(browser, lambda: browser.execute_script("view.turn(0.5, 0.1)"))
    browser.execute_script("location.hash = ''; location.hash = arguments[0]", link.partition("#")[2])
    until(browser, "return measure.points.length === 3")
    settled(browser, lambda: None)
    assert [float(v) for v in browser.execute_script(POSE).split()] == pytest.approx([float(v) for v in pose.split()], abs=2e-3)
    drawn = browser.execute_script("return document.querySelector('.measuring polygon').getAttribute('points')").split()
    assert len(drawn) == 3
    plan = browser.find_element("css selector", ".plan svg")
    webdriver.ActionChains(browser, duration=0).move_to_element_with_offset(plan, 30, 20).click().perform()
    off = browser.execute_script(
        "const {left, top, scale} = document.querySelector('.plan canvas').dataset, svg = document.querySelector('.plan svg');"
        "const {width, height} = svg.viewBox.baseVal, {p} = measure.points[3], zoom = width / svg.clientWidth;"
        "const x = width / 2 + 30 * zoom, y = height / 2 + 20 * zoom;"
        "return [p[0] - left - x / scale, p[1] - top + y / scale, measure.cloud.voxel]"
    )
    assert max(abs(off[0]), abs(off[1])) < 3.1 * off[2]
    assert "±" in browser.find_element("css selector", "#map .measured").text
    press(browser, "measure")
    browser.execute_script("history.replaceState(null, '', location.pathname); Object.assign(view, view.home); view.draw()")


def test_what_is_measured_stands_beside_the_line_in_the_view_and_on_the_map(browser: Any) -> None:
    settled(browser, lambda: browser.execute_script("Object.assign(view, view.home); view.draw()"))
    press(browser, "measure")
    canvas = browser.find_element("css selector", "#view canvas.over")
    for across, down in ((-40, 0), (40, 6)):
        webdriver.ActionChains(browser, duration=0).move_to_element_with_offset(canvas, across, down).click().perform()
    distance = browser.execute_script("return measure.labels()[0].text")
    assert re.fullmatch(r"\d+\.\d\d ± \d\.\d\d m", distance)
    box = browser.find_element("css selector", "#view .measured")
    assert f"distance {distance}" in box.text
    view, shown = browser.find_element("css selector", "#view").rect, box.rect
    assert view["y"] <= shown["y"] and shown["y"] + shown["height"] <= view["y"] + view["height"]
    assert browser.execute_script("return document.querySelector('.measuring text').textContent") == distance
    press(browser, "undo")
    assert browser.execute_script("return measure.points.length") == 1
    press(browser, "measure")


def test_a_double_click_is_one_point_and_does_not_move_the_view(browser: Any) -> None:
    settled(browser, lambda: browser.execute_script("Object.assign(view, view.home); view.draw()"))
    pose = browser.execute_script(POSE)
    press(browser, "measure")
    canvas = browser.find_element("css selector", "#view canvas.over")
    webdriver.ActionChains(browser, duration=0).move_to_element(canvas).double_click().perform()
    assert browser.execute_script("return measure.points.length") == 1
    plan = browser.find_element("css selector", ".plan svg")
    webdriver.ActionChains(browser, duration=0).move_to_element(plan).double_click().perform()
    assert browser.execute_script("return measure.points.length") == 2
    settled(browser, lambda: None)
    assert browser.execute_script(POSE) == pose
    press(browser, "measure")


@pytest.mark.parametrize(
    ("value", "unit", "words"),
    [
        (-0.0277, "m", "-2.8 cm"),
        (0.03, "m", "3 cm"),
        (0.456, "m", "46 cm"),
        (8.4449, "m", "8.44 m"),
        (124.3, "m", "124 m"),
        (0.0042, "m", "4.2 mm"),
        (12.3, "mm", "1.2 cm"),
        (3.21, "mm", "3.2 mm"),
        (0.0, "m", "0 m"),
        (7.0, "cameras", "7 cameras"),
        (0.93, "", "0.93"),
    ],
)
def test_values_are_shown_in_units_that_a_person_would_use(browser: Any, value: float, unit: str, words: str) -> None:
    assert browser.execute_script("return inWords(arguments[0], arguments[1])", value, unit) == words


def test_sliders_and_legends_show_values_with_units(browser: Any) -> None:
    shown = "return [...document.querySelectorAll('.measures label output')].map(e => e.textContent)"
    low, high = browser.execute_script(shown)
    assert re.fullmatch(r"-?[\d.]+ (m|cm)", low) and re.fullmatch(r"[\d.]+ m", high)
    move = "const s = document.querySelector('[data-clip=low]'); s.value = arguments[0]; s.dispatchEvent(new Event('input'))"
    browser.execute_script(move, 500)
    assert browser.execute_script(shown)[0] != low
    browser.execute_script(move, 0)
    browser.execute_script("document.querySelector('[data-mode=height]').click()")
    assert re.fullmatch(r"-?[\d.]+ (m|cm)", browser.find_element("css selector", ".legend .low").text)
    browser.execute_script("document.querySelector('[data-mode=photograph]').click()")


def test_points_below_the_clipping_height_are_not_drawn(browser: Any) -> None:
    whole, _ = settled(browser, lambda: browser.execute_script("Object.assign(view, view.home); view.draw()"))
    move = "const s = document.querySelector('[data-clip=low]'); s.value = arguments[0]; s.dispatchEvent(new Event('input'))"
    upper, _ = settled(browser, lambda: browser.execute_script(move, 400))
    assert 0 < upper < whole
    again, _ = settled(browser, lambda: browser.execute_script(move, 0))
    assert again == whole


def test_the_page_lists_every_camera_pair_and_finding_as_text(browser: Any, night: RunRecord) -> None:
    def texts(selector: str) -> list[str]:
        script = "return [...document.querySelectorAll(arguments[0])].map(e => e.textContent)"
        found: list[str] = browser.execute_script(script, selector)
        return found

    ids = [camera.id for camera in night.cameras]
    assert texts("#cameras .card h3 a") == [ids[-2], ids[-1], *ids[:-2]], "those to look at come first"
    assert texts("#map .dot > text") == ids
    assert texts("table.pairs tbody td:first-child") == [pair.name for pair in night.pairs]
    assert len(texts("#map line.pair")) == len(night.pairs)
    listed = "\n".join(texts(".finding"))
    assert night.verdict
    for finding in night.verdict.findings:
        assert finding.text in listed and finding.remedy in listed
    assert texts(".verdict strong") == ["2 cameras to look at"]
    assert texts(".tried li") == ["geometry rejected: 12 inliers, 30 needed"]
    assert browser.execute_script("return view.scene.cameras.map(c => c.id)") == ids


def test_a_picture_opens_in_full_size_with_its_keypoints_and_inliers(browser: Any) -> None:
    browser.execute_script("document.querySelector('#camera-1 .shot').click()")
    over = "const c = document.querySelector('#large canvas'); return [...c.getContext('2d').getImageData(%s, 1, 1).data]"
    middle, corner = "c.width / 2, c.height / 2", "0, 0"
    wide, high = until(
        browser, "const i = document.querySelector('#large img'); return i.complete && [i.naturalWidth, i.naturalHeight]"
    )
    assert browser.execute_script("const c = document.querySelector('#large canvas'); return [c.width, c.height]") == [wide, high]
    assert "6,000 keypoints, 1,000 inliers in 2 pairs" in browser.find_element("css selector", "#large figcaption").text
    assert (browser.execute_script(over % corner)[3] > 0, browser.execute_script(over % middle)[3]) == (True, 0)
    for layer in ("points", "inliers"):
        browser.execute_script(f"document.querySelector('[data-layer={layer}]').click()")
    assert browser.execute_script(over % corner)[3] == 0
    browser.execute_script("document.querySelector('#large').close()")


def test_pairs_are_sorted_by_the_column_that_is_clicked(browser: Any) -> None:
    head = next(th for th in browser.find_elements("css selector", "table.pairs th button") if "inliers" in th.text)
    browser.execute_script("arguments[0].click()", head)
    rows = "return [...document.querySelectorAll('table.pairs tbody tr')].map(r => r.className)"
    assert browser.execute_script(rows)[0] == "rejected"
    browser.execute_script("arguments[0].click()", head)
    assert browser.execute_script(rows)[-1] == "rejected"


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_nothing_overflows_on_a_phone(browser: Any, scheme: str) -> None:
    size = {"width": 390, "height": 844, "deviceScaleFactor": 1, "mobile": True}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    media = {"features": [{"name": "prefers-color-scheme", "value": scheme}]}
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", media)
    browser.execute_script("for (const fold of document.querySelectorAll('details')) fold.open = true")
    out = """return [...document.querySelectorAll('body *')].filter(e => !e.closest('svg'))
        .filter(e => e.getBoundingClientRect().right > 390.5).map(e => e.outerHTML.slice(0, 80))"""
    assert browser.execute_script(out) == []
    assert browser.execute_script("return document.documentElement.scrollWidth") == 390
    ground = browser.execute_script("return getComputedStyle(document.body).backgroundColor")
    assert (sum(map(int, re.findall(r"\d+", ground)[:3])) < 150) == (scheme == "dark")
    small = """return [...document.querySelectorAll('body *')].filter(e => e.checkVisibility() && !e.closest('canvas'))
        .filter(e => [...e.childNodes].some(n => n.nodeType === 3 && n.textContent.trim()))
        .filter(e => !['title', 'STYLE', 'SCRIPT', 'TEMPLATE'].includes(e.tagName))
        .map(e => [e, e.getScreenCTM ? e.getScreenCTM().a : 1])
        .map(([e, scale]) => [parseFloat(getComputedStyle(e).fontSize) * scale, e.outerHTML.slice(0, 80)])
        .filter(([size]) => size < 11)"""
    assert browser.execute_script(small) == []
    browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})


def test_where_no_pointer_can_rest_a_tap_shows_the_meaning(page: Path) -> None:
    with chromium(390, 844) as driver:
        driver.execute_cdp_cmd("Emulation.setTouchEmulationEnabled", {"enabled": True})
        size = {"width": 390, "height": 844, "deviceScaleFactor": 1, "mobile": True}
        driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
        driver.get(page.as_uri())
        until(driver, "return document.querySelector('#view').dataset.state === 'ready'")
        text = driver.find_element("css selector", "#pairs > p").text
        assert "Tap a figure for its meaning" in text and "pointer" not in text
        driver.execute_script(
            "document.querySelector('#pairs details').open = true; document.querySelector('#pairs td[title]').click()"
        )
        shown = driver.find_element("css selector", "#meaning")
        assert shown.is_displayed()
        assert shown.text == driver.execute_script("return document.querySelector('#pairs td[title]').title")
        driver.execute_script("document.querySelector('[data-do=measure]').click()")
        assert "tap points" in driver.find_element("css selector", "#view .measured").text


def test_every_page_leads_to_the_newest_night(page: Path) -> None:
    assert '<a href="../latest/report.html">newest night →</a>' in page.read_text()
    assert (page.parent.parent / "latest" / "report.html").resolve().is_file()


def test_the_page_of_a_hundred_cameras_is_complete_and_below_15_mb(tmp_path: Path) -> None:
    night = made_up_run.record(made_up_run.names(100))
    file = made_up_run.page(tmp_path, night, points=20_000, pictures=(480, 270), nights=1)
    text = file.read_text()
    assert file.stat().st_size < 15_000_000
    assert text.count('<article class="card') == 100 + sum(pair.ok for pair in night.pairs)
    assert text.count('<g class="dot') == 100
    assert all(html.escape(pair.name) in text for pair in night.pairs)
    assert "98 cameras as they should be" in text, "two to look at stand before them"
    assert 'class="elsewhere" href="../../cache/' in text, "what has no room is led to"


def test_a_night_without_a_cloud_shows_the_last_known_camera_positions(tmp_path: Path) -> None:
    night = made_up_run.record(made_up_run.names(3), cloud=None, pairs=(), verdict=None, exit_code=1)
    text = made_up_run.page(tmp_path, night, nights=1).read_text()
    assert text.count('<g class="dot') == 3
    assert "position on 2026-11-01" in text
    assert "No cloud this night" in text
    assert "No two cameras were matched." in text
    assert '<script type="application/octet-stream"' not in text


def test_a_night_without_a_cloud_is_oriented_as_the_night_before(tmp_path: Path) -> None:
    ids = made_up_run.names(5)
    before = made_up_run.record(ids)
    lost = [Finding("camera-lost", (name,), "no capture", remedy="see that it delivers") for name in ids]
    gone = tuple(replace(camera, outcome="failed", code=Cause.NO_CAPTURE, health=None) for camera in before.cameras)
    after = replace(before, run="20261211T031500Z", date="2026-12-10", cloud=None, pairs=(), cameras=gone)
    after = replace(after, verdict=Verdict("failed", tuple(lost)))
    pages = [made_up_run.page(tmp_path, night, nights=count).read_text() for night, count in ((before, 1), (after, 0))]
    rows, turned = (json.loads(re.findall(r'id="scene">(.*?)</script>', page)[0])["axes"]["rows"] for page in pages)
    for one, other in zip(rows, turned, strict=True):
        assert one == pytest.approx(other, abs=0.05)


def test_common_findings_are_merged_and_empty_comparisons_show_no_figures(tmp_path: Path) -> None:
    ids = made_up_run.names(5)
    lost = [Finding("camera-lost", (name,), f"no capture of {name}", remedy="see that it delivers") for name in ids]
    night = made_up_run.record(ids, cloud=None, pairs=(), verdict=Verdict("failed", tuple(lost)), exit_code=1)
    night = replace(night, results={"changes": ChangesSummary(compared=False, count=0, noise=1.0)})
    text = made_up_run.page(tmp_path, night, nights=0).read_text()
    assert "All cameras have the same problem." in text
    assert f"4 more like these: {', '.join(ids[1:])}" in text
    assert "There was nothing to compare this night with." in text and "<dt>noise</dt>" not in text


def test_the_page_of_a_good_night_begins_with_its_changes_by_kind(tmp_path: Path) -> None:
    night = made_up_run.record(made_up_run.names(3), verdict=Verdict("good"), exit_code=0)
    kinds = enumerate(("new", "new", "vanished"), 1)
    things = {str(k): RecordedChange(kind, 1.0, 2.0, 0.0, length=2.0, width=1.5, height=0.5) for k, kind in kinds}
    night = replace(night, results={"changes": ChangesSummary(compared=True, count=3, changes=things)})
    page = made_up_run.page(tmp_path, night, nights=0).read_text()
    assert "3 changes since the reference (2 new, 1 vanished)." in page
    assert "There is nothing to do." not in page
    first, _, rest = page.partition('class="stage"')
    assert re.findall(r'data-mark="(\d)">\d: (\w+)', first) == [("1", "new"), ("2", "new"), ("3", "vanished")]
    assert "2.0 × 1.5 × 0.5 m; at 1.0, 2.0, 0.0" in first, "what changed stands on the first screen, and leads to its place"
    assert rest.count('class="card thing"') == 3
