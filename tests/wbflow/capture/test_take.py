"""`wbflow capture` with camera servers on this machine."""

from __future__ import annotations

import base64
import datetime
import re
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote

import cv2
import pytest
import yaml
from click.testing import CliRunner, Result

import wbflow
from tests.helpers.camera_servers import PASSWORD, USER, http_camera, picture, rtsp_camera, writing_into
from wbflow.capture import take as taking
from wbflow.capture.server import Access, Shot
from wbflow.capture.shots import shots
from wbflow.cli.main import main
from wbflow.errors import ExitCode
from wbflow.site.pattern import Pattern


@pytest.fixture(autouse=True)
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(taking, "_BETWEEN_TRIES", 0.1)
    monkeypatch.delenv(taking.CREDENTIALS, raising=False)


@pytest.fixture
def http() -> Iterator[str]:
    with http_camera() as url:
        yield url


@pytest.fixture
def rtsp() -> Iterator[str]:
    with rtsp_camera() as url:
        yield url


def site_file(folder: Path, urls: dict[str, str], pattern: str = "{camera}/{date}_*.jpg", **keys: object) -> Path:
    settings = {"root": "captures", "pattern": pattern, "frames": 2, "seconds": 1.2, "credentials": "secret.yaml", **keys}
    cameras = [{"id": name, "url": url} for name, url in urls.items()]
    (folder / "captures").mkdir(exist_ok=True)
    (folder / "site.yaml").write_text(yaml.safe_dump({"site": "yard", "captures": settings, "cameras": cameras}))
    (folder / "secret.yaml").write_text(yaml.safe_dump({"*": {"user": USER, "password": PASSWORD}}))
    return folder / "site.yaml"


def capture(folder: Path, urls: dict[str, str], pattern: str = "{camera}/{date}_*.jpg", **keys: object) -> Result:
    return CliRunner().invoke(main, ["capture", str(site_file(folder, urls, pattern, **keys))])


def taken(folder: Path, camera: str) -> list[Path]:
    return sorted((folder / "captures" / camera).glob("*.jpg"))


def test_cameras_of_all_kinds_are_captured_at_once(tmp_path: Path, http: str, rtsp: str) -> None:
    (tmp_path / "ftp").mkdir()
    urls = {"gate": rtsp, "roof": rtsp, "mast": f"{http}/digest", "crane": f"{http}/mjpeg", "quay": f"file://{tmp_path}/ftp"}
    begun = time.time()
    with writing_into(tmp_path / "ftp", picture):
        result = capture(tmp_path, urls)
    assert result.exit_code == 0, result.output
    for camera in urls:
        files = taken(tmp_path, camera)
        assert len(files) == 2
        assert all(cv2.imread(str(file)) is not None and begun - 1 < file.stat().st_mtime < time.time() + 1 for file in files)
        assert "2 of 2 pictures" in next(line for line in result.output.splitlines() if line.startswith(camera))
    secret = [p for p in tmp_path.rglob("*") if p.is_file() and p.name != "secret.yaml" and PASSWORD.encode() in p.read_bytes()]
    assert not secret
    assert PASSWORD not in result.output


@pytest.mark.parametrize(
    ("way", "words"),
    [
        ("hang", "does not answer within"),
        ("half", "an incomplete picture"),
        ("text", "something else than a picture"),
        ("missing-login", "401"),
        ("down", "cannot be reached"),
    ],
)
def test_a_broken_camera_is_named_and_the_others_are_captured(
    tmp_path: Path, http: str, monkeypatch: pytest.MonkeyPatch, way: str, words: str
) -> None:
    def ask_impatiently(url: str, access: Access, moments: Sequence[float], patience: float) -> Iterator[Shot]:
        # only of the camera that never answers: the others have all the time that a busy machine takes
        return shots(url, access, moments, 0.3 if url.endswith("/hang") else patience)

    monkeypatch.setattr(taking, "shots", ask_impatiently)
    broken = {"missing-login": f"{http}/basic", "down": "http://127.0.0.1:9/snapshot"}.get(way, f"{http}/{way}")
    keys: dict[str, Any] = {"credentials": None} if way == "missing-login" else {}
    result = capture(tmp_path, {"gate": f"{http}/snapshot", "roof": broken}, **keys)
    assert result.exit_code == 3
    assert len(taken(tmp_path, "gate")) == 2
    assert not taken(tmp_path, "roof")
    assert words in next(line for line in result.output.splitlines() if line.startswith("roof"))


