"""What a run publishes beside its cloud: files of site-wide stages, kept in the cache, and figures in run.json and the report."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import pytest

from tests.helpers.toy_site import ToySite
from wbflow.graph import pipeline
from wbflow.graph.pipeline import Reports, Role

MODULE = """
calls = []
def files(result):
    calls.append(1)
    yield "toy.txt", b"%s: a world of " + str(len(result.cameras)).encode()
    if %s:
        raise ValueError("no map has the place")
"""


@pytest.fixture
def toy_with_files(toy: ToySite, monkeypatch: pytest.MonkeyPatch) -> ToySite:
    """A toy site whose solved world is published as a text, too."""
    world = pipeline.stage_with(Role.WORLD)
    mine = dataclasses.replace(world, files="toyfiles:files", title="The toy world", reports=Reports({"metric": "metric"}))
    rows = tuple(mine if row is world else row for row in pipeline.STAGES)
    for module in ("wbflow.night.plan", "wbflow.results.beside", "wbflow.results.report.ground"):
        monkeypatch.setattr(f"{module}.STAGES", rows)
    write(toy, "first")
    return toy


def write(toy: ToySite, words: str, fails: bool = False) -> None:
    import sys

    sys.modules.pop("toyfiles", None)
    (toy.folder / "toyfiles.py").write_text(MODULE % (words, fails))


def latest(toy: ToySite) -> Path:
    return toy.work / "runs" / "latest"


def test_files_and_figures_stand_beside_the_cloud(toy_with_files: ToySite) -> None:
    record = toy_with_files.run()
    assert (latest(toy_with_files) / "toy.txt").read_bytes() == b"first: a world of 4"
    told: dict[str, Any] = record[pipeline.stage_with(Role.WORLD).name]
    assert told == {"metric": True, "files": ["toy.txt"], "reason": None}
    page = (latest(toy_with_files) / "report.html").read_text()
    assert "The toy world" in page
    assert "href='toy.txt'" in page


def test_they_are_not_made_again_but_by_another_function(toy_with_files: ToySite) -> None:
    toy_with_files.run()
    import toyfiles  # type: ignore[import-not-found]

    made = len(toyfiles.calls)
    toy_with_files.run()
    assert len(toyfiles.calls) == made
    assert (latest(toy_with_files) / "toy.txt").read_bytes().startswith(b"first")
    write(toy_with_files, "second")
    record = toy_with_files.run()
    assert record["tasks"]["ran"] == 0
    assert (latest(toy_with_files) / "toy.txt").read_bytes().startswith(b"second")


def test_a_damaged_one_is_made_again(toy_with_files: ToySite) -> None:
    toy_with_files.run()
    (kept,) = (toy_with_files.work / "cache").rglob("*.toy.txt.beside")
    kept.write_bytes(b"rubbish")
    toy_with_files.run()
    assert (latest(toy_with_files) / "toy.txt").read_bytes() == b"first: a world of 4"


def test_what_cannot_be_made_is_told_and_the_night_is_not_lost(toy_with_files: ToySite) -> None:
    write(toy_with_files, "third", fails=True)
    toy_with_files.run()
    assert (latest(toy_with_files) / "toy.txt").is_file()
    assert "no map has the place" in (latest(toy_with_files) / "log.jsonl").read_text()
