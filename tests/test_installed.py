"""What users install: types of the samples in the guides, in an environment of its own."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import sysconfig
import venv
from importlib.metadata import version
from pathlib import Path

import pytest

from tests.test_readme import blocks

ROOT = Path(__file__).resolve().parent.parent
SAMPLES = {
    "readme.py": blocks("README.md", "python")[0],
    **{f"guide_{number}.py": block for number, block in enumerate(blocks("stages/README.md", "python"))},
}
"""The programs in the guides, by file name."""


@pytest.fixture
def project(tmp_path: Path) -> Path:
    """A copy of the project: building it leaves files in its folder."""
    copy = tmp_path / "project"
    for folder in ("wbflow", "stages", "sites", "scripts/packages"):
        shutil.copytree(ROOT / folder, copy / folder, symlinks=True, ignore=shutil.ignore_patterns("__pycache__"))
    for file in ("pyproject.toml", "README.md"):
        shutil.copy(ROOT / file, copy)
    return copy


@pytest.fixture
def python(tmp_path: Path) -> Path:
    """The interpreter of a new environment, which borrows the libraries of this one, but not the project."""
    venv.create(tmp_path / "env", with_pip=False)
    python = tmp_path / "env" / "bin" / "python"
    asked = [str(python), "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"]
    packages = subprocess.run(asked, capture_output=True, text=True, check=True).stdout.strip()
    Path(packages, "libraries.pth").write_text(f"{sysconfig.get_path('purelib')}\n")
    return python


@pytest.mark.skipif(int(version("setuptools").split(".")[0]) < 71, reason="this setuptools cannot build wheels alone")
@pytest.mark.parametrize("how", [[], ["--editable"]], ids=["installed", "editable"])
def test_the_samples_of_the_guides_pass_mypy_strict(how: list[str], project: Path, python: Path, tmp_path: Path) -> None:
    pip = [sys.executable, "-m", "pip", "--python", str(python), "install", "--quiet", "--no-deps", "--no-build-isolation"]
    subprocess.run([*pip, *how, str(project)], check=True)
    for name, text in SAMPLES.items():
        (tmp_path / name).write_text(text)
    mypy = [sys.executable, "-m", "mypy", "--strict", "--config-file=", "--python-executable", str(python)]
    environment = {name: value for name, value in os.environ.items() if name not in {"PYTHONPATH", "MYPYPATH"}}
    done = subprocess.run([*mypy, *SAMPLES], cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
