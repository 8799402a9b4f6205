"""The diffs in stages/README.md that add to the project, applied to a copy of it and run there."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.helpers.toy_site import ToySite

ROOT = Path(__file__).resolve().parent.parent
GUIDE = (ROOT / "stages/README.md").read_text()
MATCHER, EXPORT, STAGE, FINDING, LENS = re.findall(r"^```diff\n(.*?)^```$", GUIDE, re.MULTILINE | re.DOTALL)


def files_of(diff: str) -> list[str]:
    return re.findall(r"^\+\+\+ b/(.*)$", diff, re.MULTILINE)


@dataclass
class CopiedSite(ToySite):
    """A toy site that is processed by a copy of the project in another folder."""

    tree: str = ""

    def env(self) -> dict[str, str]:
        env = super().env()
        return {**env, "PYTHONSAFEPATH": "1", "PYTHONPATH": os.pathsep.join([self.tree, env["PYTHONPATH"]])}


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """A copy of the project, which Python finds before the installed one."""
    folder = tmp_path / "project"
    for package in ("wbflow", "stages"):
        shutil.copytree(ROOT / package, folder / package, ignore=shutil.ignore_patterns("__pycache__"))
    (folder / "sites").mkdir()
    shutil.copy(ROOT / "sites" / "README.md", folder / "sites")
    (folder / "wbflow_stages").symlink_to("stages")
    return folder


def apply(diff: str, tree: Path) -> None:
    """Apply a diff with git, file by file, to a folder outside of any repository."""
    env = {**os.environ, "GIT_CEILING_DIRECTORIES": str(tree.parent)}
    for part in re.split(r"^(?=--- )", diff, flags=re.MULTILINE)[1:]:
        command = ["git", "apply", "--recount", "-"]
        done = subprocess.run(command, cwd=tree, env=env, input=part, capture_output=True, text=True, check=False)
        assert done.returncode == 0, f"a diff in stages/README.md no longer fits:\n{part}\n{done.stderr}"


def run_tests_of(tree: Path, diff: str) -> None:
    tests = [file for file in files_of(diff) if file.startswith("tests/")]
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--noconftest", "-c", os.devnull, *tests]
    done = subprocess.run(
        command, cwd=tree, env={**os.environ, "PYTHONPATH": str(tree)}, capture_output=True, text=True, check=False
    )
    assert tests and done.returncode == 0, done.stdout


def toy(tree: Path, **stages: object) -> CopiedSite:
    site = CopiedSite(tree.parent / "toy", ["gate", "roof", "mast"], tree=str(tree))
    change_stages(site, **stages)
    return site


def change_stages(site: CopiedSite, **stages: object) -> None:
    written = json.loads(site.file.read_text())
    site.file.write_text(json.dumps({**written, "stages": {**written["stages"], **stages}}))


def record(site: CopiedSite) -> dict[str, list[dict[str, object]]]:
    """The record of `wbflow run` in a process of the copied project."""
    done = site.wbflow("run", "--json", "--jobs", "1", "--backend", "threading")
    assert done.returncode in {0, 3}, done.stderr
    found: dict[str, list[dict[str, object]]] = json.loads(done.stdout)
    return found


def test_adding_a_matcher_touches_at_most_two_files(tree: Path) -> None:
    assert len(files_of(MATCHER)) <= 2
    apply(MATCHER, tree)
    site = toy(tree, matches={"matcher": "nearby", "radius_px": 500.0, "min_matches": 1})
    assert {pair["matches"] for pair in record(site)["pairs"]} == {1}
    change_stages(site, matches={"matcher": "nerby"})
    assert "mutual, kdtree, nearby, lightglue, onnx" in site.wbflow("check").stderr


def test_adding_an_export_touches_at_most_three_files(tree: Path) -> None:
    assert len(files_of(EXPORT)) <= 3
    apply(EXPORT, tree)
    run_tests_of(tree, EXPORT)
    site = toy(tree)
    record(site)
    assert "--xyz" in site.wbflow("export", "--help").stdout
    done = site.wbflow("export", "--xyz", "--out", str(site.folder / "out"))
    assert done.returncode == 0, done.stderr
    assert re.fullmatch(r"(-?\d+\.\d{4} -?\d+\.\d{4} -?\d+\.\d{4}\n)+", (site.folder / "out" / "cloud.xyz").read_text())


def test_adding_a_stage_touches_at_most_five_files(tree: Path) -> None:
    """The files of the diff, and stages/README.md, which gets a paragraph."""
    assert len(files_of(STAGE)) + 1 <= 5
    apply(STAGE, tree)
    run_tests_of(tree, STAGE)
    site = toy(tree, shadows={"darkest": 0.8})
    cameras = record(site)["cameras"]
    assert all(0 < float(str(camera["shadow"])) < 1 for camera in cameras)
    assert len(list((site.work / "cache" / "shadows").glob("*/*.json"))) == len(cameras)
    listed = subprocess.run(site.command("stages", "shadows"), env=site.env(), capture_output=True, text=True, check=True).stdout
    assert "darkest = 0.3" in listed
    change_stages(site, shadows=False)
    assert "shadows" not in site.wbflow("status").stdout


BLACK_NIGHT = """
import types
from wbflow.pipeline.summaries import CameraFigures
from wbflow.records.record import CameraRecord
from wbflow.verdict.pictures import check_pictures

cameras = [CameraRecord(name, "ok", figures=CameraFigures(black_share=share)) for name, share in (("gate", 0.1), ("roof", 0.7))]
record = types.SimpleNamespace(cameras=cameras, usual=None, pairs_of=lambda name: [])
print(*(f"{entry.kind} {entry}" for entry in check_pictures(record, None)))
"""

BLACK_PICTURE = """
import cv2
import numpy as np
from wbflow_stages.frames import clean_frame
from wbflow_stages.types import Capture, Lens

image = np.random.default_rng(1).integers(40, 200, (120, 160, 3)).astype(np.uint8)
image[:, :120] = 0
data = cv2.imencode(".png", image)[1].ravel()
print(clean_frame([Capture("1.png", data)], Lens(), None, denoise=False).black_share)
"""


def printed(tree: Path, program: str) -> str:
    """What a program prints that runs in the copy of the project."""
    env = {**os.environ, "PYTHONPATH": str(tree)}
    done = subprocess.run([sys.executable, "-c", program], cwd=tree, env=env, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_adding_a_finding_with_a_new_figure_touches_at_most_five_files(tree: Path) -> None:
    assert len(files_of(FINDING)) <= 5
    apply(FINDING, tree)
    assert float(printed(tree, BLACK_PICTURE)) == pytest.approx(0.75, abs=0.01)
    assert printed(tree, BLACK_NIGHT) == "pictures-black roof: most of the picture is black: roof"


def test_adding_a_lens_model_touches_at_most_three_files(tree: Path) -> None:
    assert len(files_of(LENS)) <= 3
    apply(LENS, tree)
    run_tests_of(tree, LENS)
    known = printed(tree, "from wbflow.site.calibration.calibrated import lens_fault; print(lens_fault('equisolid', [0.1]))")
    assert known == "a equisolid lens has 0 coefficients, not 1; give them in that order, or another model"
