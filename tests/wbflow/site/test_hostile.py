"""Malicious site files and calibrations are refused with the place of the fault, and none makes wbflow itself fail."""

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
    """The script hostile_inputs.py, which has all of these cases and more."""
    monkeypatch.syspath_prepend(str(SCRIPTS))
    return importlib.import_module("hostile_inputs")


MESSAGES = {
    "an alias bomb": "site.yaml:6:5: not valid YAML: aliases that stand for more than",
    "an alias bomb of mappings": "site.yaml:17:6: not valid YAML: aliases that stand for more than",
    "100,000 brackets": "site.yaml:3:49: not valid YAML: values are nested more than 40 levels deep",
    "a nesting of 500": "site.yaml:43:41: not valid YAML: values are nested more than 40 levels deep",
    "an integer that is none": "site.yaml:4:13: not valid YAML: x cannot be read",
    "a date that is none": "site.yaml:4:13: not valid YAML: 2026-99-99 cannot be read",
    "400 digits": "site.yaml:4:13: not valid YAML: 9999",
    "bytes that are no text": "site.yaml:1:7: is not UTF-8 text",
    "cameras: 5": ": cameras: input should be a valid list, not 5",
    "site: ..": ": site: '..' is not a name",
    "pairs of one name": ": cameras[1]: the pairs 'a', 'b--c' and 'a--b', 'c' would both be called a--b--c",
    "work in nobody's home": ": work: '~nosuchuser/work' is not a path",
    "captures in nobody's home": ": captures.root: '~nosuchuser' is not a path",
    "a mask of nobody": ": cameras[0].mask: '~nosuchuser/mask.png' is not a path",
    "use: os:system": ": stages.matches.use: there is no module 'os' to take system from",
    "use: 5": ": stages.matches.use: 5 is not a function",
    "a plug-in with a syntax error": "plugin.py:1: invalid syntax",
    "a lens that is no number": ": cameras[0].intrinsics.hfov: input should be a finite number, not nan",
    "a lens of 400 digits": "is too large a number",
    "a pose that is no number": ": cameras[0].pose.position[0]: input should be a finite number, not nan",
    "JSON: no text": "cameras.json:1:1: is not UTF-8 text",
    "JSON: NaN": "cameras.json:1:16: gate.K must be 3x3 numbers",
    "COLMAP: a zero quaternion": "model/images.txt:2: not an image line of COLMAP's text model: its quaternion is zero",
    "COLMAP: images that are no text": "model/images.txt:1:1: is not UTF-8 text",
}
"""Error messages for files that once hung or crashed wbflow, or were accepted; by case."""


def test_files_that_once_crashed_are_refused_with_their_place(hostile: Any, tmp_path: Path) -> None:
    hostile.write_base(tmp_path)
    file = tmp_path / "site.yaml"
    assert hostile.load(file) == "", "else all others are refused for nothing of their own"
    left = dict(MESSAGES)
    for case in (*hostile.site_cases(), *hostile.calibration_cases()):
        if message := left.pop(case.name, None):
            hostile.write_base(tmp_path)
            for name, data in case.files.items():
                (tmp_path / name).write_bytes(data)
            assert message in hostile.load(file), case.name
    assert not left


def test_hand_written_hostile_files_are_refused(hostile: Any) -> None:
    counts: Counter[str] = Counter()
    site = (case for case in hostile.site_cases() if case.refused)
    calibration = (case for case in hostile.calibration_cases() if case.refused)
    assert list(hostile.try_files("site", site, counts)) == []
    assert list(hostile.try_files("calibration", calibration, counts)) == []
    assert counts["site refused"] > 100 and counts["calibration refused"] > 30


def test_randomly_changed_files_are_accepted_or_refused_without_a_crash(hostile: Any) -> None:
    counts: Counter[str] = Counter()
    assert list(hostile.try_files("fuzzed", itertools.islice(hostile.fuzzed(100, 7), 100), counts)) == []
    assert counts["fuzzed refused"] > 50
