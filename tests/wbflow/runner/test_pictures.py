"""Pictures of results: every pair has one; failing to draw one costs only a warning, and the report omits lost ones."""

from __future__ import annotations

import base64
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.helpers.toy_site import ToySite

ORIGINAL = "def show(geometry, left, right):\n    return b'first' + bytes(left.image[0, 0, :1])\n"


@pytest.fixture
def toy(toy: ToySite) -> ToySite:
    """A toy site whose tasks run in threads, since it does not matter here where they run."""
    toy.backend = "threading"
    return toy


def pictures(toy: ToySite, stage: str) -> dict[str, bytes]:
    return {path.parent.name: path.read_bytes() for path in (toy.work / "cache" / stage).rglob("*.jpg")}


@pytest.fixture
def painter(toy: ToySite, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A module with the picture function of the geometry stage, which a test can change."""
    import dataclasses

    from wbflow.pipeline import stages as pipeline

    module = toy.folder / "painter.py"
    module.write_text(ORIGINAL)
    stage = pipeline.stage_named("geometry")
    product_files = {**stage.products.product_files, "picture": "painter:show"}
    mine = dataclasses.replace(stage, products=dataclasses.replace(stage.products, product_files=product_files))
    monkeypatch.setattr("wbflow.runner.plan.stage_named", lambda name: mine if name == stage.name else pipeline.stage_named(name))
    return module


def forget(name: str) -> None:
    import sys

    sys.modules.pop(name, None)


def test_every_pair_has_a_picture_of_its_inliers(toy: ToySite) -> None:
    toy.run()
    found = pictures(toy, "geometry")
    assert len(found) == 6
    assert all(data[:2] == b"\xff\xd8" for data in found.values())


def test_a_picture_function_gets_the_frames_rather_than_the_features(toy: ToySite, painter: Path) -> None:
    toy.run()
    assert all(data.startswith(b"first") for data in pictures(toy, "geometry").values())
    forget("painter")


def test_a_changed_picture_function_reruns_nothing(toy: ToySite, painter: Path) -> None:
    toy.run()
    before = pictures(toy, "geometry")
    forget("painter")
    painter.write_text(ORIGINAL.replace("first", "second"))
    assert toy.run()["tasks"]["ran"] == 0
    assert pictures(toy, "geometry") == before
    forget("painter")


def test_a_picture_that_cannot_be_drawn_costs_only_a_warning(toy: ToySite, painter: Path) -> None:
    painter.write_text("def show(geometry, left, right):\n    raise RuntimeError('no paint')\n")
    record = toy.run()
    assert record["tasks"]["failed"] == 0
    assert pictures(toy, "geometry") == {}
    warnings = [line for line in (toy.work / "runs" / "latest" / "log.jsonl").read_text().splitlines() if "no paint" in line]
    assert len(warnings) == 6
    assert "its picture could not be drawn: RuntimeError: no paint" in warnings[0]
    assert toy.run()["tasks"]["ran"] == 0
    forget("painter")


@pytest.mark.parametrize("harm", [Path.unlink, lambda path: path.write_bytes(path.read_bytes()[:-1] + b"x")])
def test_a_picture_that_is_lost_or_damaged_is_left_out_of_the_report(toy: ToySite, harm: Callable[[Path], object]) -> None:
    toy.run()
    report = toy.work / "runs" / "latest" / "report.html"
    whole = report.read_text().count("data:image/jpeg")
    for path in (toy.work / "cache" / "geometry" / "gate--roof").glob("*.jpg"):
        harm(path)
    record = toy.run()
    assert record["tasks"]["ran"] == 0
    assert report.read_text().count("data:image/jpeg") == whole - 1


def test_the_picture_of_a_task_without_a_receipt_is_drawn_again(toy: ToySite) -> None:
    """A killed worker may leave a result without a receipt, which is written last, after the artifact and its pictures."""
    toy.keys = {"pin": "none"}  # no reference restores the receipt
    toy.write()
    toy.run()
    before = pictures(toy, "fuse")
    assert before
    for file in [*(toy.work / "cache" / "fuse").rglob("*.jpg"), *(toy.work / "cache" / "fuse").rglob("*.json")]:
        file.unlink()
    assert toy.run()["tasks"]["ran"] == 1
    assert pictures(toy, "fuse") == before


def test_the_report_contains_the_points_that_were_packed_with_the_cloud(toy: ToySite) -> None:
    toy.run()
    (kept,) = (toy.work / "cache" / "fuse").rglob("*.view")
    assert base64.b64encode(kept.read_bytes()) in (toy.work / "runs" / "latest" / "report.html").read_bytes()


def test_a_failure_to_pack_points_costs_neither_cloud_nor_report(toy: ToySite, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(cloud: object) -> bytes:
        raise MemoryError

    monkeypatch.setattr("wbflow_stages.exports.view.cloud_view", fail)
    assert toy.run()["cloud"]
    assert not list((toy.work / "cache" / "fuse").rglob("*.view"))
    assert "No report" not in (toy.work / "runs" / "latest" / "report.html").read_text()
