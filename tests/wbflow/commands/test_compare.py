"""A comparison of two nights lists what differs, and nothing else."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from tests.helpers.toy_site import ToySite
from tests.wbflow.verdict.test_rules import NAMES, camera, lost, night, without
from wbflow.cache.layout import WorkFolder
from wbflow.cli.main import main
from wbflow.commands.compare import Row, changed_lines, compare, differing
from wbflow.pipeline.summaries import CameraFigures, ChangesSummary, CoverageSummary, PosesSummary, RecordedChange
from wbflow.records.record import RunRecord
from wbflow.records.run_folder import RunFolder, UnfinishedRun


@pytest.mark.parametrize(
    ("a", "b", "differs"),
    [
        (100_000, 103_000, False),
        (100_000, 60_000, True),
        (0, 7, True),
        (0.71, 0.73, False),
        (0.71, 0.60, True),
        (31.0, 31.5, False),
        ("ok", "ok", False),
        ("ok", "rejected: too few", True),
        (None, 5, True),
    ],
)
def test_small_deviations_of_figures_do_not_count_as_differences(a: Any, b: Any, differs: bool) -> None:
    assert Row("figure", a, b).differs is differs


def test_a_lost_camera_is_listed_with_its_pairs_and_the_share_of_points() -> None:
    good = night("2026-11-19")
    poor = night(cameras=[*map(camera, NAMES[:3]), lost("roof")], pairs=without("roof"), points=55_000)
    lines = [str(row).split(maxsplit=1) for row in differing(compare(good, poor))]
    assert [line[0] for line in lines[:5]] == ["run", "night", "verdict", "points", "cameras"]
    assert lines[3][1].split() == ["100,000", "55,000", "-45", "%"]
    names = {name for name, _ in lines[5:]}
    assert {"roof", "crane--roof", "gate--roof", "mast--roof"} <= names
    assert not names & {"gate", "crane--gate"}


def test_results_of_site_wide_stages_are_compared() -> None:
    changes = ChangesSummary(compared=True, count=2)
    seen = [{"coverage": CoverageSummary(seen_by_two=share), "changes": changes} for share in (0.8, 0.6)]
    a, b = (replace(night("2026-11-19"), results=results) for results in seen)
    rows = differing(compare(a, b))[3:]
    assert [(row.what, row.a, row.b) for row in rows] == [("coverage: seen by two", 0.8, 0.6)]


def test_no_differences_are_listed_for_two_similar_nights() -> None:
    assert len(differing(compare(night("2026-11-19"), night(points=99_000)))) == 3


@pytest.fixture
def past(tmp_path: Path) -> Callable[..., str]:
    """Runs a wbflow command on a site with three nights, the last of which has lost points; returns the output."""
    (tmp_path / "site.yaml").write_text("site: yard\ncaptures: {pattern: '{camera}'}\ncameras: [crane, gate, mast, roof]\n")
    work = WorkFolder.default_for(tmp_path / "site.yaml", "yard")
    records: list[RunRecord] = []
    for date, points in (("2026-11-18", 100_000), ("2026-11-19", 101_000), ("2026-11-20", 40_000)):
        records.insert(0, night(date, points=points, past=records))
        unfinished = UnfinishedRun(work, records[0].run)
        unfinished.write("cloud.ply", b"ply")
        unfinished.publish(records[0], [], "<html>")

    def command(name: str, *arguments: str, code: int = 0) -> str:
        result = CliRunner().invoke(main, [name, str(tmp_path), *arguments])
        assert result.exit_code == code, result.output
        return result.output

    return command


def test_nights_to_compare_are_given_by_date_by_id_or_by_default(past: Callable[..., str]) -> None:
    by_date = past("compare", "2026-11-19", "2026-11-20")
    assert "-60 %" in by_date
    assert past("compare") == by_date, "the newest, and the last good one before it"
    assert past("compare", "20261119T031500Z", "latest") == by_date
    assert "nothing else differs" in past("compare", "2026-11-18", "2026-11-19")
    assert "no run has worked on the night of 2026-11-01" in past("compare", "2026-11-01", "latest", code=2)


def test_a_comparison_is_available_as_json(past: Callable[..., str]) -> None:
    data = json.loads(past("compare", "--json"))
    (row,) = [row for row in data["rows"] if row["what"] == "points"]
    assert row == {"what": "points", "a": 101_000, "b": 40_000, "change": -0.604, "differs": True}


def test_history_lists_the_verdict_of_each_night(past: Callable[..., str]) -> None:
    lines = past("history").splitlines()
    assert lines[0].endswith("verdict")
    assert lines[1].endswith("0 good")
    assert lines[3].endswith("3 degraded")
    assert lines[4].strip() == "40,000 points, 40 % of the usual 100,500"
    assert max(map(len, lines)) <= 80
    entries = json.loads(past("history", "--json"))
    assert [entry["verdict"]["level"] for entry in entries] == ["good", "good", "degraded"]


def test_history_says_a_reason_once_for_nights_in_a_row(past: Callable[..., str], tmp_path: Path) -> None:
    work = WorkFolder.default_for(tmp_path / "site.yaml", "yard")
    for date in ("2026-11-21", "2026-11-22"):
        record = replace(RunFolder.of(work).record(), date=date, run=f"{date.replace('-', '')}T031500Z")
        UnfinishedRun(work, record.run).publish(record, [], "<html>")
    lines = past("history").splitlines()
    assert [line.split(" 3 ")[-1] for line in lines[3:]] == [
        "degraded",
        "           40,000 points, 40 % of the usual 100,500",
        "degraded, as before",
        "degraded, as before",
    ]


PILE = RecordedChange("new", 11.3, 15.0, length=2.0, width=1.4, height=2.6, volume_least=4.2, volume_most=26.0, id="C17")
VAN = replace(PILE, id="C2", x=28.3, first="2026-11-18")
STACK = RecordedChange("vanished", 6.8, 20.8, length=1.8, width=0.7, height=4.2, volume_least=2.0, volume_most=3.0, id="C1")
REFERENCE = "20261101T031500Z"


def with_changes(record: RunRecord, *changes: RecordedChange, reference: str = REFERENCE) -> RunRecord:
    found = ChangesSummary(compared=True, changes={change.id: change for change in changes})
    return replace(record, reference=reference, results={"changes": found}, poses=PosesSummary())


def test_a_comparison_says_what_changed_by_ids() -> None:
    a = with_changes(night("2026-11-18"), STACK, replace(VAN, id="C3"), VAN)
    grown = replace(VAN, volume_least=30.0, volume_most=41.0)
    b = with_changes(night("2026-11-19"), PILE, grown, replace(VAN, id="C3", volume_most=24.0))
    assert list(changed_lines(a, b)) == [
        "C17 new 2.0 x 1.4 x 2.6 m at 11.3, 15.0; 4.2 to 26.0 m³",
        "C1 gone: vanished 1.8 x 0.7 x 4.2 m at 6.8, 20.8; 2.0 to 3.0 m³",
        "C2 has grown: 4.2 to 26.0 m³, now 30.0 to 41.0 m³; new 2.0 x 1.4 x 2.6 m at 28.3, 15.0",
        "C3 as before",
    ]
    assert list(changed_lines(b, b)) == ["nothing changed between 2026-11-19 and 2026-11-19", "C2, C3, C17 as before"]


def test_a_comparison_with_the_night_of_the_reference_lists_all_changes() -> None:
    first = replace(night("2026-11-01"), reference=None)
    assert first.run == REFERENCE
    assert list(changed_lines(first, with_changes(night("2026-11-19"), STACK))) == [
        "C1 vanished 1.8 x 0.7 x 4.2 m at 6.8, 20.8; 2.0 to 3.0 m³"
    ]
    other = with_changes(night("2026-11-18"), STACK, reference="20261015T031500Z")
    assert list(changed_lines(other, with_changes(night("2026-11-19"), STACK))) == [
        "what changed is unknown: both nights have no reference in common"
    ]


def test_figures_of_stages_are_printed_on_request(tmp_path: Path) -> None:
    a, b = night("2026-11-18"), night("2026-11-19", points=60_000)
    figures = [CameraFigures.from_json({"keypoints": count}) for count in (4000, 3000)]
    a, b = (
        replace(record, cameras=(replace(record.cameras[0], figures=each), *record.cameras[1:]))
        for record, each in zip((a, b), figures, strict=True)
    )
    folders = []
    for record in (a, b):
        folders.append(UnfinishedRun(WorkFolder(tmp_path), record.run).publish(record, [], "").paths.folder)
    short = CliRunner().invoke(main, ["compare", *map(str, folders)]).output
    assert "points " in short
    assert "keypoints" not in short
    assert "and 1 figure of stages, cameras and pairs: --figures lists them" in short
    assert "crane keypoints" in CliRunner().invoke(main, ["compare", *map(str, folders), "--figures"]).output


def test_history_marks_runs_whose_folder_was_removed(toy: ToySite) -> None:
    runs = [toy.run()["run"] for _ in range(2)]
    shutil.rmtree(toy.work / "runs" / runs[0])
    lines = toy.wbflow("history").stdout.splitlines()
    assert [line.split()[-1] for line in lines[1:]] == ["cleaned", "good"]


def test_status_counts_tasks_and_estimates_cpu_time(toy: ToySite) -> None:
    first = json.loads(toy.wbflow("status", "--json").stdout)
    assert first["pairs_to_come"]
    assert first["cpu_seconds"] is None
    record = toy.run()
    toy.capture("roof").write_text("another view")
    second = json.loads(toy.wbflow("status", "--json").stdout)
    assert sum(second["totals"].values()) == len(second["tasks"])
    assert {task["task"] for task in second["tasks"] if task["state"] == "would run"} >= {"frames roof"}
    assert second["cpu_seconds"] is not None
    assert toy.wbflow("status").stdout.splitlines()[-1].startswith(f"night of {record['date']}: ")
