"""What the ledger keeps of a run, also after its folder is gone."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

from tests.helpers import made_up_run
from wbflow.cache.layout import WorkFolder
from wbflow.pipeline.summaries import ChangesSummary, RecordedChange
from wbflow.records.findings import Finding, Verdict
from wbflow.records.ledger import Ledger
from wbflow.records.run_folder import UnfinishedRun
from wbflow.records.summary import MOST_FINDINGS, RunSummary, summary_of
from wbflow_stages.contracts.ground_figures import CutFill

NIGHT = made_up_run.record(made_up_run.names(6))


def test_a_summary_has_verdict_figures_changes_and_volumes() -> None:
    box = RecordedChange(
        "new", x=11.3, y=15.0, length=2.0, width=1.4, height=2.6, volume_least=4.2, volume_most=26.0, zone="gate"
    )
    changes = ChangesSummary(
        files=("changes.ply", "change-C1.jpg", "change-C17.jpg"),
        compared=True,
        count=1,
        cut_fill=CutFill(gained=4.9, gained_sigma=0.4),
        changes={"C17": box},
    )
    found = summary_of(replace(NIGHT, results={"changes": changes}, reference="20261101T031500Z"))
    assert (found.level, found.finding_count) == ("degraded", 3)
    assert [finding.text for finding in found.findings] == [str(finding) for finding in NIGHT.verdict.findings]  # type: ignore[union-attr]
    assert found.figures["points"] == 900
    assert found.figures["cameras"] == 5
    assert found.figures["changes.count"] == 1
    assert found.volumes[""].gained == 4.9
    (change,) = found.changes
    assert (change.id, change.kind, change.zone, change.picture) == ("C17", "new", "gate", "change-C17.jpg")
    assert (change.place, change.size, change.first) == ((11.3, 15.0, 0.0), (2.0, 1.4, 2.6), NIGHT.date)
    assert RunSummary.from_json(found.to_json()) == found


def test_a_camera_clock_that_is_years_ahead_puts_no_night_into_the_future() -> None:
    run = "20261120T031500Z"
    assert summary_of(replace(NIGHT, run=run, date="2037-01-01")).date == "2026-11-21"
    assert summary_of(replace(NIGHT, run=run, date="2026-11-21")).date == "2026-11-21", "east of Greenwich"
    assert summary_of(replace(NIGHT, run=run, date="2019-05-01")).date == "2019-05-01", "an old night may be run at any time"


def test_the_summary_of_a_night_with_many_findings_stays_short() -> None:
    many = tuple(Finding("camera-lost", (f"cam-{k}",), f"cam-{k} is gone") for k in range(300))
    found = summary_of(replace(NIGHT, verdict=Verdict("failed", many)))
    assert (len(found.findings), found.finding_count) == (MOST_FINDINGS, 300)


def test_the_ledger_keeps_the_summary_of_a_run_whose_folder_is_removed(tmp_path: Path) -> None:
    work = WorkFolder(tmp_path)
    for run in ("20261120T031500Z", "20261121T031500Z"):
        UnfinishedRun(work, run).publish(replace(NIGHT, run=run), [], "")
    with Ledger(work, writes=True):
        pass
    shutil.rmtree(work.run("20261120T031500Z").folder)
    with Ledger(work) as ledger:
        assert ledger.summaries() == [summary_of(replace(NIGHT, run=run)) for run in ("20261120T031500Z", "20261121T031500Z")]
