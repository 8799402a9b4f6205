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


def pile(volume: float, name: str = "C1", first: str = "2026-11-18") -> RecordedChange:
    thing = RecordedChange("new", x=4.0, y=2.0, length=3.0, width=2.0, height=1.0, zone="quay", id=name, first=first, last=first)
    return replace(thing, volume=volume, volume_sigma=0.2, volume_least=volume - 0.5, volume_most=volume + 4)


def of_night(date: str, *piles: RecordedChange, compared: bool = True) -> RunRecord:
    gained = sum(each.volume for each in piles)
    site = CutFill(gained=gained, gained_sigma=0.3, gained_least=gained - 1, gained_most=gained + 9, area=500.0, unseen=20.0)
    things = {each.id: replace(each, last=date) for each in piles}
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


def later_pile(volume: float) -> RecordedChange:
    return pile(volume, "C2", "2026-11-20")


NIGHTS = (
    of_night("2026-11-17"),
    of_night("2026-11-18", pile(2.0)),
    of_night("2026-11-19", compared=False),
    of_night("2026-11-20", pile(3.5), later_pile(1.0)),
    of_night("2026-11-21", later_pile(1.0)),
)


def test_a_change_is_followed_from_its_first_night_to_its_last(tmp_path: Path) -> None:
    rows = rows_of(tmp_path, *NIGHTS)
    first = [row for row in rows if (row["what"], row["name"]) == ("change", "C1")]
    assert [(row["night"], row["gained"], row["gained_least"], row["gained_most"]) for row in first] == [
        ("2026-11-18", "2.0", "1.5", "6.0"),
        ("2026-11-20", "3.5", "3.0", "7.5"),
    ]
    assert {(row["begin"], row["end"], row["zone"]) for row in first} == {("2026-11-18", "2026-11-21", "quay")}
    second = [row for row in rows if (row["what"], row["name"]) == ("change", "C2")]
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


def test_the_history_of_changes_has_a_line_for_each_thing_also_for_one_that_is_gone(tmp_path: Path) -> None:
    rows_of(tmp_path, *NIGHTS)
    (tmp_path / "site.acknowledged").write_text("- {finding: C2, by: Ben, 'on': '2026-11-21', note: for the winter}\n")
    result = CliRunner().invoke(main, ["history", str(tmp_path), "--changes"])
    assert result.output.splitlines() == [
        "id    kind      size               at             volume          nights",
        "C1    new       3.0 x 2.0 x 1.0    4.0, 2.0       3.0 to 7.5 m³   2026-11-18 to 2026-11-20",
        "C2    new       3.0 x 2.0 x 1.0    4.0, 2.0       0.5 to 5.0 m³   2026-11-20 to now",
        "      acknowledged by Ben on 2026-11-21: for the winter",
        "since the reference, night of 2026-11-21:",
        "  whole site: gained 0.0 to 10.0 m³, lost 0.0 ± 0.0 m³; 500 m² seen, 20 not",
        "  quay: gained 0.0 to 10.0 m³, lost 0.0 ± 0.0 m³; 80 m² seen, 0 not",
    ]


def test_the_metrics_contain_volumes_by_zone() -> None:
    gauges = metrics(of_night("2026-11-18", pile(2.0))).splitlines()
    assert 'wbflow_volume_cubic_metres{site="yard",change="gained"} 2' in gauges
    assert 'wbflow_volume_sigma_cubic_metres{site="yard",zone="quay",change="gained"} 0.3' in gauges
    assert 'wbflow_compared_square_metres{site="yard",seen="no"} 20' in gauges
