"""Every reason has a code and a text, whose figures all call sites give; reasons can be counted."""

from __future__ import annotations

import ast
import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from string import Formatter

import pytest

import wbflow_stages
from wbflow_stages.contracts.reasons import Reason, Rejected

SOURCES = sorted(Path(wbflow_stages.__file__).parent.rglob("*.py"))


def needed(reason: Reason) -> set[str]:
    """Names of the figures in a reason's text."""
    return {name for _, name, _, _ in Formatter().parse(reason.template) if name}


def calls() -> Iterator[ast.Call]:
    """All calls of `Rejected(...)` in the stages."""
    for path in SOURCES:
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "Rejected":
                yield node


@pytest.mark.parametrize("reason", Reason)
def test_every_reason_has_a_kebab_case_code_and_a_text(reason: Reason) -> None:
    assert re.fullmatch(r"[a-z]+(-[a-z]+)*", reason)
    words = Rejected(reason, dict.fromkeys(needed(reason), 0.25)).reason
    assert len(words) > 10 and "{" not in words and words[0].isascii()


@pytest.mark.parametrize("reason", Reason)
def test_every_reason_is_used_in_the_stages(reason: Reason) -> None:
    assert any(f"Reason.{reason.name}" in path.read_text() for path in SOURCES)


def test_reason_texts_need_only_figures_that_the_call_sites_give() -> None:
    checked = 0
    for call in calls():
        code = call.args[0]
        if not (isinstance(code, ast.Attribute) and isinstance(code.value, ast.Name) and code.value.id == "Reason"):
            continue
        reason = Reason[code.attr]
        if len(call.args) < 2:
            assert not needed(reason)
        elif isinstance(call.args[1], ast.Dict):
            given = {key.value for key in call.args[1].keys if isinstance(key, ast.Constant)}
            assert needed(reason) <= given, reason
            checked += 1
    assert checked > 8


def test_a_missing_figure_raises_an_error_where_it_is_forgotten() -> None:
    with pytest.raises(KeyError, match="needed"):
        Rejected(Reason.TOO_FEW_MATCHES, {"matches": 3})


def test_reasons_can_be_counted_by_their_code() -> None:
    few = [Rejected(Reason.TOO_FEW_MATCHES, {"matches": count, "needed": 8}) for count in range(3)]
    plane = Rejected(Reason.PLANAR_OR_ROTATION, {"homography_share": 0.953})
    assert Counter(found.code for found in [*few, plane]) == {"too-few-matches": 3, "planar-or-rotation": 1}
    assert few[2].reason == "too few: 2 matches, 8 needed" and "95 %" in plane.reason


def test_a_rejection_with_free_text_has_the_code_other() -> None:
    found = Rejected("the network is not sure", {"certainty": 0.2})
    assert (found.code, found.reason) == ("other", "the network is not sure")
