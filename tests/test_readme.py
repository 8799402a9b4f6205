"""The examples in the guides work when they are typed as printed."""

from __future__ import annotations

import json
import re
import runpy
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from click.testing import CliRunner

import wbflow
from tests.helpers.synthetic_site import small_yard, straight_capture, write_straight
from wbflow.cli.main import main
from wbflow.errors import ExitCode

ROOT = Path(__file__).resolve().parent.parent


def blocks(guide: str, language: str) -> list[str]:
    """The fenced blocks of one language in a guide."""
    return re.findall(rf"^```{language}\n(.*?)^```$", (ROOT / guide).read_text(), re.MULTILINE | re.DOTALL)


def wbflow_output(*arguments: str | Path) -> str:
    """The output of a command, which has to succeed."""
    result = CliRunner().invoke(main, [str(argument) for argument in arguments])
    assert result.exit_code == 0, result.output
    return result.output


def run_night(*arguments: str | Path) -> None:
    """Run a night of four photographs, 320 pixels wide; the only finding has to be that they do not determine their lenses,
    which are 5 to 10 pixels off at the border."""
    result = CliRunner().invoke(main, ["run", *(str(argument) for argument in arguments), "--jobs", "1", "--json"])
    findings = [finding["kind"] for finding in json.loads(result.stdout)["verdict"]["findings"]]
    assert (result.exit_code, findings) == (ExitCode.DEGRADED, ["lens-undetermined"]), result.output


def work(folder: Path) -> Path:
    return folder / ".wbflow" / "yard"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the README's site file and four photographs about which nothing else is known, after a run."""
    (typed,) = blocks("README.md", "yaml")
    assert len(typed.splitlines()) == 9
    folder = tmp_path_factory.mktemp("photographs")
    (folder / "site.yaml").write_text(typed)
    for name, camera in zip(yaml.safe_load(typed)["cameras"], small_yard().cameras, strict=True):
        cv2.imwrite(str(folder / f"{name}.jpg"), camera.captures[0][..., ::-1])
    run_night(folder)
    return folder


def test_a_nine_line_site_file_and_four_photographs_make_a_cloud(folder: Path) -> None:
    run = wbflow.open_run(folder)
    assert len(run.cloud.points) > 20_000
    assert {camera.outcome for camera in run.cameras.values()} == {"ok"}


@pytest.mark.parametrize("layout", ["{}.jpg", "{}/1.jpg"])
def test_a_site_file_written_by_init_makes_a_cloud(folder: Path, tmp_path: Path, layout: str) -> None:
    for photograph in folder.glob("*.jpg"):
        place = tmp_path / layout.format(photograph.stem)
        place.parent.mkdir(exist_ok=True)
        place.write_bytes(photograph.read_bytes())
    wbflow_output("init", tmp_path)
    written = (tmp_path / "site.yaml").read_text()
    (tmp_path / "site.yaml").write_text(re.sub(r"^site: .*", "site: yard", written, flags=re.MULTILINE))
    run_night(tmp_path, "--work", work(folder))  # equal results come from the cache
    run = wbflow.open_run(wbflow.load_site(tmp_path, work(folder)))
    assert len(run.cloud.points) > 20_000


def test_the_python_example_of_the_readme_works(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (typed,) = blocks("README.md", "python")
    (folder / "typed.py").write_text(typed.replace("jobs=2", "jobs=1"))
    monkeypatch.chdir(folder)
    names = runpy.run_path("typed.py")
    assert names["F"].shape == (3, 3)
    assert "gate--roof ok" in capsys.readouterr().out


def test_the_user_matcher_of_the_guide_works_beside_the_site_file(folder: Path) -> None:
    *_, typed = blocks("stages/README.md", "python")
    named, *_ = blocks("stages/README.md", "yaml")  # the others are about networks
    (folder / "orb.py").write_text(typed)
    site = folder / "orb.yaml"
    site.write_text((folder / "site.yaml").read_text() + named)
    wbflow_output("check", site)
    wbflow_output("run", site, "--jobs", "1", "--until", "geometry")
    run = wbflow.open_run(site)
    found = [pair for pair in run.pairs.values() if pair.outcome == "ok"]
    assert len(found) >= 3, "neighbours have a geometry"
    matches = run.artifact(f"matches {found[0].name}")
    assert matches.matcher == "orb:match_orb"
    assert matches.i1 is None, "points that are no keypoints"


def test_the_guide_computes_disparity_from_two_photographs_in_ten_lines(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    typed, *_ = blocks("stages/README.md", "python")
    assert len(typed.splitlines()) <= 10
    for name, camera in zip(("one", "two"), small_yard().cameras, strict=False):
        write_straight(tmp_path / f"{name}.jpg", camera)
    (tmp_path / "typed.py").write_text(typed)
    monkeypatch.chdir(tmp_path)
    names = runpy.run_path("typed.py")
    assert names["disparity"].density > 0.2
    assert "of the left view has a disparity" in capsys.readouterr().out


def test_the_guide_makes_a_cloud_and_pictures_of_several_views_in_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    _, typed, _ = blocks("stages/README.md", "python")
    views = dict(zip(("gate", "roof", "mast", "crane"), small_yard().cameras, strict=True))
    images: dict[str, Any] = {name: straight_capture(camera) for name, camera in views.items()}
    intrinsics: dict[str, Any] = {name: camera.lens.K for name, camera in views.items()}
    np.savez(tmp_path / "images.npz", **images)
    np.savez(tmp_path / "K.npz", **intrinsics)
    (tmp_path / "typed.py").write_text(typed)
    monkeypatch.chdir(tmp_path)
    names = runpy.run_path("typed.py")
    assert len(names["cloud"].points) > 50_000
    assert "points from 4 views" in capsys.readouterr().out
    assert {"depth-gate.jpg", "matches-gate-roof.jpg"} <= {
        picture.name for picture in tmp_path.glob("*.jpg") if cv2.imread(str(picture)) is not None
    }


@pytest.mark.parametrize("guide", ["README.md", "wbflow/README.md", "stages/README.md", "scripts/README.md", "sites/README.md"])
def test_links_and_paths_in_the_guides_exist(guide: str) -> None:
    text = (ROOT / guide).read_text()
    links = re.findall(r"\]\((?!http)([^)#]+)\)", text)
    assert not [link for link in links if not (ROOT / guide).parent.joinpath(link).exists()]
    assert not [
        name for name in re.findall(r"`((?:wbflow|stages|scripts|tests|sites)/[\w./-]+)`", text) if not (ROOT / name).exists()
    ]


def test_the_readme_is_short() -> None:
    assert len((ROOT / "README.md").read_text().splitlines()) < 150


def test_the_readme_lists_every_command() -> None:
    listed = set(re.findall(r"^\| `wbflow ([\w-]+)", (ROOT / "README.md").read_text(), re.MULTILINE))
    assert listed == set(main.commands)
