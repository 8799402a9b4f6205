"""The whole product on the small demo yard: from captures to a cloud close to the rendered ground truth."""

from __future__ import annotations

import base64
import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from click.testing import CliRunner
from scipy.spatial import cKDTree
from scores import compare_clouds

import wbflow
from tests.helpers.browser import chromium, until
from tests.helpers.images import read_image
from wbflow.cache.ply import read_ply
from wbflow.cli.main import main
from wbflow.commands.demo import write_demo
from wbflow_stages.exports.previews import matches_preview


@pytest.fixture(scope="module")
def yard(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site after its first run.  In a fresh clone that run compiles all kernels, and the others read them from the disk."""
    folder = tmp_path_factory.mktemp("small") / "yard"
    write_demo(folder, small=True)
    record = run(folder)
    assert record["tasks"]["failed"] == 0
    return folder


def run(folder: Path, *arguments: str, code: int = 0) -> dict[str, Any]:
    command = [sys.executable, "-m", "wbflow", "run", str(folder), "--json", *arguments]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    assert result.returncode == code, result.stdout + result.stderr
    record: dict[str, Any] = json.loads(result.stdout)
    return record


def cloud(folder: Path, work: str = ".wbflow/yard") -> Path:
    return folder / work / "runs" / "latest-good" / "cloud.ply"


def test_the_cloud_is_near_the_truth_and_the_next_run_does_nothing(yard: Path) -> None:
    points, reference = (
        np.stack([table[axis] for axis in "xyz"], axis=1)
        for table in (read_ply(cloud(yard)), read_ply(yard / "truth" / "reference.ply"))
    )
    score = compare_clouds(points, reference, taus=(0.1, 0.3))
    assert score.accuracy[1] > 0.8
    assert score.completeness[1] > 0.35
    assert score.accuracy_median < 0.1
    again = run(yard)
    assert again["tasks"]["ran"] == 0
    assert not [note for camera in again["cameras"] for note in camera["notes"] if "clock runs" in note]


def test_the_report_shows_the_inliers_of_every_pair_on_its_frames(yard: Path) -> None:
    found = wbflow.open_run(yard)
    page = found.run_folder.paths.report.read_text()
    assert len(found.pairs) == 6
    for pair in found.pairs.values():
        frames = (found.artifact(f"frames {camera}") for camera in (pair.left, pair.right))
        picture = matches_preview(found.artifact(f"geometry {pair.name}"), *frames)
        assert base64.b64encode(picture.tobytes()).decode() in page


def test_distances_measured_in_the_page_agree_with_their_standard_deviations(yard: Path) -> None:
    """Points are clicked all over the 3-D view; the true place of each is its projection onto the nearest true surface."""
    webdriver = pytest.importorskip("selenium.webdriver")
    with chromium(1000, 800) as browser:
        browser.get(wbflow.open_run(yard).run_folder.paths.report.as_uri())
        until(browser, "return document.querySelector('#view').dataset.state === 'ready'")
        browser.execute_script("document.querySelector('[data-do=measure]').click()")
        canvas = browser.find_element("css selector", "#view canvas.over")
        for across in range(-240, 241, 30):
            for down in range(-80, 161, 20):
                webdriver.ActionChains(browser, duration=0).move_to_element_with_offset(canvas, across, down).click().perform()
        found = browser.execute_script("return measure.points.map(q => [...measure.world(q.p), q.sigma])")
    points, sigma = np.array(found)[:, :3], np.array(found)[:, 3]
    assert len(points) > 100
    truth = read_ply(yard / "truth" / "reference.ply")
    at, normals = (
        np.stack([truth[name].astype(float) for name in names], axis=1) for names in (("x", "y", "z"), ("nx", "ny", "nz"))
    )
    nearest = cKDTree(at).query(points)[1]
    off = np.sum((points - at[nearest]) * normals[nearest], axis=1, keepdims=True)
    true = points - off * normals[nearest]
    one, other = np.triu_indices(len(points), 1)
    error = np.abs(np.linalg.norm(points[one] - points[other], axis=1) - np.linalg.norm(true[one] - true[other], axis=1))
    error /= np.hypot(sigma[one], sigma[other])
    assert np.mean(error < 1) > 0.68
    assert np.mean(error < 2) > 0.95


def test_the_cloud_does_not_depend_on_workers_or_compiled_kernels(yard: Path) -> None:
    run(yard, "--jobs", "1", "--work", str(yard / "alone"))
    assert cloud(yard).read_bytes() == cloud(yard, "alone").read_bytes()


def test_compare_writes_a_page_with_two_runs_in_one_view(yard: Path, tmp_path: Path) -> None:
    first, second = (run(yard)["run"] for _ in range(2))
    page = tmp_path / "both.html"
    result = CliRunner().invoke(main, ["compare", str(yard), first, second, "--page", str(page)])
    assert result.exit_code == 0, result.output
    text = page.read_text()
    assert [text.count(f'class="points" data-of="{kind}"') for kind in ("product", "change", "then")] == [1, 1, 1]
    assert text.count('<div class="both"') == 4
    assert "Nothing has changed" in text and '<section id="pairs">' not in text
    assert page.stat().st_size < 15_000_000
    folders = [str(yard / ".wbflow" / "yard" / "runs" / name) for name in (first, second)]
    result = CliRunner().invoke(main, ["compare", *folders, "--page", str(page)])
    assert result.exit_code == 2 and "needs the site" in result.output


def test_comparing_a_run_with_itself_finds_no_changes(yard: Path) -> None:
    folder = str(wbflow.open_run(yard).folder)
    result = CliRunner().invoke(main, ["compare", folder, folder, "--changes", "--json"])
    assert result.exit_code == 0, result.output
    found = json.loads(result.output)["changes"]
    assert (found["cut_fill"]["gained"], found["cut_fill"]["lost"], found["changes"]) == (0.0, 0.0, [])
    assert found["cut_fill"]["area"] > 200


def test_the_cloud_has_the_columns_that_other_programs_rely_on(yard: Path) -> None:
    table = read_ply(cloud(yard))
    wanted = ["x", "y", "z", "nx", "ny", "nz", "red", "green", "blue", "confidence", "views"]
    assert list(table)[: len(wanted)] == wanted
    normals = np.stack([table[n] for n in ("nx", "ny", "nz")], axis=1)
    assert np.allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-3)
    assert table["views"].min() >= 1
    open3d = pytest.importorskip("open3d")
    assert len(open3d.io.read_point_cloud(str(cloud(yard))).points) == len(table["x"])


def test_faulty_captures_cost_only_their_cameras(yard: Path, tmp_path: Path) -> None:
    folder = tmp_path / "faulty"
    shutil.copytree(yard, folder, ignore=shutil.ignore_patterns(".wbflow", "alone", "truth"))
    first, second, *_ = sorted(path.name for path in (folder / "captures").iterdir())
    for file in (folder / "captures" / first).iterdir():
        file.write_bytes(file.read_bytes()[:1000])
    for i, file in enumerate(sorted((folder / "captures" / second).iterdir())):
        if i == 0:
            file.write_text("not a photograph")
        if i == 1:
            cv2.imwrite(str(file), np.zeros((180, 320, 3), np.uint8))
    record = run(folder, code=3)
    cameras = {camera["id"]: camera for camera in record["cameras"]}
    assert cameras[first]["outcome"] == "failed"
    assert "truncated" in cameras[first]["reason"]
    assert cameras[second]["outcome"] == "ok", "one capture of three is left"
    assert len(cameras[second]["notes"]) == 2
    assert record["cloud"]["points"] > 1000


def test_a_turned_camera_is_named_with_its_angle_and_the_others_stay(yard: Path, tmp_path: Path) -> None:
    cameras = json.loads((yard / "cameras.json").read_text())
    name, entry = sorted(cameras.items())[1]
    angle = np.radians(3.0)
    turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    entry["R"] = (turn @ np.array(entry["R"])).tolist()
    turned = tmp_path / "turned.json"
    turned.write_text(json.dumps(cameras))
    site = yard / "turned.yaml"
    site.write_text((yard / "site.yaml").read_text().replace("calibration: cameras.json", f"calibration: {turned}"))
    record = run(site, "--until", "poses", "--work", str(yard / ".wbflow" / "yard"), code=3)
    assert [issue["camera"] for issue in record["poses"]["issues"] if issue["kind"] == "moved"] == [name]
    poses = {camera["id"]: camera["pose"] for camera in record["cameras"]}
    assert poses[name]["moved"] and abs(poses[name]["off_deg"] - 3) < 0.3 and poses[name]["off_m"] < 0.2
    assert all(pose["epipolar_px"] < 1 and pose["inliers"] > 50 for camera, pose in poses.items() if camera != name)
    run_folder = yard / ".wbflow" / "yard" / "runs" / record["run"]
    assert "Has it been moved?" in (run_folder / "report.html").read_text()
    solved = json.loads((run_folder / "cameras.json").read_text())
    assert all(np.allclose(solved[camera]["C"], cameras[camera]["C"]) for camera in cameras if camera != name)


def test_debug_scripts_of_every_stage_reproduce_the_bytes_in_the_cache(yard: Path, tmp_path: Path) -> None:
    """The scripts that `wbflow debug` writes run in one process, so that libraries are loaded only once."""
    run(yard)  # so that the newest run has all stages
    tasks = {task.stage: str(task) for task in wbflow.open_run(yard).tasks}
    for stage, task in tasks.items():
        result = CliRunner().invoke(main, ["debug", str(yard), task, "--out", str(tmp_path / stage)])
        assert result.exit_code == 0, result.output
    code = "import runpy, sys\nfor script in sys.argv[1:]: runpy.run_path(script)"
    scripts = [str(tmp_path / stage / "run.py") for stage in tasks]
    done = subprocess.run([sys.executable, "-c", code, *scripts], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    reported = [line for line in done.stdout.splitlines() if line.startswith(str(tmp_path))]
    assert [line.rpartition(": ")[2] for line in reported] == ["the same bytes as the cache has"] * len(tasks)
    assert len(tasks) >= 12
    assert read_image(tmp_path / "features" / "inputs" / "frame.image.png").shape == (180, 320, 3)
