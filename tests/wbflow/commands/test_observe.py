"""`wbflow observe`: observations from recordings, and the cameras that they place."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner, Result

from tests.helpers.toy_site import HELPERS, ToySite
from wbflow.cli.main import main
from wbflow.errors import UsageError
from wbflow.site.calibration import read_calibration
from wbflow.site.load import load_site
from wbflow_stages.types import Observations, Sightings, ThingSurvey

CAMERAS = ["gate", "roof", "mast"]
ROLEX = Path(os.environ.get("WBFLOW_DATA") or Path(__file__).resolve().parents[4] / "shared" / "data") / "rolex"
ROWS = "frame,camera,x,y\n0,gate,1,2\n0,roof,3,4\n1,gate,5,6\n1,mast,7,8\n"
LENS = {"fx": 50, "fy": 50, "cx": 32, "cy": 24, "width": 64, "height": 48}


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ToySite:
    """A toy site whose cameras have lenses, and an empty recording of each in the folder `walk`."""
    monkeypatch.syspath_prepend(str(HELPERS))
    site = ToySite(tmp_path / "site", CAMERAS, {"observed": {}}, backend="threading")
    written = json.loads(site.file.read_text())
    written["cameras"] = [{"id": name, "intrinsics": LENS} for name in CAMERAS]
    written["stages"]["observed"] = {"use": "toy_stages:solve_observations"}
    site.file.write_text(json.dumps(written, indent=1))
    (site.folder / "walk").mkdir()
    for name in CAMERAS:
        (site.folder / "walk" / f"{name}.mp4").write_bytes(name.encode())
    return site


def observe(site: ToySite, *arguments: str) -> Result:
    return CliRunner().invoke(main, ["observe", str(site.file), *arguments], env=site.env())


def with_table(site: ToySite, rows: str = ROWS) -> None:
    written = json.loads(site.file.read_text())
    site.file.write_text(json.dumps({**written, "observations": "seen.csv"}, indent=1))
    (site.folder / "seen.csv").write_text(rows)


@pytest.fixture
def recorder(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Stands for what finds things in recordings: what it was given, and what it is to find."""
    told: dict[str, Any] = {"lengths": ()}

    def find(recordings: Mapping[str, Any], board: Any, *, times: Any, lenses: Any) -> Sightings:
        told.update(board=board, times=times, lenses=lenses, data={name: file.read() for name, file in recordings.items()})
        if told.get("nothing"):
            raise ValueError("no recording shows a lamp")
        cameras = tuple(recordings)
        count = len(cameras)
        things = ("a", "b", "c") if told["lengths"] else ("lamp",)
        rows = Observations(
            cameras,
            things,
            np.arange(count, dtype=np.int32),
            np.arange(count, dtype=np.int32) % len(things),
            np.full(count, 0.5),
            np.arange(2.0 * count).reshape(-1, 2),
            np.full(count, 0.25),
        )
        survey = ThingSurvey(things, lengths=told["lengths"])
        return Sightings(rows, survey, dict.fromkeys(cameras, b"a picture"), ("the lamp was seen",))

    monkeypatch.setattr("wbflow_stages.recordings.observe_recordings", find)
    return told


def test_the_tables_of_the_site_place_its_cameras(site: ToySite) -> None:
    with_table(site)
    result = observe(site)
    assert result.exit_code == 0, result.output
    assert "toy: 3 of 3 cameras placed" in result.output and "scale: survey" in result.output
    (row,) = [line for line in result.output.splitlines() if line.startswith("gate ")]
    assert row.split() == ["gate", "2", "2", "0.50", "20", "mm", "0.010", "+0.00", "frames"]
    found = read_calibration(site.work / "observed" / "cameras.json")
    assert found["gate"].placement.C == [14.0, 0.0, 3.0] and found["gate"].placement.sigma_m == 0.02


