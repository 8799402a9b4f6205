"""Whatever is in the place of a file from outside (a pipe, device, huge file or link loop) is read or reported at once."""

from __future__ import annotations

import glob
import os
from pathlib import Path

import pytest

from tests.helpers.toy_site import ToySite
from wbflow.cache.untrusted import Unreadable, find_untrusted, read_untrusted
from wbflow.words import printable


def test_files_and_links_to_files_are_read_whole(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"abc")
    (tmp_path / "link").symlink_to("a")
    assert read_untrusted(tmp_path / "a") == read_untrusted(tmp_path / "link") == b"abc"


def test_pipes_devices_folders_and_link_loops_are_refused_at_once(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "device").symlink_to("/dev/zero")
    (tmp_path / "loop").symlink_to("loop")
    for name, message in (
        ("pipe", "is a pipe"),
        ("device", "is a device"),
        (".", "is a folder"),
        ("loop", "links"),
        ("gone", "No such"),
    ):
        with pytest.raises(Unreadable, match=message):
            read_untrusted(tmp_path / name)


def test_a_file_that_is_too_large_is_not_read(tmp_path: Path) -> None:
    (tmp_path / "sparse").touch()
    os.truncate(tmp_path / "sparse", 20_000_000_000)
    with pytest.raises(Unreadable, match="20,000,000,000 bytes, 1,000,000,000 are the most"):
        read_untrusted(tmp_path / "sparse")


@pytest.mark.parametrize(
    "pattern", ["*.jpg", "**/*.jpg", "*/*.jpg", "**/b/**/[ef].jpg", "a/b/e.jpg", "**", "x/*.jpg", "a/?/*", ".*/*"]
)
def test_a_search_finds_what_glob_finds(tmp_path: Path, pattern: str) -> None:
    for name in ("c.jpg", "a/d.jpg", "a/b/e.jpg", "a/b/c/f.jpg", ".hidden/g.jpg", "a/.h.jpg", "b/b/e.jpg"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    known = {Path(name) for name in glob.glob(str(tmp_path / pattern), recursive=True)}
    assert set(map(Path, find_untrusted(str(tmp_path / pattern)))) == known


def test_files_are_found_once_despite_links_to_parent_folders(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "x.jpg").touch()
    for name in ("here", "again", "a/up"):
        (tmp_path / name).symlink_to(tmp_path)
    assert list(find_untrusted(f"{tmp_path}/**/*.jpg")) == [f"{tmp_path}/a/x.jpg"]


def test_text_from_outside_is_made_printable() -> None:
    assert printable("gate\x1b[2J\r\x07") == r"gate\x1b[2J\x0d\x07"
    assert printable(os.fsdecode(b"caf\xe9.jpg")) == r"caf\xe9.jpg"
    assert printable("Gästehaus, 北門\n\tzwei") == "Gästehaus, 北門\n\tzwei"
    assert printable("‮gpj.exe") == r"\u202egpj.exe"
    cut = printable("x" * 5_000_000)
    assert len(cut) < 600 and "(5,000,000 characters)" in cut


def test_a_file_name_that_is_not_valid_text_harms_neither_run_nor_report(toy: ToySite) -> None:
    toy.capture("roof").write_text("broken")
    toy.capture("roof").rename(toy.folder / "captures" / os.fsdecode(b"roof\xe9\x1b[2J.txt"))
    toy.file.write_text(toy.file.read_text().replace("{camera}.txt", "{camera}*.txt"))
    result = toy.wbflow("run", "--jobs", "1")
    assert "Traceback" not in result.stderr and "itself failed" not in result.stderr
    assert result.returncode == 3
    assert "\x1b" not in result.stdout + result.stderr and r"roof\xe9\x1b[2J.txt is not an image" in result.stderr
    newest = max((toy.work / "runs").glob("2*"))
    assert r"roof\xe9\x1b[2J.txt" in (newest / "report.html").read_text()


def test_an_unreadable_mask_costs_only_its_camera(toy: ToySite) -> None:
    (toy.folder / "mask.png").touch()
    os.truncate(toy.folder / "mask.png", 20_000_000_000)
    toy.file.write_text(toy.file.read_text().replace('"roof"', '{"id": "roof", "mask": "mask.png"}', 1))
    cameras = {camera["id"]: camera for camera in toy.run("--until", "features", code=3)["cameras"]}
    assert "mask mask.png has 20,000,000,000 bytes" in cameras["roof"]["reason"]
    assert [cameras[name]["outcome"] for name in ("gate", "mast-1", "crane")] == ["ok"] * 3


def test_devices_folders_huge_files_and_link_loops_cost_only_their_cameras(toy: ToySite) -> None:
    for name in ("roof", "mast-1", "crane"):
        toy.capture(name).unlink()
    toy.capture("roof").symlink_to("/dev/zero")
    toy.capture("mast-1").touch()
    os.truncate(toy.capture("mast-1"), 20_000_000_000)
    toy.capture("crane").mkdir()
    for name in ("here", "again"):
        (toy.folder / "captures" / name).symlink_to(".")
    toy.file.write_text(toy.file.read_text().replace("{camera}.txt", "**/{camera}.txt"))
    cameras = {camera["id"]: camera for camera in toy.run("--until", "features", code=3)["cameras"]}
    assert cameras["gate"]["outcome"] == "ok"
    assert cameras["roof"]["reason"].endswith("roof.txt is a device, not a file")
    assert "mast-1.txt has 20,000,000,000 bytes" in cameras["mast-1"]["reason"]
    assert cameras["crane"]["outcome"] == "failed"


def test_a_pipe_in_place_of_a_capture_costs_only_its_camera(toy: ToySite) -> None:
    toy.capture("roof").unlink()
    os.mkfifo(toy.capture("roof"))
    cameras = {camera["id"]: camera for camera in toy.run("--until", "features", code=3)["cameras"]}
    assert cameras["roof"]["reason"].endswith("roof.txt is a pipe, not a file")
