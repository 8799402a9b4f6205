"""Compiled loops keep holes as holes, and work where nothing can be written."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest

import wbflow_stages
from wbflow_stages.core.jit import kernel


@kernel
def _holes(values: np.ndarray) -> int:
    count = 0
    for value in values:
        if np.isnan(value) or np.isinf(1.0 / value):
            count += 1
    return count


def test_nan_and_division_by_zero_mean_what_they_mean_in_numpy() -> None:
    assert _holes(np.array([1.0, np.nan, 0.0])) == 2


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can become nobody")
def test_a_read_only_installation_without_a_home_works() -> None:
    with tempfile.TemporaryDirectory() as folder:
        _check_read_only(Path(folder))


def _check_read_only(folder: Path) -> None:
    package = folder / "wbflow_stages"
    shutil.copytree(Path(wbflow_stages.__file__).parent, package, ignore=shutil.ignore_patterns("__pycache__"))
    folder.chmod(0o755)
    code = (
        f"import sys, os; sys.path.insert(0, {str(folder)!r}); import numpy, numba\n"
        "os.setuid(65534); os.environ['HOME'] = '/nonexistent'\n"
        "from wbflow_stages.core.jit import kernel; import wbflow_stages.stereo.consistency; print(wbflow_stages.__file__)"
    )
    environment = {"PATH": os.environ["PATH"], "HOME": "/nonexistent", "PYTHONDONTWRITEBYTECODE": "1"}
    result = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    assert str(folder) in result.stdout
