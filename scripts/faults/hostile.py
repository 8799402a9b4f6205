"""Hostile site files, calibrations and captures, as rows of the campaign."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Callable, Iterable

from hostile_captures import capture_cases
from hostile_files import calibration_cases, fuzzed, site_cases
from hostile_inputs import WORKER_MB, Fault, try_captures, try_files, try_loops

from .bench import Bench, Row

FUZZED, FUZZED_REDUCED = 5000, 50
STEP = 20
"""A reduced campaign tries every twentieth file and every sixth capture."""


def _noted(row: Row, faults: Iterable[Fault], counts: Counter[str], kind: str) -> Row:
    for fault in faults:
        row.add_loss(fault.column, f"{fault.name}: {fault.what}")
    row.tries += counts[f"{kind} tried"]
    return row


def files(bench: Bench, reduced: bool) -> Row:
    """Hand-written bad site files and calibrations."""
    row = Row("hostile site or calibration file")
    for kind, cases in (("site", site_cases()), ("calibration", calibration_cases())):
        counts: Counter[str] = Counter()
        _noted(row, try_files(kind, itertools.islice(cases, 0, None, STEP if reduced else 1), counts), counts, kind)
    return row


def fuzz(bench: Bench, reduced: bool) -> Row:
    """Good files with some bytes, lines or words changed."""
    counts: Counter[str] = Counter()
    cases = fuzzed(FUZZED_REDUCED if reduced else FUZZED, bench.random.randrange(10**6))
    return _noted(Row("fuzzed file"), try_files("fuzzed", cases, counts), counts, "fuzzed")


def captures(bench: Bench, reduced: bool) -> Row:
    """Hostile captures, through the whole program and in real worker processes."""
    counts: Counter[str] = Counter()
    row = Row("hostile capture")
    faults = [*try_captures(capture_cases()[:: STEP // 3 if reduced else 1], counts), *try_loops()]
    row.fault = f"hostile capture ({counts['captures MB']} of {WORKER_MB:.0f} MB)"
    return _noted(row, faults, counts, "captures")


HOSTILE: dict[str, Callable[[Bench, bool], Row]] = {
    "hostile-files": files,
    "hostile-captures": captures,
    "fuzzed": fuzz,
}
