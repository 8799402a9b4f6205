"""Pictures: every pair has one, a repaired picture function reaches cached results, and what cannot be drawn is told."""

from __future__ import annotations

import base64
from pathlib import Path

import pytest

from tests.helpers.toy_site import ToySite

ORIGINAL = "def show(geometry, left, right):\n    return b'first' + bytes(left.image[0, 0, :1])\n"


@pytest.fixture
def toy(toy: ToySite) -> ToySite:
    """Tasks are done in threads: who did them does not matter here."""
    toy.backend = "threading"
    return toy


def pictures(toy: ToySite, stage: str) -> dict[str, bytes]:
    return {path.parent.name: path.read_bytes() for path in (toy.work / "cache" / stage).rglob("*.jpg")}


@pytest.fixture
def painter(toy: ToySite, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A picture function of the geometry that a test can change."""
    import dataclasses

    from wbflow.pipeline import stages as pipeline

    module = toy.folder / "painter.py"
    module.write_text(ORIGINAL)
    stage = pipeline.stage_named("geometry")
    mine = dataclasses.replace(stage, products=dataclasses.replace(stage.products, picture="painter:show"))
    rows = tuple(mine if row is stage else row for row in pipeline.STAGES)
    monkeypatch.setattr("wbflow.runner.planner.STAGES", rows)
    return module


def forget(name: str) -> None:
    import sys

    sys.modules.pop(name, None)


def test_every_pair_has_a_picture_of_its_inliers(toy: ToySite) -> None:
    toy.run()
    found = pictures(toy, "geometry")
    assert len(found) == 6
    assert all(data[:2] == b"\xff\xd8" for data in found.values())


def test_a_picture_gets_what_it_asks_for_and_the_frames_rather_than_the_features(toy: ToySite, painter: Path) -> None:
    toy.run()
    assert all(data.startswith(b"first") for data in pictures(toy, "geometry").values())
    forget("painter")


def test_a_repaired_picture_function_reaches_cached_results_and_reruns_nothing(toy: ToySite, painter: Path) -> None:
    toy.run()
    forget("painter")
    painter.write_text(ORIGINAL.replace("first", "second"))
    record = toy.run()
    assert record["tasks"]["ran"] == 0
    assert all(data.startswith(b"second") for data in pictures(toy, "geometry").values())
    forget("painter")


def test_a_picture_that_cannot_be_drawn_costs_nothing_else_and_is_not_tried_every_night(toy: ToySite, painter: Path) -> None:
    painter.write_text("def show(geometry, left):\n    raise RuntimeError('no paint')\n")
    record = toy.run()
    assert record["tasks"]["failed"] == 0
    assert pictures(toy, "geometry") == {}
    drawn = next((toy.work / "cache" / "geometry").rglob("*.drawn"))
    assert "RuntimeError: no paint" in drawn.read_text()
    forget("painter")
    painter.write_text("raise SystemError('nobody asks')\ndef show(geometry, left):\n    raise RuntimeError('no paint')\n")
    before = drawn.read_text()
    assert toy.run()["tasks"]["ran"] == 0
    assert drawn.read_text() != before, "other code is another try"
    forget("painter")


def test_a_lost_picture_is_drawn_again(toy: ToySite) -> None:
    toy.run()
    before = pictures(toy, "fuse")
    assert before
    for file in (toy.work / "cache" / "fuse").rglob("*.drawn"):
        file.unlink()
    for file in (toy.work / "cache" / "fuse").rglob("*.jpg"):
        file.unlink()
    assert toy.run()["tasks"]["ran"] == 0
    assert pictures(toy, "fuse") == before


def test_a_damaged_picture_is_drawn_again_in_the_same_night_and_named(toy: ToySite) -> None:
    toy.run()
    before = pictures(toy, "geometry")
    for path in (toy.work / "cache" / "geometry" / "gate--roof").glob("*.jpg"):
        path.write_bytes(path.read_bytes()[:-1] + b"x")
    record = toy.run()
    assert [what for what in record["repaired"] if ".jpg is damaged" in what]
    assert pictures(toy, "geometry") == before
    assert record["tasks"]["ran"] == 0


def test_the_points_of_the_page_are_packed_while_the_cloud_is_in_memory(toy: ToySite, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []
    monkeypatch.setattr("wbflow.report.pictures.function", asked.append)  # of what is read back from the cache
    toy.run()
    assert "wbflow_stages.exports.view:cloud_view" not in asked
    (kept,) = (toy.work / "cache" / "fuse").rglob("*.view")
    _, _, stream = kept.read_bytes().partition(b"\n")
    assert base64.b64encode(stream) in (toy.work / "runs" / "latest" / "report.html").read_bytes()


def test_points_that_cannot_be_packed_cost_only_themselves(toy: ToySite, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(cloud: object) -> bytes:
        raise MemoryError

    monkeypatch.setattr("wbflow_stages.exports.view.cloud_view", fail)
    assert toy.run()["cloud"]
    assert not list((toy.work / "cache" / "fuse").rglob("*.view"))
    assert "No report" not in (toy.work / "runs" / "latest" / "report.html").read_text()
