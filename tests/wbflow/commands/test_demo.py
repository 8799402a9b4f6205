"""`wbflow demo`: its files can be run as they are, and files of the user stay untouched."""

from __future__ import annotations

import datetime
import hashlib
import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.helpers.images import read_image
from tests.helpers.synthetic_site import small_yard
from wbflow.cache.memo import Digests
from wbflow.cache.ply import read_ply
from wbflow.commands.demo import write_demo
from wbflow.errors import UsageError
from wbflow.site.captures import find_captures, night
from wbflow.site.load import load_site
from wbflow_demo.render.photograph import DemoSite, Shots


def rendered(shots: Shots) -> DemoSite:
    """The small yard, rendered once (rendering is tested elsewhere), with at most `shots.captures` captures per camera."""
    site = small_yard(shots.light)
    return replace(site, cameras=tuple(replace(c, captures=c.captures[: shots.captures]) for c in site.cameras))


@pytest.fixture(autouse=True)
def _rendered_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("wbflow_demo.yard.yard", rendered)


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("demo") / "yard"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("wbflow_demo.yard.yard", rendered)
        write_demo(folder, small=True)
    return folder


def test_the_site_file_is_valid_and_finds_every_capture(written: Path) -> None:
    site = load_site(written)
    date = night(site, None)
    assert date == datetime.date(2026, 11, 19)
    captures = find_captures(site, date, Digests(None))
    assert {name: len(files) for name, files in captures.items()} == {c.name: 3 for c in small_yard().cameras}
    assert site.posed


def test_the_site_file_states_the_true_cameras(written: Path) -> None:
    for camera in load_site(written).cameras:
        truth = small_yard()[camera.id]
        assert truth.lens.K is not None and camera.lens.K is not None
        assert camera.placement.R is not None and camera.placement.C is not None
        assert np.allclose(camera.lens.K, truth.lens.K)
        assert np.allclose(camera.lens.distortion, truth.lens.distortion)
        assert np.allclose(camera.placement.R, truth.camera.R)
        assert np.allclose(camera.placement.C, truth.camera.C)


def test_captures_and_masks_have_the_stated_size(written: Path) -> None:
    for camera in load_site(written).cameras:
        capture = read_image(written / "captures" / camera.id / "2026-11-19_1.jpg")
        assert capture.shape == (180, 320, 3)
        assert np.abs(capture[..., ::-1].astype(int) - small_yard()[camera.id].captures[0]).mean() < 6  # JPEG, RGB in order
        assert camera.mask is not None
        mask = read_image(camera.mask, cv2.IMREAD_UNCHANGED)
        assert np.array_equal(mask > 0, small_yard()[camera.id].mask)


def test_the_truth_is_written_beside_the_site(written: Path) -> None:
    cloud = read_ply(written / "truth" / "reference.ply")
    reference = small_yard().reference
    assert np.array_equal(np.column_stack([cloud["x"], cloud["y"], cloud["z"]]), reference.points)
    assert np.array_equal(cloud["red"], reference.colors[:, 0])
    assert json.loads((written / "truth" / "reference.json").read_text())["points"] == len(reference.points)
    for camera in small_yard().cameras:
        with np.load(written / "truth" / "depth" / f"{camera.name}.npz") as file:
            assert np.array_equal(file["depth"], camera.depth)
    assert (written / "truth" / "cameras.json").read_bytes() == (written / "cameras.json").read_bytes()


def test_writing_again_gives_the_same_bytes_and_keeps_other_files(written: Path) -> None:
    work = written / ".wbflow" / "yard" / "ledger.sqlite"
    work.parent.mkdir(parents=True, exist_ok=True)
    work.write_text("a run was here")
    before = {p: hashlib.sha256(p.read_bytes()).digest() for p in written.rglob("*") if p.is_file()}
    write_demo(written, small=True)
    assert {p: hashlib.sha256(p.read_bytes()).digest() for p in written.rglob("*") if p.is_file()} == before


