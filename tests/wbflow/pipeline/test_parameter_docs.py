"""Every parameter of every stage is listed with its default and its meaning."""

from __future__ import annotations

import itertools
import subprocess
import sys

import pytest
from click.testing import CliRunner

from wbflow.cli.main import main
from wbflow.pipeline.binding import method_parameters
from wbflow.pipeline.functions import FunctionReader
from wbflow.pipeline.parameter_docs import describe, document
from wbflow.pipeline.stages import DISPARITY, FEATURES, FRAMES, MATCHES, STAGES, Stage, stage_named


@pytest.mark.parametrize("stage", STAGES, ids=lambda s: s.name)
def test_every_parameter_of_every_stage_has_a_meaning(stage: Stage) -> None:
    reader = FunctionReader()
    function = reader.signature(stage.function)
    own = [p for name, p in function.parameters.items() if name not in {*stage.inputs, *stage.offers}]
    meaning, docs = document(function, own)
    assert meaning
    for name, parameters in method_parameters(stage, reader).items():
        assert stage.method
        docs += document(reader.signature(reader.table(stage.method.table)[name]), parameters.values())[1]
    assert [doc.parameter.name for doc in docs if not doc.meaning and doc.parameter.name != "component"] == []


def test_units_of_parameters_are_listed() -> None:
    assert "  tolerance_px = 2.0 [pixels]" in describe(stage_named(DISPARITY), FunctionReader())


def test_methods_are_listed_with_parameters_of_their_own() -> None:
    text = "\n".join(describe(stage_named(MATCHES), FunctionReader()))
    assert "\n  structural (default): " in text
    structural, mutual = (
        text.partition(f"\n  {name}")[2].partition("\n  ")[2].split("\n  ") for name in ("structural", "mutual")
    )
    of_own = [list(itertools.takewhile(lambda line: line.startswith("  "), lines)) for lines in (structural, mutual)]
    assert [any(line.startswith("  ratio = ") for line in lines) for lines in of_own] == [False, True]


def test_the_stages_command_prints_one_stage_or_all_and_refuses_others() -> None:
    one = CliRunner().invoke(main, ["stages", FRAMES])
    assert one.exit_code == 0
    assert "max_captures = 15" in one.output
    every = CliRunner().invoke(main, ["stages"])
    assert all(f"\n{stage.name}  (each {stage.scope})" in f"\n{every.output}" for stage in STAGES)
    assert CliRunner().invoke(main, ["stages", "coffee"]).exit_code == 2


def test_the_stages_command_imports_no_vision_libraries() -> None:
    code = (
        "import sys\nfrom wbflow.cli.main import main\ntry: main(['stages'])\nexcept SystemExit: pass\n"
        "print([m for m in ('cv2', 'numpy', 'scipy', 'numba', 'open3d') if m in sys.modules], file=sys.stderr)"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stderr.strip() == "[]"


def test_a_file_that_a_method_needs_is_listed_among_its_parameters() -> None:
    text = "\n".join(describe(stage_named(FEATURES), FunctionReader()))
    assert "\n  onnx: " in text and text.count("    model = none: it must be given\n") == 2
    assert "a path, or a name that `wbflow models` lists" in text
