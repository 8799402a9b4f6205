"""Every parameter is told with its default and what it means."""

from __future__ import annotations

import subprocess
import sys

import pytest
from click.testing import CliRunner

from wbflow.cli.main import main
from wbflow.pipeline.describe import describe
from wbflow.pipeline.functions import FunctionReader
from wbflow.pipeline.names import DISPARITY, MATCHES
from wbflow.pipeline.stages import STAGES, Stage, stage_named


@pytest.mark.parametrize("stage", STAGES, ids=lambda s: s.name)
def test_every_parameter_of_every_stage_has_a_meaning(stage: Stage) -> None:
    row = describe(stage, FunctionReader())
    assert row.meaning
    assert [p.name for p in row.parameters if not p.meaning and p.name != "component"] == []
    assert all(p.default for p in row.parameters)
    assert [(m.name, p.name) for m in row.methods for p in m.parameters if not p.meaning] == []


def test_units_come_from_the_docstring_or_the_name() -> None:
    row = describe(stage_named(DISPARITY), FunctionReader())
    units = {p.name: p.unit for p in row.parameters}
    assert units["tolerance_px"] == "pixels"


def test_methods_are_listed_with_parameters_of_their_own() -> None:
    row = describe(stage_named(MATCHES), FunctionReader())
    methods = {method.name: method for method in row.methods}
    assert methods["structural"].chosen
    assert "ratio" in {p.name for p in methods["mutual"].parameters}
    assert "ratio" not in {p.name for p in methods["structural"].parameters}


def test_the_command_prints_one_stage_or_all_and_refuses_others() -> None:
    one = CliRunner().invoke(main, ["stages", STAGES[0].name])
    assert one.exit_code == 0
    assert "max_captures = 15" in one.output
    every = CliRunner().invoke(main, ["stages"])
    assert all(f"\n{stage.name}  (each {stage.scope})" in f"\n{every.output}" for stage in STAGES)
    assert CliRunner().invoke(main, ["stages", "coffee"]).exit_code == 2


def test_no_vision_is_imported_for_it() -> None:
    code = (
        "import sys\nfrom wbflow.cli.main import main\ntry: main(['stages'])\nexcept SystemExit: pass\n"
        "print([m for m in ('cv2', 'numpy', 'scipy', 'numba', 'open3d') if m in sys.modules], file=sys.stderr)"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stderr.strip() == "[]"