def test_files_of_an_earlier_demo_that_are_not_written_again_are_removed(tmp_path: Path) -> None:
    write_demo(tmp_path / "demo", small=True, captures=3)
    write_demo(tmp_path / "demo", small=True, captures=2)
    assert sorted(p.name for p in (tmp_path / "demo" / "captures" / "mast-2").iterdir()) == [
        "2026-11-19_1.jpg",
        "2026-11-19_2.jpg",
    ]


def test_a_demo_that_was_interrupted_can_be_written_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from wbflow_demo import files

    def stops(site: DemoSite, scene: str, light: str, lenses: str, has_poses: bool) -> Iterator[tuple[str, bytes]]:
        yield "captures/mast-2/2026-11-19_1.jpg", b"half"
        raise KeyboardInterrupt

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(files, "scene_files", stops)
        write_demo(tmp_path / "demo", small=True)
    write_demo(tmp_path / "demo", small=True)
    assert load_site(tmp_path / "demo").posed


def test_folders_with_other_files_are_refused_and_left_unchanged(tmp_path: Path) -> None:
    (tmp_path / "thesis.txt").write_text("years of work")
    with pytest.raises(UsageError, match="contains other files"):
        write_demo(tmp_path, small=True)
    assert [p.name for p in tmp_path.iterdir()] == ["thesis.txt"]
    with pytest.raises(UsageError, match="is a file"):
        write_demo(tmp_path / "thesis.txt", small=True)


@pytest.mark.parametrize("name", ["site.yaml", "cameras.json"])
def test_edited_files_of_the_demo_are_not_overwritten(tmp_path: Path, name: str) -> None:
    write_demo(tmp_path / "demo", small=True)
    file = tmp_path / "demo" / name
    edited = file.read_text() + "\n"
    file.write_text(edited)
    with pytest.raises(UsageError, match="edited"):
        write_demo(tmp_path / "demo", small=True)
    assert file.read_text() == edited


def test_only_demos_of_other_scenes_name_their_scene_in_the_manifest(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("wbflow_demo.square.square", rendered)
    write_demo(tmp_path / "square", scene="square", small=True, captures=2)
    assert load_site(tmp_path / "square").name == "square"
    assert json.loads((tmp_path / "square" / "demo.json").read_text())["scene"] == "square"
    assert "a public square" in (tmp_path / "square" / "README.txt").read_text()
    write_demo(tmp_path / "yard", small=True)
    assert "scene" not in json.loads((tmp_path / "yard" / "demo.json").read_text())


def test_an_unknown_scene_writes_nothing(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="there is no scene 'moon'"):
        write_demo(tmp_path / "demo", scene="moon")
    assert not (tmp_path / "demo").exists()


def test_an_unknown_light_writes_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.undo()
    with pytest.raises(ValueError, match="noon"):
        write_demo(tmp_path / "demo", small=True, light="noon")
    assert not (tmp_path / "demo").exists()


def test_a_walk_states_lenses_but_no_poses_and_adds_recordings_of_each_camera(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("wbflow_demo.walk.SECONDS", 1)
    write_demo(tmp_path / "yard", small=True, walk=True)
    site = load_site(tmp_path / "yard")
    assert not site.posed
    assert all(camera.lens.K is not None for camera in site.cameras)
    truth = json.loads((tmp_path / "yard" / "truth" / "walk.json").read_text())
    for light in ("night", "day"):
        videos = {file.stem for file in (tmp_path / "yard" / "walk" / light).iterdir()}
        assert videos == {camera.id for camera in site.cameras} == truth[light]["clock_s"].keys()
    assert all("R" in entry for entry in json.loads((tmp_path / "yard" / "truth" / "cameras.json").read_text()).values())


def test_a_walk_leads_through_the_standard_yard_only(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="standard yard"):
        write_demo(tmp_path / "square", scene="square", walk=True)
