"""`wbflow check` finds what would spoil a night before it is run."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

from wbflow.cli.main import main

SITE = """\
site: yard
captures: {root: captures, pattern: '{camera}/**/*.png'}
cameras:
- {id: gate%s}
- {id: roof}
%s"""


def picture(path: Path, width: int = 64, height: int = 48) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), np.random.default_rng(list(str(path).encode())).integers(0, 255, (height, width, 3), dtype=np.uint8))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for camera in ("gate", "roof"):
        picture(tmp_path / "captures" / camera / "1.png")
        picture(tmp_path / "captures" / camera / "22.png")
    return tmp_path


def checked(folder: Path, gate: str = "", more: str = "", site: str = SITE) -> tuple[int, str]:
    (folder / "site.yaml").write_text(site % (gate, more))
    result = CliRunner().invoke(main, ["check", str(folder)])
    return result.exit_code, result.output


def test_a_site_without_faults_is_said_to_be_whole(folder: Path) -> None:
    code, output = checked(folder)
    assert code == 0 and "2 cameras, all captures whole" in output


def test_captures_of_another_size_than_the_cameras_others_are_found(folder: Path) -> None:
    picture(folder / "captures" / "gate" / "small" / "333.png", 16, 12)
    code, output = checked(folder)
    assert code == 0 and "camera gate: gate/small/333.png is 16x12, its other captures are 64x48: it is left out" in output
    assert "all captures whole" not in output


def test_a_mask_of_another_size_is_found(folder: Path) -> None:
    picture(folder / "mask.png", 32, 24)
    code, output = checked(folder, ", mask: mask.png")
    assert code == 3 and "mask mask.png is 32x24, its captures are 64x48" in output


def test_privacy_outside_the_picture_is_found_with_and_without_a_lens(folder: Path) -> None:
    polygon = "privacy: [[[100, 0], [200, 0], [200, 40]]]"
    code, output = checked(folder, f", {polygon}")
    assert code == 3 and "the polygon reaches from 100, 0 to 200, 40, the picture is 64x48" in output
    code, output = checked(folder, f", intrinsics: {{fx: 60, fy: 60, cx: 32, cy: 24, width: 64, height: 48}}, {polygon}")
    assert code == 2 and "the picture is 64x48" in output


def test_doubts_about_the_site_file_are_findings(folder: Path) -> None:
    code, output = checked(folder, ", intrinsics: {hfov: 1.25}", "notify: {command: [no-such-program]}\n")
    assert code == 0 and "all captures whole" not in output
    assert "warning: " in output and "1.25 degrees" in output and "71.6 degrees" in output
    assert "no program 'no-such-program'" in output


def test_a_pattern_that_matches_nothing_is_one_finding_with_what_is_there(folder: Path) -> None:
    code, output = checked(folder, site=SITE.replace("{camera}/**/*.png", "{camera}_{date}.jpg"))
    assert code == 1
    assert "no camera has a capture: captures.pattern wants gate_" in output
    assert "there are gate/1.png, gate/22.png, roof/1.png" in output
    assert output.count("error:") == 1


def test_a_night_without_captures_is_told_the_nights_that_have_some(folder: Path) -> None:
    for day in (17, 18, 19):
        for camera in ("gate", "roof"):
            picture(folder / "captures" / camera / f"2026-11-{day}.png")
    (folder / "site.yaml").write_text(SITE.replace("/**/*", "/{date}") % ("", ""))
    result = CliRunner().invoke(main, ["check", str(folder), "--date", "2026-11-12"])
    assert result.exit_code == 1
    assert "there are 3 other nights with captures, the nearest 2026-11-17, 2026-11-18, 2026-11-19" in result.output
    assert "site.yaml --date 2026-11-17" in result.output


@pytest.mark.parametrize(
    ("kind", "message"), [("file", "is no folder"), ("link", "is no folder"), ("read-only", "cannot be written")]
)
def test_a_work_folder_that_a_run_cannot_use_is_found(
    folder: Path, kind: str, message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    work = folder / "elsewhere"
    if kind == "file":
        work.write_text("")
    elif kind == "link":
        work.symlink_to("nowhere")
    else:
        work.mkdir()
        # rights do not bind the superuser, as whom tests may run
        monkeypatch.setattr(os, "access", lambda path, mode: Path(path) != work)
    code, text = checked(folder, more="work: elsewhere")
    assert code == 1
    assert f"work: {work} {message}" in text


def test_a_frozen_camera_is_found(folder: Path) -> None:
    for day in (17, 18):
        for camera in ("gate", "roof"):
            picture(folder / "captures" / camera / f"2026-11-{day}.png")
    (folder / "captures/gate/2026-11-18.png").write_bytes((folder / "captures/gate/2026-11-17.png").read_bytes())
    code, output = checked(folder, site=SITE.replace("/**/*", "/{date}"))
    assert code == 3
    assert "camera gate: its captures are the same as those of 2026-11-17: the picture is frozen" in output
    assert output.count("error:") == 1


def test_captures_hours_apart_are_found(folder: Path) -> None:
    for name in ("2026-11-19_001000", "2026-11-19_233000"):
        picture(folder / "captures" / "gate" / f"{name}.png")
    picture(folder / "captures" / "roof" / "2026-11-19_233000.png")
    code, output = checked(folder, site=SITE.replace("/**/*", "/{date}_{time}"))
    assert code == 0 and "its captures of the night are 23 h apart, at 00:10 and 23:30" in output


def test_a_model_that_is_not_on_this_machine_is_found_by_check_and_run_before_any_work(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("WBFLOW_MODELS", str(folder / "models"))
    code, output = checked(folder, more="stages: {features: {detector: onnx, model: aliked-n32}}\n")
    assert code == 2
    assert "site.yaml:6:44: stages.features.model: aliked-n32 is not in" in output and "wbflow models get aliked-n32" in output
    result = CliRunner().invoke(main, ["run", str(folder), "-q"])
    assert result.exit_code == 2 and "wbflow models get aliked-n32" in result.output
    assert not (folder / ".wbflow").exists()


def test_a_folder_that_cannot_be_read_is_named_for_its_camera_and_once_for_all(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    captures = folder / "captures"
    (captures / "roof").rename(folder / "away")
    (captures / "roof").symlink_to("roof")
    code, output = checked(folder)
    output = " ".join(output.split())
    assert code == 3 and f"camera roof: folder {captures}/roof cannot be read: Too many levels of symbolic links" in output
    stat = os.stat

    def refusing(path: os.PathLike[str], **how: bool) -> os.stat_result:
        if str(path).startswith(f"{captures}/"):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), path)
        return stat(path, **how)

    monkeypatch.setattr(os, "stat", refusing)
    code, output = checked(folder)
    output = " ".join(output.split())
    assert code == 1 and output.count(f"folder {captures} cannot be read: Permission denied") == 1
    assert "camera roof" not in output


def test_a_folder_of_another_machine_is_to_be_mounted(folder: Path) -> None:
    code, output = checked(folder, site=SITE.replace("root: captures", "root: 'smb://nas/cams'"))
    assert code == 2 and "is a folder of another machine" in output and "mount it, and name the folder" in output


def test_what_libraries_print_about_a_file_is_not_among_the_findings(folder: Path, capfd: pytest.CaptureFixture[str]) -> None:
    jpeg = cv2.imencode(".jpg", np.random.default_rng(0).integers(0, 255, (48, 64, 3), dtype=np.uint8))[1].tobytes()
    scan = jpeg.index(b"\xff\xda")
    (folder / "captures/gate/1.png").write_bytes(jpeg[:scan] + bytes(40) + jpeg[scan:])
    code, output = checked(folder)
    assert code == 0, output
    assert "extraneous" not in output + "".join(capfd.readouterr())


def test_cameras_that_deliver_the_same_files_are_found(folder: Path) -> None:
    for name in ("1.png", "22.png"):
        (folder / "captures/roof" / name).write_bytes((folder / "captures/gate" / name).read_bytes())
    code, output = checked(folder)
    assert code == 3 and output.count("error:") == 1
    assert "gate, roof deliver the same picture: gate/1.png and roof/1.png are equal" in output
