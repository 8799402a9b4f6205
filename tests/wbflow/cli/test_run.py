"""What is printed about a night when it has ended."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from tests.helpers import made_up_run
from tests.helpers.toy_site import ToySite
from wbflow.cli.ended import next_step, print_findings
from wbflow.records.events import TaskEvent
from wbflow.records.findings import Finding, Verdict
from wbflow.records.finished_run import task_named
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
    fewer = Finding("fewer-pairs", (), "3 pairs, 50 % of the usual 6", {"pairs": 3}, {"pairs": 6}, "compare", ("cam-4",))
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
    assert " ".join(head.split()) == "site night verdict points first finding"
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


@pytest.mark.parametrize(
    ("subject", "text"),
    [
        (("cam-2",), "pictures of cam-2 are too poor: noise"),
        (("cam-1", "cam-2"), "the lenses of cam-1, cam-2 are not stated"),
        (("cam-1", "cam-2"), "cam-1--cam-2 failed: boom"),
        (("cam-1", "cam-2", "cam-3"), "poses of cam-1, cam-2, cam-3 are uncertain: 3 px"),
    ],
)
def test_a_finding_that_names_its_subject_is_not_headed_by_it(subject: tuple[str, ...], text: str) -> None:
    assert str(Finding("pictures-soft", subject, text)) == text


def test_a_finding_that_does_not_name_its_subject_first_is_headed_by_it() -> None:
    assert str(Finding("camera-moved", ("cam-2",), "turned: unlike cam-2 of old")) == "cam-2: turned: unlike cam-2 of old"
    assert str(Finding("pairs-disagree", ("cam-1", "cam-2"), "depths of cam-1 differ")) == "cam-1--cam-2: depths of cam-1 differ"


def next_after(*findings: Finding, exit_code: int = 3, failed: tuple[str, str] | None = None) -> str:
    """The next step after a night with these findings; failed: name and code of a task that failed."""
    events = {}
    if failed:
        task = task_named(failed[0])
        events[task] = TaskEvent(task, "failed", "2026-11-20T03:15:00Z", code=failed[1])
    record = made_up_run.record(made_up_run.names(4), verdict=Verdict("degraded", findings), exit_code=exit_code)
    work = SimpleNamespace(run_ids=lambda: [record.run])
    return next_step(
        cast(Any, SimpleNamespace(record=record, task_events=events, cache=SimpleNamespace(work=work))), Path("yard")
    )


LOST = Finding("camera-lost", ("cam-3",), "no capture; left out tonight", remedy="check that it delivers")
NO_CLOUD = Finding("no-cloud", (), "no cloud: two cameras are needed", remedy="fix the cameras")
FAILED = Finding("task-failed", ("cam-1",), "features cam-1 failed: boom", remedy="wbflow run -v SITE.yaml shows where")


def test_the_next_step_is_the_first_remedy_even_if_a_task_failed() -> None:
    assert next_after(LOST, FAILED, failed=("features cam-1", "fault")) == "cam-3: check that it delivers"


def test_after_a_fault_the_next_step_looks_into_its_task() -> None:
    command = "wbflow debug yard 'features cam-1' --out debug"
    assert next_after(FAILED, LOST, failed=("features cam-1", "fault")) == command
    assert next_after(NO_CLOUD, FAILED, exit_code=1, failed=("features cam-1", "fault")) == command


def test_after_a_fault_in_a_task_of_a_camera_the_next_step_looks_into_it() -> None:
    assert next_after(LOST, failed=("features cam-3", "fault")) == "wbflow debug yard 'features cam-3' --out debug"
    assert next_after(LOST, failed=("features cam-1", "fault")) == "cam-3: check that it delivers"


def test_a_task_whose_input_is_at_fault_is_not_debugged() -> None:
    assert next_after(FAILED, failed=("features cam-1", "bad-input")) == "cam-1: wbflow run -v yard shows where"


def test_the_remedy_of_a_consequence_is_not_the_next_step() -> None:
    assert next_after(replace(NO_CLOUD, follows=("cam-3",)), LOST, exit_code=1) == "cam-3: check that it delivers"


def test_an_interrupted_run_is_continued_on_its_night() -> None:
    interrupted = Finding("interrupted", (), "interrupted; everything finished is kept", remedy="run it again")
    assert next_after(interrupted, LOST, exit_code=130) == "wbflow run yard --date 2026-12-09"


def test_no_cloud_for_want_of_cameras_is_told_under_them(capsys: pytest.CaptureFixture[str]) -> None:
    verdict = Verdict("failed", (replace(NO_CLOUD, follows=("cam-3",)), LOST))
    print_findings(made_up_run.record(made_up_run.names(4), verdict=verdict, exit_code=1), err=False)
    assert capsys.readouterr().out.splitlines()[1:] == [
        "  cam-3: no capture; left out tonight",
        "    check that it delivers",
        "  which leaves no cloud: two cameras are needed",
    ]
