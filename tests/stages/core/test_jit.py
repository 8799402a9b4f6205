"""Compiled loops keep holes as holes, and work where nothing can be written."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import wbflow_stages
from wbflow_stages.core.jit import kernel
from wbflow_stages.types import Float64s


@kernel
def _holes(values: Float64s) -> int:
    count = 0
    for value in values:
        if np.isnan(value) or np.isinf(1.0 / value):
            count += 1
    return count


def test_nan_and_division_by_zero_mean_what_they_mean_in_numpy() -> None:
    assert _holes(np.array([1.0, np.nan, 0.0])) == 2


UNPRIVILEGED = """
import ctypes, os
if os.geteuid() == 0:  # root may write anywhere, as long as it has the capabilities to
    assert ctypes.CDLL(None).capset((ctypes.c_uint32 * 2)(0x20080522, 0), (ctypes.c_uint32 * 6)()) == 0
"""


@pytest.mark.skipif(os.geteuid() == 0 and sys.platform != "linux", reason="root cannot be kept from writing")
def test_a_read_only_installation_without_a_home_works(tmp_path: Path) -> None:
    folder = tmp_path / "installed"
    package = folder / "wbflow_stages"
    shutil.copytree(Path(wbflow_stages.__file__).parent, package, ignore=shutil.ignore_patterns("__pycache__"))
    code = UNPRIVILEGED + (
        f"import sys; sys.path.insert(0, {str(folder)!r})\n"
        "from wbflow_stages.core.jit import kernel; import wbflow_stages.stereo.consistency; print(wbflow_stages.__file__)\n"
        f"open({str(package / 'core' / 'new')!r}, 'w')"
    )
    environment = {"PATH": os.environ["PATH"], "HOME": str(folder / "home"), "PYTHONDONTWRITEBYTECODE": "1"}
    folders = [folder, *(path for path in folder.rglob("*") if path.is_dir())]
    for path in folders:
        path.chmod(0o555)
    try:
        result = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False)
    finally:
        for path in folders:
            path.chmod(0o755)
    assert str(folder) in result.stdout, result.stderr
    assert "PermissionError" in result.stderr, "nothing can be written there"
