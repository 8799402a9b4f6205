"""A reduced fault campaign: after any fault, the next run produces the correct cloud without anybody's help."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).resolve().parent.parent / "scripts" / "fault_campaign.py"


GROUPS = {
    "kills": ("kills-first", "kills-idle", "kills-clean"),
    "damage": ("damage", "exchanges", "references"),
    "disks": ("disks", "clocks"),
}


@pytest.mark.parametrize("faults", GROUPS.values(), ids=GROUPS)
def test_the_reduced_fault_campaign_passes(faults: tuple[str, ...]) -> None:
    only = [word for name in faults for word in ("--only", name)]
    ended = subprocess.run([sys.executable, str(SCRIPT), "--reduced", *only], capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stdout + ended.stderr
