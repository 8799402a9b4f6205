"""What is printed about a night when it has ended."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.helpers import made_up_run
from tests.helpers.toy_site import ToySite
from wbflow.cli.ended import print_findings
from wbflow.records.findings import Finding, Verdict
from wbflow.records.record import CameraRecord


@pytest.fixture
def toy_site_of_dates(tmp_path: Path) -> ToySite:
    return ToySite(tmp_path / "site", ["gate", "roof", "mast-1", "crane"], dated=True)


def test_findings_common_to_many_cameras_are_printed_in_a_few_lines(capsys: pytest.CaptureFixture[str]) -> None:
    ids = made_up_run.names(60)
    lost = [Finding("camera-lost", (name,), "there is no capture", remedy="see that it delivers") for name in ids]
    alone = Finding("fewer-points", (), "900 points, 50 % of the usual 1,800", remedy="compare")
    print_findings(made_up_run.record(ids, verdict=Verdict("degraded", (*lost, alone))), err=True)
    lines = capsys.readouterr().err.splitlines()
    assert lines[1:4] == [f"  {name}: there is no capture" for name in ids[:3]]
    assert lines[4] == f"  and 57 more like these: {', '.join(ids[3:])}"
    assert lines[5:] == ["    see that it delivers", "  900 points, 50 % of the usual 1,800", "    compare"]


def test_what_follows_from_a_frozen_camera_is_told_under_it_without_a_remedy_of_its_own(
    capsys: pytest.CaptureFixture[str],
) -> None:
    stale = Finding("camera-stale", ("cam-4",), "its captures are those of the night before", remedy="restart it")
    fewer = Finding("fewer-pairs", (), "3 pairs, 50 % of the usual 6", {"pairs": 3}, {"pairs": 6}, remedy="compare")
    cameras = (*(CameraRecord(f"cam-{k}", "ok") for k in (1, 2, 3)), CameraRecord("cam-4", "skipped", "it is stale"))
    turned = Finding("camera-moved", ("cam-1",), "turned by 0.5 degrees: corrected", remedy="turn it back")
    verdict = Verdict("degraded", (stale, turned, fewer))
    print_findings(made_up_run.record(made_up_run.names(4), cameras=cameras, verdict=verdict), err=False)
    assert capsys.readouterr().out.splitlines()[1:] == [
        "  cam-4: its captures are those of the night before",
        "    restart it",
        "  which leaves 3 pairs, 50 % of the usual 6",
        "  cam-1: turned by 0.5 degrees: corrected",
        "    turn it back",
    ]


def test_everything_about_a_degraded_night_is_printed_on_stdout_and_the_next_step_is_its_first_remedy(toy: ToySite) -> None:
    toy.capture("roof").write_text("broken")
    result = toy.wbflow("run", "--jobs", "1")
    lines = [line for line in result.stdout.splitlines() if not line[:4].isdigit()]
    assert lines[0].endswith("degraded: look at this")
    assert lines[1].startswith("  roof: roof.txt is not an image")
    assert lines[-1].startswith("next    roof: ")
    assert lines[-1].endswith("it is used again as soon as it delivers usable captures")
    assert "look at this" not in result.stderr


def test_a_backlog_ends_with_a_table_of_its_nights(toy_site_of_dates: ToySite) -> None:
    toy = toy_site_of_dates
    toy.night("2026-11-01")
    toy.night("2026-11-02")
    toy.capture("roof", "2026-11-02").write_text("broken")
    result = toy.wbflow("run", "--since", "2026-11-01", "--jobs", "1")
    head, first, second = result.stdout.splitlines()[-3:]
    assert head.split() == ["site", "night", "verdict", "points", "first", "finding"]
    assert first.split()[:3] == ["toy", "2026-11-01", "good"]
    assert second.split()[:3] == ["toy", "2026-11-02", "degraded"]
    assert "is not an image" in second


def test_lines_fit_the_terminal(toy: ToySite) -> None:
    toy.capture("roof").write_text("broken")
    toy.environment = {"COLUMNS": "80"}
    lines = [line for line in toy.wbflow("run", "--jobs", "1").stdout.splitlines() if not line[:4].isdigit()]
    assert max(len(line) for line in lines if str(toy.folder) not in line) <= 80  # paths stay whole: they are copied
    assert len(lines) > 4


def test_a_dry_run_of_nothing_is_one_line(toy: ToySite) -> None:
    night = toy.run()["date"]
    lines = toy.wbflow("run", "--dry-run").stdout.splitlines()
    assert len(lines) == 1
    assert lines[0].startswith(f"night of {night}: nothing would run: ")
    toy.capture("roof").write_text("another view")
    assert len(toy.wbflow("run", "--dry-run").stdout.splitlines()) > 10
