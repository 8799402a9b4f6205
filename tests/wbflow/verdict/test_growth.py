"""Cut and fill over several nights: volumes of zones, and each change from its first night to its last."""

from __future__ import annotations

import csv
import io
from dataclasses import replace
from pathlib import Path

from click.testing import CliRunner

from tests.wbflow.verdict.test_rules import night
from wbflow.cache.layout import WorkFolder
from wbflow.cli.main import main
from wbflow.pipeline.summaries import ChangesSummary, PosesSummary, RecordedChange
from wbflow.records.metrics import metrics
from wbflow.records.record import RunRecord
from wbflow.records.run_folder import UnfinishedRun
from wbflow_stages.contracts.ground_figures import CutFill


def pile(volume: float, x: float = 4.0) -> RecordedChange:
    return RecordedChange("new", x, 2.0, 0.5, length=3.0, volume=volume, volume_sigma=0.2, area=volume, zone="quay")


def of_night(date: str, *piles: RecordedChange, compared: bool = True) -> RunRecord:
    gained = sum(each.volume or 0.0 for each in piles)
    site = CutFill(gained=gained, gained_sigma=0.3, area=500.0, unseen=20.0)
    things = {str(k): each for k, each in enumerate(piles, 1)}
    zones = {"quay": replace(site, area=80.0, unseen=0.0)}
    changes = ChangesSummary(compared=True, count=len(piles), cut_fill=site, zones=zones, changes=things)
    results = {"changes": changes if compared else ChangesSummary(compared=False)}
    return replace(night(date), reference="20261101T031500Z", results=results, poses=PosesSummary())


def rows_of(folder: Path, *records: RunRecord) -> list[dict[str, str]]:
    (folder / "site.yaml").write_text("site: yard\ncaptures: {pattern: '{camera}'}\ncameras: [crane, gate, mast, roof]\n")
    for record in records:
        UnfinishedRun(WorkFolder.default_for(folder / "site.yaml", "yard"), record.run).publish(record, [], "")
    result = CliRunner().invoke(main, ["history", str(folder), "--changes", "--csv"])
    assert result.exit_code == 0, result.output
    return list(csv.DictReader(io.StringIO(result.output)))


def test_a_change_is_followed_from_its_first_night_to_its_last(tmp_path: Path) -> None:
    records = (
        of_night("2026-11-17"),
        of_night("2026-11-18", pile(2.0)),
        of_night("2026-11-19", compared=False),
        of_night("2026-11-20", pile(3.5, x=4.3), pile(1.0, x=40.0)),
        of_night("2026-11-21", pile(1.0, x=40.0)),
    )
    rows = rows_of(tmp_path, *records)
    first = [row for row in rows if (row["what"], row["name"]) == ("change", "1")]
    assert [(row["night"], row["gained"], row["growth"]) for row in first] == [
        ("2026-11-18", "2.0", ""),
        ("2026-11-20", "3.5", "1.5"),
    ]
    assert {(row["begin"], row["end"], row["zone"]) for row in first} == {("2026-11-18", "2026-11-21", "quay")}
    second = [row for row in rows if (row["what"], row["name"]) == ("change", "2")]
    assert [(row["night"], row["begin"], row["end"]) for row in second] == [
        ("2026-11-20", "2026-11-20", ""),
        ("2026-11-21", "2026-11-20", ""),
    ]
    zone = [(row["night"], row["gained"], row["area"]) for row in rows if row["what"] == "zone"]
    assert zone == [
        ("2026-11-17", "0.0", "80.0"),
        ("2026-11-18", "2.0", "80.0"),
        ("2026-11-20", "4.5", "80.0"),
        ("2026-11-21", "1.0", "80.0"),
    ]


def test_the_history_of_changes_is_printed_as_a_table(tmp_path: Path) -> None:
    rows_of(tmp_path, of_night("2026-11-18", pile(2.0)))
    lines = CliRunner().invoke(main, ["history", str(tmp_path), "--changes"]).output.splitlines()
    assert len({len(line[:62]) for line in lines}) == 1
    assert lines[-1].endswith("2026-11-18 to now")
    assert "2.0 ± 0.2" in lines[-1]


def test_the_metrics_contain_volumes_by_zone() -> None:
    gauges = metrics(of_night("2026-11-18", pile(2.0))).splitlines()
    assert 'wbflow_volume_cubic_metres{site="yard",change="gained"} 2' in gauges
    assert 'wbflow_volume_sigma_cubic_metres{site="yard",zone="quay",change="gained"} 0.3' in gauges
    assert 'wbflow_compared_square_metres{site="yard",seen="no"} 20' in gauges