def test_a_run_takes_the_result_from_the_cache(site: ToySite) -> None:
    with_table(site)
    observe(site)
    site.run()
    assert "observed" not in site.ran() and "poses" in site.ran()


def test_json_has_the_figures_and_nothing_else(site: ToySite) -> None:
    with_table(site)
    data = json.loads(observe(site, "--json", "--out", str(site.folder / "out")).stdout)
    assert data["cameras"]["roof"]["used"] == 1 and data["exit_code"] == 0
    assert data["files"] == [str(site.folder / "out" / "cameras.json")] and Path(data["calibration"]).exists()


def test_a_camera_that_is_not_placed_is_degraded_with_its_reason(site: ToySite) -> None:
    with_table(site, ROWS + "2,roof,1,1\n")
    written = json.loads(site.file.read_text())
    written["stages"]["observed"]["least"] = 2
    site.file.write_text(json.dumps(written))
    result = observe(site)
    assert result.exit_code == 3
    assert "2 of 3 cameras placed" in result.output and "mast is not placed: 1 observations, 2 needed" in result.output


def test_without_any_placed_camera_it_fails_with_the_reason(site: ToySite) -> None:
    with_table(site)
    written = json.loads(site.file.read_text())
    written["stages"]["observed"]["least"] = 9
    site.file.write_text(json.dumps(written))
    result = observe(site)
    assert result.exit_code == 1 and "no camera is placed: nobody saw it at once" in result.output


def test_a_site_without_tables_asks_for_recordings(site: ToySite) -> None:
    result = observe(site)
    assert result.exit_code == 2
    assert "names no observations" in result.output and "RECORDINGS" in result.output


def test_recordings_become_tables_and_pictures_and_the_site_file_names_them(site: ToySite, recorder: dict[str, Any]) -> None:
    result = observe(site, str(site.folder / "walk"))
    assert result.exit_code == 0, result.output
    assert recorder["data"] == {name: name.encode() for name in CAMERAS} and recorder["board"] is None
    assert recorder["lenses"]["gate"].K[0, 0] == 50
    lines = (site.folder / "observations.csv").read_text().splitlines()
    assert lines[:2] == ["time,camera,x,y,sigma", "0.500000,gate,0.000,1.000,0.25"] and len(lines) == 4
    assert load_site(site.file).settings.observations == "observations.csv"
    assert (site.work / "observed" / "roof.jpg").read_bytes() == b"a picture"
    assert "the lamp was seen" in result.output and "3 of 3 cameras placed" in result.output


def test_comments_and_layout_of_the_site_file_stay(site: ToySite, recorder: dict[str, Any]) -> None:
    stages = json.dumps(json.loads(site.file.read_text())["stages"])
    lens = json.dumps(LENS)
    cameras = "".join(f"  - {{id: {name}, intrinsics: {lens}}}   # here\n" for name in CAMERAS)
    captures = "{root: captures, pattern: '{camera}.txt'}"
    text = f"site: toy  # the yard\ncaptures: {captures}\ncameras:\n{cameras}stages: {stages}\n# end\n"
    site.file.write_bytes(b"\xef\xbb\xbf" + text.encode())
    assert observe(site, str(site.folder / "walk")).exit_code == 0
    assert site.file.read_bytes().decode() == "﻿" + text.replace("# end", "observations: observations.csv\n# end")


def test_an_earlier_table_is_kept_under_another_name(site: ToySite, recorder: dict[str, Any]) -> None:
    with_table(site)
    result = observe(site, str(site.folder / "walk"))
    assert (site.folder / "seen-1.csv").read_text() == ROWS
    assert "the seen.csv that was there is seen-1.csv now" in result.output
    assert (site.folder / "seen.csv").read_text().startswith("time,camera")


