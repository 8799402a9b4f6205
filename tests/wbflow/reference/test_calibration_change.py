"""A calibration that has changed since the reference was pinned is reported: what has changed, and by how much."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest

from tests.helpers.toy_site import ToySite
from wbflow.reference.compatibility import calibration_change
from wbflow.site.load import load_site

NAMES = ("gate", "roof", "mast")


def calibration(
    focal: float = 500.0, k1: float = -0.2, turned_deg: float = 0.0, scale: float = 1.0, of: tuple[str, ...] = NAMES
) -> dict[str, Any]:
    """Calibration of three cameras: `focal` and `k1` apply to those in `of`; `mast` is turned about z; positions are scaled."""
    found = {}
    for k, name in enumerate(NAMES):
        changed = name in of
        c, s = (f(math.radians(turned_deg if name == "mast" else 0.0)) for f in (math.cos, math.sin))
        f = focal if changed else 500.0
        found[name] = {
            "K": [[f, 0, 320], [0, f, 180], [0, 0, 1]],
            "R": [[c, -s, 0], [s, c, 0], [0, 0, 1]],
            "C": [scale * k, scale * k * k, 0],
            "width": 640,
            "height": 360,
            "distortion": [k1 if changed else -0.2, 0, 0, 0, 0],
        }
    return found


def change(folder: Path, now: dict[str, Any]) -> str:
    (folder / "cameras.json").write_text(json.dumps(now))
    (folder / "site.yaml").write_text(
        f"site: s\ncaptures: {{root: ., pattern: '{{camera}}.jpg'}}\ncameras: [{', '.join(NAMES)}]\ncalibration: cameras.json\n"
    )
    return calibration_change(calibration(), load_site(folder))


def test_an_equal_calibration_in_any_scale_has_not_changed(tmp_path: Path) -> None:
    assert change(tmp_path, calibration()) == ""
    assert change(tmp_path, calibration(scale=7.0)) == "", "the frame and scale of a pinned world are its own"


@pytest.mark.parametrize(
    ("now", "words"),
    [
        (calibration(focal=550), "focal lengths of all cameras by +10.0 %"),
        (calibration(focal=550, of=("roof",)), "focal lengths of roof by +10.0 %"),
        (calibration(k1=0.0), "there is none any more"),
        (calibration(k1=-0.1), "distortion of all cameras by up to"),
        (calibration(turned_deg=3.0), "poses by up to 3.0 degrees"),
    ],
)
def test_a_change_of_the_calibration_is_described_with_its_amount(tmp_path: Path, now: dict[str, Any], words: str) -> None:
    assert words in change(tmp_path, now)


def test_a_changed_calibration_degrades_nights_until_it_is_pinned(toy: ToySite, tmp_path: Path) -> None:
    site = ToySite(tmp_path / "watched", ["gate", "roof", "mast"], watched=True, dated=True, backend="threading")
    site.keys["calibration"] = "cameras.json"
    (site.folder / "cameras.json").write_text(json.dumps(calibration()))
    site.write()
    site.night("2026-11-01")
    site.run("--date", "2026-11-01")
    (site.folder / "cameras.json").write_text(json.dumps(calibration(focal=550)))
    site.night("2026-11-02")
    record = site.run("--date", "2026-11-02", code=3)
    (found,) = record["verdict"]["findings"]
    assert found["kind"] == "calibration-changed" and "pin it" in found["remedy"]
    assert site.wbflow("pin", record["run"]).returncode == 0
    site.night("2026-11-03")
    assert site.run("--date", "2026-11-03")["reference"] == record["run"]
