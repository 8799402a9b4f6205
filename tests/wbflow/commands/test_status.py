"""What `wbflow status` says first: how the site is, in five lines; and then each reason once."""

from __future__ import annotations

import json
import os

import pytest
from click.testing import CliRunner

from tests.helpers.toy_site import ToySite
from wbflow.cli.main import main
from wbflow.cli.status import print_plan
from wbflow.commands.status import Line, Status


def status(toy: ToySite, *arguments: str, color: bool = False, **environment: str) -> list[str]:
    """The lines that `wbflow status` prints."""
    result = CliRunner().invoke(main, ["status", str(toy.file), *arguments], env={**toy.env(), **environment}, color=color)
    assert result.exit_code == 0, result.output
    return result.stdout.splitlines()


def crontab(toy: ToySite, monkeypatch: pytest.MonkeyPatch, *lines: str) -> None:
    """Put a `crontab` program with these lines first in PATH."""
    program = toy.folder / "bin" / "crontab"
    program.parent.mkdir(exist_ok=True)
    program.write_text("#!/bin/sh\ncat <<'END'\n" + "\n".join(lines) + "\nEND\n")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{program.parent}{os.pathsep}{os.environ['PATH']}")


def test_a_site_that_has_never_run_is_told_in_five_lines(toy: ToySite) -> None:
    toy.capture("roof").unlink()
    night, cameras, changes, disk, next_run, empty = status(toy)[:6]
    assert night == "night     none has been worked on yet"
    assert cameras.startswith("cameras   3 of 4 have captures of ")
    assert changes.startswith("changes   not known")
    assert disk.startswith("disk ") and "free; a night takes about" in disk
    assert next_run.startswith("next run  not planned: wbflow init ")
    assert empty == ""


def test_the_last_night_is_told_with_its_verdict_and_the_cameras_that_were_left_out(toy: ToySite) -> None:
    toy.capture("roof").write_text("broken")
    toy.run(code=3)
    date = toy.run(code=3)["date"]
    night, cameras = status(toy)[:2]
    assert night.startswith(f"night     {date} degraded: roof: ")
    assert cameras == "cameras   3 of 4 in use; left out: roof"


def test_the_verdict_has_its_colour_on_a_terminal_alone(toy: ToySite) -> None:
    toy.capture("roof").write_text("broken")
    toy.run(code=3)
    assert status(toy, color=True)[0].startswith("\x1b[33m")
    assert "\x1b" not in status(toy, color=True, NO_COLOR="1")[0]
    assert "\x1b" not in status(toy)[0]


@pytest.mark.parametrize(
    ("line", "found"),
    [
        ("30 3 * * * /opt/wbflow/bin/wbflow run {file} -q", "30 3 * * *"),
        ("@daily wbflow run '{folder}/' -q", "@daily"),
        ("0 4 * * 1-5 cd /srv && wbflow run {parent}/*/site.yaml -q", "0 4 * * 1-5"),
        ("# 30 3 * * * wbflow run {file}", ""),
        ("30 3 * * * wbflow run {folder}/other.yaml", ""),
        ("30 3 * * * tar czf backup.tgz {folder}", ""),
    ],
)
def test_the_next_run_is_read_from_the_crontab(toy: ToySite, monkeypatch: pytest.MonkeyPatch, line: str, found: str) -> None:
    names = {"file": toy.file, "folder": toy.folder, "parent": toy.folder.parent}
    crontab(toy, monkeypatch, "MAILTO=ops", line.format(**names))
    next_run = status(toy)[4]
    assert next_run == f"next run  {found} (crontab)" if found else next_run.startswith("next run  not planned")


def test_the_same_reason_is_one_line_with_the_number_of_its_tasks(capsys: pytest.CaptureFixture[str]) -> None:
    frozen = "camera roof is stale: its picture is frozen"
    lost = [f"{stage} gate--roof" for stage in ("matches", "geometry", "rectify", "disparity")]
    tasks = [
        *(Line(f"frames {name}", "cached", "") for name in ("gate", "roof")),
        Line("frames crane", "would run", "input captures changed"),
        *(Line(name, "skipped", f"rectify gate--roof was skipped: {frozen}", frozen) for name in lost),
    ]
    print_plan(Status("yard", "2026-11-12", tuple(tasks), {"cached": 2, "would run": 1, "skipped": 4}, None, pairs_to_come=False))
    assert [line.split(maxsplit=1) for line in capsys.readouterr().out.splitlines()[:3]] == [
        ["frames", "2 cached"],
        ["frames", "crane" + 21 * " " + "would run: input captures changed"],
        ["skipped", f"4: {frozen}"],
    ]


def test_a_plan_fits_the_terminal(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    why = "function wbflow_stages.geometry:estimate_geometry → wbflow_stages.reference_reuse:turn_geometry"
    tasks = (Line("geometry mast-2--mast-3", "would run", why), Line("fuse", "skipped", "", f"camera mast-3 is stale: {why}"))
    totals = {"cached": 1019, "skipped": 1013, "would run": 1020}
    print_plan(Status("yard", "2026-11-12", tasks, totals, 12345.0, pairs_to_come=True))
    assert max(len(line) for line in capsys.readouterr().out.splitlines()) <= 80


def test_tasks_that_are_skipped_one_after_another_have_the_reason_of_the_first(toy: ToySite) -> None:
    for camera in toy.cameras[1:]:
        toy.capture(camera).unlink()
    toy.run(code=1)
    tasks = json.loads("\n".join(status(toy, "--json")))["tasks"]
    skipped = [task for task in tasks if task["state"] == "skipped"]
    assert len(skipped) > len({task["cause"] for task in skipped})
    assert not any("was skipped" in task["cause"] for task in skipped)


def test_it_fits_the_terminal(toy: ToySite) -> None:
    toy.capture("roof").write_text("broken")
    toy.run(code=3)
    lines = status(toy, COLUMNS="80")
    assert max(len(line) for line in lines if str(toy.folder) not in line) <= 80  # paths stay whole: they are copied


def test_json_has_the_same_facts(toy: ToySite) -> None:
    date = toy.run()["date"]
    data = json.loads("\n".join(status(toy, "--json")))
    assert data["overview"]["night"] == f"{date} good"
    assert data["overview"]["cameras"] == "4 of 4 in use"
    assert {"site", "night", "tasks", "totals", "cpu_seconds", "pairs_to_come"} <= data.keys()
