"""Changes since the last good night, derived only from both nights' changes since the reference."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from tests.wbflow.verdict.test_rules import night
from wbflow.pipeline.summaries import ChangesSummary, RecordedChange
from wbflow.records.findings import Verdict
from wbflow.records.record import RunRecord
from wbflow.report.data import Comparison, ReportData

CONTAINER = RecordedChange("new", 9.2, 15.3, 1.3, length=6.3, width=2.7, volume=39.2, id="C2")
VAN = RecordedChange("new", 28.3, 16.3, 1.2, length=4.7, width=2.3, volume=17.4, id="C3")
STACK = RecordedChange("vanished", 6.8, 20.8, 4.2, length=1.8, width=0.7, volume=3.8, id="C1")


def with_changes(record: RunRecord, *things: RecordedChange, reference: str = "20261101T031500Z") -> RunRecord:
    changes = ChangesSummary(compared=True, changes={thing.id: thing for thing in things})
    return replace(record, reference=reference, results={"changes": changes})


def compared(tonight: RunRecord, *earlier: RunRecord) -> Comparison | None:
    """Tonight's changes compared with those of earlier nights (newest first)."""
    data = ReportData(cast(Any, None), tonight, (), {}, Path(), cast(Any, None))
    vars(data)["earlier"] = list(earlier)
    return data.since_last_good


def test_changes_since_the_last_good_night_are_known_new_or_gone() -> None:
    nudged = replace(CONTAINER, x=9.5, volume=38.7)
    good = with_changes(night("2026-11-18"), nudged, STACK)
    bad = replace(with_changes(night("2026-11-19"), VAN), verdict=Verdict("degraded"))
    tonight = with_changes(night("2026-11-20"), CONTAINER, VAN)
    since = compared(tonight, bad, good)
    assert since is not None
    assert since.date == "2026-11-18", "the night before was not good"
    assert since.known == {"C2"}
    assert since.gone == {"C1": STACK}


def test_every_change_since_the_night_of_the_reference_is_new() -> None:
    first = replace(night("2026-11-01"), reference=None)
    tonight = with_changes(night("2026-11-20"), CONTAINER, reference=first.run)
    since = compared(tonight, first)
    assert since is not None
    assert (since.known, since.gone) == (set(), {})


def test_there_is_no_comparison_without_a_good_night_of_the_same_reference() -> None:
    other = with_changes(night("2026-11-18"), CONTAINER, reference="20261002T031500Z")
    tonight = with_changes(night("2026-11-20"), CONTAINER)
    assert compared(tonight, other) is None
    assert compared(tonight) is None


def test_a_night_that_is_run_again_ignores_later_nights(monkeypatch: pytest.MonkeyPatch) -> None:
    made = [night(date) for date in ("2026-11-22", "2026-11-18", "2026-11-20", "2026-11-19")]
    monkeypatch.setattr("wbflow.report.data.newest_runs", lambda work, before: ((None, record) for record in made))
    cache = cast(Any, SimpleNamespace(work=None))
    data = ReportData(cache, night("2026-11-20"), (), {}, Path(), cast(Any, None))
    assert [record.date for record in data.earlier] == ["2026-11-19", "2026-11-18"]
