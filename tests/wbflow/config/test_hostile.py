"""Site files and calibrations that nobody means well with are refused with a place, and none makes wbflow itself fail."""

from __future__ import annotations

import importlib
import itertools
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

SCRIPTS = Path(__file__).parents[3] / "scripts"


@pytest.fixture
def hostile(monkeypatch: pytest.MonkeyPatch) -> Any:
    """The script that tries them all, and more of them."""
    monkeypatch.syspath_prepend(str(SCRIPTS))
    return importlib.import_module("hostile_inputs")


def test_what_people_have_thought_of(hostile: Any) -> None:
    counts: Counter[str] = Counter()
    site = (case for case in hostile.site_cases() if case.refused)
    calibration = (case for case in hostile.calibration_cases() if case.refused)
    assert list(hostile.try_files("site", site, counts)) == []
    assert list(hostile.try_files("calibration", calibration, counts)) == []
    assert counts["site refused"] > 100 and counts["calibration refused"] > 30


def test_what_chance_makes_of_good_files(hostile: Any) -> None:
    counts: Counter[str] = Counter()
    assert list(hostile.try_files("fuzzed", itertools.islice(hostile.fuzzed(100, 7), 100), counts)) == []
    assert counts["fuzzed refused"] > 50
