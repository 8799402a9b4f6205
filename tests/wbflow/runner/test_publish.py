"""What a run publishes besides its cloud: files of site-wide stages, and figures in run.json and the report."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import pytest

from tests.helpers.toy_site import ToySite
from wbflow.pipeline import stages as pipeline
from wbflow.pipeline.meanings import shown
from wbflow.pipeline.stages import Products
from wbflow.pipeline.summaries import SiteSummary

STAGE = """
import numpy as np
from wbflow_stages.types import Coverage, GroundGrid, Poses
def look(poses: Poses) -> Coverage:
    flat = np.zeros((1, 1), np.float32)
    grid = GroundGrid(np.eye(3), 0.0, 0.0, 1.0, 1, 1)
    return Coverage(grid, flat, np.zeros((1, 1), np.uint8), flat, flat, 0.0, 0.0, 0.0, 0.0, 0.0)
"""
FILES = """
def files(result):
    yield "toy.txt", b"%s"
    if %s:
        raise ValueError("no map has the place")
"""
ROW = next(row for row in pipeline.STAGES if row.products.files)
"""The first stage that publishes files; no other stage depends on it."""


@dataclasses.dataclass(frozen=True)
class ToySummary(SiteSummary):
    source: str | None = None


@pytest.fixture
def toy_with_files(toy: ToySite, monkeypatch: pytest.MonkeyPatch) -> ToySite:
    """A toy site with one more stage, whose result is published as a text file."""
    monkeypatch.syspath_prepend(str(toy.folder))
    site = json.loads(toy.file.read_text())
    site["stages"][ROW.name] = {"use": "toylook:look"}
    toy.file.write_text(json.dumps(site))
    (toy.folder / "toylook.py").write_text(STAGE)
    mine = dataclasses.replace(ROW, products=Products(files="toyfiles:files", title="The toy"), summary=ToySummary)
    rows = tuple(mine if row is ROW else row for row in pipeline.STAGES)
    for module in ("wbflow.site.models", "wbflow.report.parts", "wbflow.records.record"):
        monkeypatch.setattr(f"{module}.STAGES", rows)
    write(toy, "first")
    return toy


def write(toy: ToySite, words: str, fails: bool = False) -> None:
    import sys

    sys.modules.pop("toyfiles", None)
    (toy.folder / "toyfiles.py").write_text(FILES % (words, fails))


def latest(toy: ToySite) -> Path:
    return toy.work / "runs" / "latest"


def test_files_and_figures_of_a_stage_are_published_with_the_cloud(toy_with_files: ToySite) -> None:
    record = toy_with_files.run()
    assert (latest(toy_with_files) / "toy.txt").read_bytes() == b"first"
    assert record[ROW.name] == {"source": None, "files": ["toy.txt"], "reason": None}
    page = (latest(toy_with_files) / "report.html").read_text()
    assert "<h2>The toy</h2>" in page
    assert "href='toy.txt'" in page


def header_of(cloud: Path) -> list[str]:
    return cloud.read_bytes().partition(b"end_header")[0].decode().splitlines()


def test_a_cloud_in_metres_says_so(toy: ToySite) -> None:
    assert toy.run()["cloud"]["metric"] is True
    assert "comment unit metre" in header_of(latest(toy) / "cloud.ply")
    assert "lengths are arbitrary" not in (latest(toy) / "report.html").read_text().lower()


def test_a_cloud_without_scale_says_so_wherever_it_is_read(toy: ToySite) -> None:
    toy.parameters["poses"] = {"metric": False}
    toy.write()
    assert toy.run()["cloud"]["metric"] is False
    header = header_of(latest(toy) / "cloud.ply")
    assert "comment unit arbitrary: no camera position, distance or board states a scale" in header
    assert "comment sigma_mm is in thousandths of that unit, not in millimetres" in header
    assert "lengths are arbitrary, not metres: state one measured distance" in (latest(toy) / "report.html").read_text().lower()
    said = toy.wbflow("run").stdout.splitlines()
    assert said[-6].endswith("good: nothing to look at; lengths are arbitrary")
    assert said[-2].startswith("scale   unknown: state one measured distance between two cameras in metres")


def test_the_scale_of_cameras_that_are_not_connected_is_unknown(toy: ToySite) -> None:
    toy.parameters["poses"] = {"worlds": 2}
    toy.write()
    record = toy.run(code=None)
    assert [cloud["metric"] for cloud in (record["cloud"], *record["other_clouds"])] == [True, False]
    unknown = [line for line in header_of(latest(toy) / record["other_clouds"][0]["path"]) if "unit unknown" in line]
    assert len(unknown) == 1


def test_a_failure_to_make_files_is_logged_and_the_run_goes_on(toy_with_files: ToySite) -> None:
    write(toy_with_files, "third", fails=True)
    toy_with_files.run()
    assert (latest(toy_with_files) / "toy.txt").is_file()
    assert "no map has the place" in (latest(toy_with_files) / "log.jsonl").read_text()


def test_a_figure_of_many_cameras_names_only_the_largest_values() -> None:
    ((title, words),) = shown({"lost_without": {f"c{k:02d}": 0.01 * k for k in range(12)}})
    assert title == "lost without"
    assert words == "c11 11 %, c10 10 %, c09 9.0 %, c08 8.0 %, c07 7.0 %, c06 6.0 %, c05 5.0 %, c04 4.0 %; 4 others less"
