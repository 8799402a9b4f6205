"""`wbflow init` turns a folder of photographs into a site."""

from __future__ import annotations

import errno
import json
import os
import re
import shlex
from pathlib import Path

import cv2
import numpy as np
import pytest
from click.testing import CliRunner, Result

from tests.helpers.images import with_exif
from wbflow.cache.memo import Digests
from wbflow.cli.main import main
from wbflow.site.captures import find_captures, night
from wbflow.site.load import load_site


def photograph(path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    # cameras that deliver the same picture would be a fault
    of_camera = f"{path.parent.name}/{path.name}"
    tiles = np.random.default_rng(list(of_camera.encode())).integers(0, 255, (10, 13, 3)).astype(np.uint8)
    suffix = path.suffix.lower()
    path.write_bytes(cv2.imencode(suffix, tiles.repeat(5, axis=0).repeat(5, axis=1)[:48, :64])[1].tobytes())


def init(folder: Path) -> Result:
    return CliRunner().invoke(main, ["init", str(folder)])


def captured(folder: Path) -> dict[str, list[str]]:
    """Names of each camera's captures, as a run would find them."""
    site = load_site(folder)
    found = find_captures(site, night(site, None), Digests(None))
    return {camera: [file.name for file in files] for camera, files in found.items()}


LAYOUTS = {
    "one photograph each": (
        ["gate.jpg", "roof.jpg", "0003.jpg"],
        {"0003": ["0003.jpg"], "gate": ["gate.jpg"], "roof": ["roof.jpg"]},
    ),
    "any suffix and case": (
        ["gate.JPG", "roof.png", "mast.Tif"],
        {"gate": ["gate.JPG"], "mast": ["mast.Tif"], "roof": ["roof.png"]},
    ),
    "names that are no ids": (
        ["Tor links (1).jpg", "Tor rechts.jpg"],
        {"Tor-links-1": ["Tor links (1).jpg"], "Tor-rechts": ["Tor rechts.jpg"]},
    ),
    "the same name twice": (["gate.jpg", "gate.png"], {"gate": ["gate.jpg"], "gate-2": ["gate.png"]}),
    "names in other scripts": (
        ["Tor süd/1.jpg", "Ещё/1.jpg", "北門/1.jpg", "بوابة/1.jpg", "Straße №3/1.jpg", "!!/1.jpg"],
        {
            "Tor-sud": ["Tor süd/1.jpg"],
            "Eshche": ["Ещё/1.jpg"],
            "BeiMen": ["北門/1.jpg"],
            "bwbh": ["بوابة/1.jpg"],
            "Strasse-No3": ["Straße №3/1.jpg"],
            "u21-u21": ["!!/1.jpg"],
        },
    ),
    "a NAS": (
        ["gate/1.jpg", "gate/@eaDir/1.jpg/SYNOPHOTO_THUMB_S.jpg", "@eaDir/thumb.jpg", "#recycle/old.jpg", "roof/1.jpg"],
        {"gate": ["gate/1.jpg"], "roof": ["roof/1.jpg"]},
    ),
    "thumbnails of other systems": (
        [
            "gate.jpg",
            "._gate.jpg",
            "roof.jpg",
            ".stversions/roof.jpg",
            "$RECYCLE.BIN/a.jpg",
            "@Recycle/b.jpg",
            "lost+found/c.jpg",
        ],
        {"gate": ["gate.jpg"], "roof": ["roof.jpg"]},
    ),
    "one suffix in two cases": (
        ["gate/1.jpg", "gate/2.JPG", "roof/1.JPG"],
        {"gate": ["gate/1.jpg", "gate/2.JPG"], "roof": ["roof/1.JPG"]},
    ),
    "one folder each": (
        ["gate/1.jpg", "gate/2.jpg", "roof/1.jpg", "notes.txt"],
        {"gate": ["gate/1.jpg", "gate/2.jpg"], "roof": ["roof/1.jpg"]},
    ),
    "folders of several kinds": (
        ["gate/1.jpg", "gate/2.JPEG", "old roof/1.png"],
        {"gate": ["gate/1.jpg", "gate/2.JPEG"], "old-roof": ["old roof/1.png"]},
    ),
}


@pytest.mark.parametrize(("files", "found"), LAYOUTS.values(), ids=LAYOUTS)
def test_the_site_file_is_accepted_and_finds_each_photograph(
    tmp_path: Path, files: list[str], found: dict[str, list[str]]
) -> None:
    for name in files:
        if name.endswith(".txt"):
            (tmp_path / name).write_text("of the day")
        else:
            photograph(tmp_path / name)
    result = init(tmp_path)
    assert result.exit_code == 0, result.output
    assert f"wbflow run {tmp_path / 'site.yaml'}" in result.output
    assert captured(tmp_path) == found
    assert "camera-" not in result.output
    checked = CliRunner().invoke(main, ["check", str(tmp_path)])
    assert checked.exit_code == 0, checked.output
    assert f"{len(found)} cameras" in checked.output
    assert len((tmp_path / "site.yaml").read_text().splitlines()) <= 9 + len(found)


def test_the_lines_of_a_site_file_with_many_cameras_are_short(tmp_path: Path) -> None:
    for number in range(30):
        photograph(tmp_path / f"camera-of-the-yard-{number:02d}.jpg")
    assert init(tmp_path).exit_code == 0
    assert len(captured(tmp_path)) == 30
    assert max(map(len, (tmp_path / "site.yaml").read_text().splitlines())) < 120


def test_a_site_keeps_the_name_of_its_folder_in_any_script(tmp_path: Path) -> None:
    for name in ("gate.jpg", "roof.jpg"):
        photograph(tmp_path / "Häfen & Märkte" / name)
    assert init(tmp_path / "Häfen & Märkte").exit_code == 0
    assert load_site(tmp_path / "Häfen & Märkte").name == "Hafen-Markte"


def test_a_site_file_is_never_overwritten(tmp_path: Path) -> None:
    for name in ("gate.jpg", "roof.jpg"):
        photograph(tmp_path / name)
    (tmp_path / "site.yaml").write_text("mine")
    result = init(tmp_path)
    assert result.exit_code == 2
    assert "is there already" in result.output
    assert (tmp_path / "site.yaml").read_text() == "mine"


@pytest.mark.parametrize(
    ("files", "message"),
    [
        ([], "holds no photographs"),
        (["gate.jpg"], "holds one camera only (gate)"),
        (["gate.jpg", "roof/1.jpg"], "keep one kind"),
        (["gate/2026-W47/1.jpg", "roof/2026-W47/1.jpg"], "within its folders"),
    ],
)
def test_unsuitable_folders_are_refused_and_nothing_is_written(tmp_path: Path, files: list[str], message: str) -> None:
    for name in files:
        photograph(tmp_path / name)
    result = init(tmp_path)
    assert result.exit_code == 2
    assert message in result.output
    assert not (tmp_path / "site.yaml").exists()


def test_a_missing_folder_is_refused(tmp_path: Path) -> None:
    result = init(tmp_path / "nowhere")
    assert result.exit_code == 2
    assert "there is no such folder" in result.output


def test_help_shows_both_layouts() -> None:
    text = CliRunner().invoke(main, ["init", "--help"]).output
    assert "photographs/gate.jpg" in text
    assert "photographs/gate/1.jpg" in text


def test_old_photographs_are_accepted_unless_one_is_of_another_date(tmp_path: Path) -> None:
    for number in range(10):
        photograph(file := tmp_path / f"castle-{number}.jpg")
        file.write_bytes(with_exif(file.read_bytes(), f"2010:10:12 14:{number:02d}:00"))
    assert init(tmp_path).exit_code == 0
    command = ["run", str(tmp_path), "--until", "frames", "--jobs", "1", "--backend", "threading"]
    result = CliRunner().invoke(main, [*command, "--json"])
    assert result.exit_code == 0, result.output
    record = json.loads(result.stdout)
    assert record["date"] == "2010-10-12"
    assert (record["verdict"]["level"], record["verdict"]["findings"]) == ("good", [])
    photograph(file)
    file.write_bytes(with_exif(file.read_bytes(), "2024:03:05 14:00:00"))
    result = CliRunner().invoke(main, command)
    assert result.exit_code == 3 and "castle-9" in result.output and "taken on 2024-03-05" in result.output
    assert "cloud" not in result.output, "none was asked for"


def test_photographs_on_a_disk_that_cannot_be_written_have_their_site_file_elsewhere(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "recorder's disk"
    for name in ("gate", "roof"):
        photograph(folder / f"{name}.jpg")
    mkdir = Path.mkdir

    def refusing(path: Path, mode: int = 0o777, parents: bool = False, exist_ok: bool = False) -> None:
        if path == folder:
            raise OSError(errno.EROFS, os.strerror(errno.EROFS), str(path))
        mkdir(path, mode, parents, exist_ok)

    monkeypatch.setattr(Path, "mkdir", refusing)
    result = init(folder)
    assert result.exit_code == 2
    assert f"{folder} cannot be written: Read-only file system" in result.output
    (command,) = re.findall("(wbflow init .*) DIR", result.output)
    arguments = shlex.split(command)[1:]
    result = CliRunner().invoke(main, [*arguments, str(tmp_path / "harbour")])
    assert result.exit_code == 0, result.output
    assert captured(tmp_path / "harbour") == {"gate": ["gate.jpg"], "roof": ["roof.jpg"]}
    assert load_site(tmp_path / "harbour").work_folder.root == tmp_path / "harbour/.wbflow/harbour"


def test_a_folder_of_photographs_that_cannot_be_read_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refusing(path: Path) -> None:
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))

    monkeypatch.setattr(Path, "iterdir", refusing)
    result = init(tmp_path)
    assert result.exit_code == 2
    assert f"{tmp_path} cannot be read: Permission denied" in result.output and "the right to read it" in result.output
