"""The systemd units that `wbflow init --systemd` writes, and the container."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

from tests.helpers.toy_site import ToySite


def test_the_systemd_units_run_the_site_and_are_valid(toy: ToySite) -> None:
    done = toy.wbflow("init", "--systemd")
    assert done.returncode == 0, done.stderr
    service, timer = (toy.folder / f"wbflow-toy.{kind}" for kind in ("service", "timer"))
    assert f'run "{toy.file}" -q --stop-at' in service.read_text()
    assert "Persistent=true" in timer.read_text()
    if shutil.which("systemd-analyze") is None:
        pytest.skip("systemd is not installed here")
    checked = subprocess.run(["systemd-analyze", "verify", str(service), str(timer)], capture_output=True, text=True, check=False)
    mine = [line for line in checked.stderr.splitlines() if "wbflow-toy" in line]
    assert not mine, checked.stderr


def test_the_container_is_not_root_and_runs_a_demo_when_it_is_built() -> None:
    lines = (Path(__file__).parents[3] / "scripts/container/Containerfile").read_text().splitlines()
    assert "USER wbflow" in lines
    assert any(line.startswith("RUN wbflow demo") and "wbflow run" in line for line in lines[lines.index("USER wbflow") :])
