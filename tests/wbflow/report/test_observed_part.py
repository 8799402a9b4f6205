"""How observations have placed the cameras, on the report's page in a browser: a table, and the track among the points."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.helpers import made_up_run
from tests.helpers.browser import chromium, until
from tests.wbflow.report.test_report import settled
from wbflow.pipeline.summaries import ObservedSummary
from wbflow_stages.contracts.observation_figures import ObservedCamera
from wbflow_stages.exports.view import track_view
from wbflow_stages.types import ObservedPoses

SUMMARY = ObservedSummary(
    cameras={
        "c0": ObservedCamera(7707, 5638, 0.76, sigma_m=0.104, sigma_deg=0.079),
        "c1": ObservedCamera(2553, 1997, 0.48, -0.2, 0.02, sigma_m=0.101, sigma_deg=0.079),
        "c2": ObservedCamera(12, reason="it saw the lamp when no other camera did"),
    },
    things=5982,
    survey_m=0.66,
    halves_m=0.031,
    halves_deg=0.02,
    metric=True,
    scale="738 known places of the thing",
    time_unit="frames",
    notes=("carry the lamp through the left half of c1",),
)


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """A browser with the page of a night whose cameras were placed by a thing that flew across, 6 m above the ground."""
    night = replace(made_up_run.record(made_up_run.names(5)), results={"observed": SUMMARY})
    track = np.column_stack([np.linspace(-6, 6, 400), np.zeros(400), np.full(400, 6.0)])
    page = made_up_run.page(tmp_path_factory.mktemp("page"), night, track=track_view(ObservedPoses({}, track=track)))
    with chromium(1100, 800) as driver:
        driver.get(page.as_uri())
        until(driver, "return document.querySelector('#view').dataset.state === 'ready'")
        yield driver


def test_each_camera_has_a_row_and_each_doubt_a_sentence(browser: Any) -> None:
    parts = browser.execute_script("return [...document.querySelectorAll('section.part')].map(part => part.innerText)")
    (part,) = [text for text in parts if "observations place" in text]
    assert "c1\t2,553\t1,997\t0.48\t101 mm\t0.079\t-0.20 ± 0.02 frames" in part
    for sentence in (
        "c2 is not placed: it saw the lamp when no other camera did",
        "two halves of the observations agree within 0.031 m and 0.020 degrees",
        "the survey is 0.66 m (median) from where the cameras see the thing",
        "scale: 738 known places of the thing",
        "carry the lamp through the left half of c1",
    ):
        assert sentence in part


def test_the_track_is_shown_with_the_cameras_and_hidden_with_them(browser: Any) -> None:
    click = "document.querySelector('[data-do=cameras]').click()"
    shown = settled(browser, lambda: None)
    hidden = settled(browser, lambda: browser.execute_script(click))
    assert hidden[0] < shown[0]
    assert settled(browser, lambda: browser.execute_script(click)) == shown
