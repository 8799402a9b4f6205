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
from wbflow_stages.types import Poses, Scene
def look(poses: Poses) -> Scene:
    return Scene()
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
    for module in ("wbflow.runner.bindings", "wbflow.report.sections", "wbflow.records.record"):
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


def test_a_failure_to_make_files_is_logged_and_the_run_goes_on(toy_with_files: ToySite) -> None:
    write(toy_with_files, "third", fails=True)
    toy_with_files.run()
    assert (latest(toy_with_files) / "toy.txt").is_file()
    assert "no map has the place" in (latest(toy_with_files) / "log.jsonl").read_text()


def test_a_figure_of_many_cameras_names_only_the_largest_values() -> None:
    ((title, words),) = shown({"lost_without": {f"c{k:02d}": 0.01 * k for k in range(12)}})
    assert title == "lost without"
    assert words == "c11 11 %, c10 10 %, c09 9.0 %, c08 8.0 %, c07 7.0 %, c06 6.0 %, c05 5.0 %, c04 4.0 %; 4 others less"