def test_a_board_brings_its_lengths(site: ToySite, recorder: dict[str, Any]) -> None:
    recorder["lengths"] = ((0, 1, 0.054),)
    board = ["--board", "4x5", "--square", "0.054", "--marker", "0.04"]
    assert observe(site, str(site.folder / "walk"), *board).exit_code == 0
    assert recorder["board"] == {"columns": 4, "rows": 5, "square": 0.054, "marker": 0.04, "dictionary": "4X4_50"}
    assert (site.folder / "survey.csv").read_text() == "id,to,metres\na,b,0.054\n"
    found = load_site(site.file)
    assert found.settings.survey == "survey.csv"
    assert found.thing_survey is not None and found.thing_survey.rows.lengths == ((0, 1, 0.054),)


def test_times_of_frames_may_come_from_a_table(site: ToySite, recorder: dict[str, Any]) -> None:
    times = site.folder / "times.csv"
    times.write_text("camera,frame,seconds\ngate,0,5.5\ngate,2,5.9\nroof,0,5.6\n")
    assert observe(site, str(site.folder / "walk"), "--times", str(times)).exit_code == 0
    assert recorder["times"]["gate"].tolist()[::2] == [5.5, 5.9] and np.isnan(recorder["times"]["gate"][1])
    times.write_text("camera,frame,seconds\ngate,1.5,5.5\n")
    result = observe(site, str(site.folder / "walk"), "--times", str(times))
    assert result.exit_code == 2 and "times.csv:2: frame 1.5 is none" in result.output


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["gate={walk}/gate.mp4", "rof={walk}/roof.mp4"], "no camera 'rof'\n  did you mean 'roof'?"),
        (["{walk}/gate.mp4"], "recordings of two cameras or more are needed; there are those of gate"),
        (["{walk}/gate.mp4", "gate={walk}/roof.mp4"], "gate has two recordings"),
        (["{walk}/rooof.mp4"], "there is no camera 'rooof'"),
        (["gate={walk}/none.mp4", "{walk}/roof.mp4"], "there is no file"),
    ],
)
def test_recordings_that_fit_no_camera_are_refused(site: ToySite, arguments: list[str], words: str) -> None:
    walk = str(site.folder / "walk")
    result = observe(site, *(argument.format(walk=walk) for argument in arguments))
    assert result.exit_code == 2 and words in result.output
    assert not (site.folder / "observations.csv").exists()


def test_recordings_that_show_nothing_change_nothing(site: ToySite, recorder: dict[str, Any]) -> None:
    recorder["nothing"] = True
    before = site.file.read_bytes()
    result = observe(site, str(site.folder / "walk"))
    assert result.exit_code == UsageError.exit_code and "no recording shows a lamp" in result.output
    assert site.file.read_bytes() == before and not (site.folder / "observations.csv").exists()


@pytest.mark.skipif(not (ROLEX / "drone.csv").exists(), reason="needs the data of rolex: set WBFLOW_DATA")
def test_a_drone_places_five_cameras_that_share_no_texture(tmp_path: Path) -> None:
    (tmp_path / "site.yaml").write_text(
        f"site: rolex\ncaptures: {{root: '{ROLEX}/images', pattern: '{{camera}}.jpg'}}\n"
        f"cameras: [cam0, cam1, cam2, cam3, cam4]\ncalibration: '{ROLEX}/cameras.json'\n"
        f"observations: '{ROLEX}/drone.csv'\nsurvey: '{ROLEX}/gps.csv'\n"
    )
    result = CliRunner().invoke(main, ["observe", str(tmp_path), "--json"])
    assert result.exit_code == 0, result.output
    data = json.loads(result.stdout)
    assert all(camera["reason"] == "" for camera in data["cameras"].values()) and len(data["cameras"]) == 5
    assert data["reprojection_px"] < 3 and data["survey_m"] < 0.9 and data["metric"]
    found = read_calibration(Path(data["calibration"]))
    centres = np.array([entry.placement.C for entry in found.values()])
    apart = np.linalg.norm(centres[:, None] - centres, axis=-1)[np.triu_indices(5, 1)]
    assert apart.min() > 30 and apart.max() < 140  # 40 to 126 m, by the drone's own receiver
