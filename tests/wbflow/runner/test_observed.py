"""Stage `observed` in a night: poses from tables of observations, as evidence for the stages after it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from tests.helpers.toy_site import HELPERS, ToySite
from wbflow.cache.ply import read_ply

ROWS = "frame,camera,x,y\n0,gate,1,2\n0,roof,3,4\n1,gate,5,6\n1,mast,7,8\n"
CAMERAS = ["gate", "roof", "mast"]


@pytest.fixture(autouse=True)
def _toy_stages(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(HELPERS))


def observed_site(folder: Path, **parameters: Any) -> ToySite:
    site = ToySite(
        folder / "site",
        CAMERAS,
        {"observed": parameters},
        keys={"observations": "seen.csv"},
        dated=True,
        backend="threading",
    )
    (site.folder / "seen.csv").write_text(ROWS)
    site.night("2026-11-01")
    return site


def published(site: ToySite) -> dict[str, Any]:
    cameras: dict[str, Any] = json.loads((site.work / "runs" / "latest" / "cameras.json").read_text())
    return cameras


def test_observed_cameras_are_placed_and_reported(tmp_path: Path) -> None:
    site = observed_site(tmp_path)
    record = site.run()
    result = record["observed"]
    assert result["cameras"]["gate"]["used"] == 2 and result["scale"] == "survey"
    assert {camera["pose_from"] for camera in record["cameras"]} == {"observed"}
    # the toy stage places a camera at the sum of its pixels: columns and ids have arrived as they are in the file
    assert [published(site)[name]["C"][0] for name in CAMERAS] == [14, 7, 15]


def test_a_later_night_does_not_place_them_again(tmp_path: Path) -> None:
    site = observed_site(tmp_path)
    site.run()
    site.night("2026-11-02")
    assert site.run()["date"] == "2026-11-02"
    assert "observed" not in site.ran()


def test_the_content_of_the_tables_counts_not_their_text(tmp_path: Path) -> None:
    site = observed_site(tmp_path)
    site.run()
    (site.folder / "other.csv").write_text(ROWS.replace(",", ";").replace("frame", "Frame"))
    (site.folder / "seen.csv").unlink()
    site.keys = {"observations": "other.csv"}
    site.write()
    site.run()
    assert site.ran() == set()
    (site.folder / "other.csv").write_text(ROWS.replace("7,8", "7,9"))
    site.run()
    assert {"observed", "poses"} <= site.ran() and "features gate" not in site.ran()


def test_a_survey_reaches_the_stage_in_metres_of_the_site(tmp_path: Path) -> None:
    site = observed_site(tmp_path)
    (site.folder / "where.csv").write_text("frame,easting,northing,up\n0,1,2,3\n1,4,5,6.5\n")
    site.keys["survey"] = "where.csv"
    site.write()
    site.run()
    assert published(site)["gate"]["C"][1] == 21.5


def test_a_camera_that_is_not_placed_says_why(tmp_path: Path) -> None:
    site = observed_site(tmp_path, least=2)
    (site.folder / "seen.csv").write_text(ROWS + "2,roof,1,1\n")
    record = site.run()
    of_mast = record["observed"]["cameras"]["mast"]
    assert of_mast["reason"] == "1 observations, 2 needed" and of_mast["used"] == 0


def test_without_any_placed_camera_the_night_is_degraded_and_goes_on_by_matches(tmp_path: Path) -> None:
    site = observed_site(tmp_path, least=3)
    record = site.run(code=3)
    (found,) = record["verdict"]["findings"]
    assert found["kind"] == "observations-unused"
    assert found["text"] == "the observations place no camera: nobody saw it at once"
    assert record["cloud"]["points"] > 0


@pytest.mark.parametrize("fault", ["die", "once"])
def test_a_killed_solver_costs_only_its_own_result(tmp_path: Path, fault: str) -> None:
    site = observed_site(tmp_path)
    site.backend = "processes"
    undisturbed = ToySite(tmp_path / "other", CAMERAS, keys=site.keys, dated=True)
    (undisturbed.folder / "seen.csv").write_text(ROWS)
    undisturbed.night("2026-11-01")
    undisturbed.run()
    site.fault(fault, "observed")
    record = site.run(code=3 if fault == "die" else 0)
    assert record["cloud"]["points"] > 0
    # the next run makes what is missing, and the cloud is that of a run without the fault
    if fault == "die":
        (site.folder / "faults" / "die").unlink()
        site.run()
        assert "observed" in site.ran()
    clouds = [read_ply(each.work / "runs" / "latest-good" / "cloud.ply") for each in (site, undisturbed)]
    assert all((clouds[0][name] == clouds[1][name]).all() for name in clouds[0])


def test_other_observations_need_another_reference(tmp_path: Path) -> None:
    site = observed_site(tmp_path)
    site.watched = True
    site.write()
    site.run()
    site.night("2026-11-02")
    assert site.run()["reference"]
    (site.folder / "seen.csv").write_text(ROWS.replace("7,8", "7,9"))
    site.night("2026-11-03")
    record = site.run(code=None)
    assert record["reference"] is None
    assert [camera["pose_from"] for camera in record["cameras"]] == ["observed"] * 3


def test_a_site_without_observations_has_no_such_stage(tmp_path: Path) -> None:
    site = ToySite(tmp_path / "site", CAMERAS, backend="threading")
    site.run()
    assert not (site.work / "cache" / "observed").exists()
    assert "observed" not in site.wbflow("status").stdout