def test_a_run_with_capture_names_a_broken_camera_and_reveals_no_password(tmp_path: Path, http: str, rtsp: str) -> None:
    site, outside = tmp_path / "yard", tmp_path / "secret.yaml"
    site.mkdir()
    urls = {"gate": rtsp, "roof": f"{http}/digest", "mast": f"{http}/mjpeg", "crane": f"{http}/half"}
    file = site_file(site, urls, credentials=str(outside))
    (site / "secret.yaml").rename(outside)
    result = CliRunner().invoke(main, ["run", str(file), "--capture", "-q", "--until", "frames", "--backend", "threading"])
    assert result.exit_code == ExitCode.DEGRADED, result.output
    record = wbflow.open_run(site).record
    assert record.verdict
    lost = [finding for finding in record.verdict.findings if finding.kind == "camera-lost"]
    assert [finding.subject for finding in lost] == [("crane",)]
    assert "sent an incomplete picture" in lost[0].text
    assert sum(bool(camera.captures) for camera in record.cameras) == 3
    secrets = [PASSWORD.encode(), quote(PASSWORD).encode(), base64.b64encode(f"{USER}:{PASSWORD}".encode())]
    files = [path for path in site.rglob("*") if path.is_file()]
    assert len(files) > 10
    assert not [path for path in files if any(secret in path.read_bytes() for secret in secrets)]


def test_a_stream_that_needs_a_password_fails_without_credentials(tmp_path: Path, rtsp: str) -> None:
    result = capture(tmp_path, {"gate": rtsp}, credentials=None)
    assert result.exit_code == 1
    assert "cannot be opened" in result.output


@pytest.mark.parametrize("kind", ["http", "rtsp"])
def test_the_clock_of_a_camera_is_used_only_if_it_is_nearly_right(tmp_path: Path, kind: str) -> None:
    serve, path = (http_camera, "/snapshot") if kind == "http" else (rtsp_camera, "")
    for ahead, words in ((20.0, "by the camera"), (7200.0, r"by this machine, its clock is (1:59|2:00):\d\d ahead")):
        folder = tmp_path / str(ahead)
        folder.mkdir()
        with serve(ahead) as url:
            result = capture(folder, {"gate": f"{url}{path}"}, frames=1)
        assert re.search(words, result.output)
        (file,) = taken(folder, "gate")
        expected = ahead if ahead < 60 else 0.0
        assert file.stat().st_mtime == pytest.approx(time.time() + expected, abs=8)


@pytest.mark.parametrize(
    ("pattern", "name"),
    [
        ("{camera}/{date}_{time}*.jpg", "gate/2026-11-10_030405.jpg"),
        ("{camera}-{date:%Y%m%d}*.jpg", "gate-20261110030405.jpg"),
        ("**/{date:%Y}/{camera}.jpg", "2026/gate.jpg"),
    ],
)
def test_new_captures_get_names_that_a_run_finds(pattern: str, name: str, tmp_path: Path) -> None:
    named, moment = Pattern(tmp_path, pattern), datetime.datetime(2026, 11, 10, 3, 4, 5)
    path = named.name("gate", moment)
    assert path == tmp_path / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.touch()
    assert named.files("gate", moment.date()) == [path]


def test_pictures_that_come_within_one_second_do_not_overwrite_each_other(
    tmp_path: Path, http: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    # a camera that is late with its first picture: both are sent, and dated, within one second
    late = [(picture(100), None), (picture(200), None)]
    monkeypatch.setattr(taking, "shots", lambda *asked: iter(late))
    monkeypatch.setattr(time, "time", lambda: 1_795_000_000.25)
    result = capture(tmp_path, {"gate": f"{http}/snapshot"}, "{camera}/{date}_{time}.jpg")
    assert result.exit_code == 0 and "2 of 2 pictures" in result.output
    assert [file.read_bytes() for file in taken(tmp_path, "gate")] == [late[0][0], late[1][0]]


def test_a_pattern_that_gives_several_pictures_one_name_is_refused(tmp_path: Path, http: str) -> None:
    result = capture(tmp_path, {"gate": f"{http}/snapshot"}, "{camera}/{date}.jpg")
    assert result.exit_code == 2
    assert "2 pictures would have 1 name" in result.output


def test_a_pattern_with_single_character_wildcards_is_refused(tmp_path: Path, http: str) -> None:
    result = capture(tmp_path, {"gate": f"{http}/snapshot"}, "{camera}/{date}_?.jpg")
    assert result.exit_code == 2
    assert "? or [" in result.output


def test_a_password_in_the_site_file_is_refused(tmp_path: Path) -> None:
    result = capture(tmp_path, {"gate": f"http://{USER}:secret@camera/snapshot"})
    assert result.exit_code == 2
    assert "captures.credentials" in result.output


def test_a_faulty_credentials_file_is_named_without_its_content(tmp_path: Path, http: str) -> None:
    capture(tmp_path, {"gate": f"{http}/snapshot"})
    (tmp_path / "secret.yaml").write_text("gate: swordfish")
    result = CliRunner().invoke(main, ["capture", str(tmp_path / "site.yaml")])
    assert result.exit_code == 2
    assert "secret.yaml" in result.output
    assert "swordfish" not in result.output
