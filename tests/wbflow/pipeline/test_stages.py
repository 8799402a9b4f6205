"""The pipeline as a table: what it says about functions is what they are."""

from __future__ import annotations

from typing import Any, get_args, get_type_hints

import pytest

from wbflow.pipeline.stages import REJECTED, RESULT_TYPES, stage_named
from wbflow.plugins import load


@pytest.mark.parametrize("stage", RESULT_TYPES)
def test_the_type_of_a_result_is_that_of_the_stages_own_function(stage: str) -> None:
    returned: Any = get_type_hints(load(stage_named(stage).function))["return"]
    kinds = set(get_args(returned)) or {returned}
    assert kinds - {load(REJECTED)} == {load(RESULT_TYPES[stage])}
