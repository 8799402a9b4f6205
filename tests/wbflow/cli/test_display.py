"""The output of a run on a terminal, and in a file that it is redirected to."""

from __future__ import annotations

import json
import os
import pty
import re
import subprocess

import pytest

import wbflow
from tests.helpers.toy_site import ToySite
from wbflow.cli.display import LogLines
from wbflow.records.events import PlannedEvent, StartedEvent, TaskEvent
from wbflow.runner.plan import Plan
from wbflow.task import Task

LINE = re.compile(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d (\w+): (\d+) of (\d+) done: ")
ESCAPES = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]")


def on_a_terminal(toy: ToySite, *arguments: str, **environment: str) -> tuple[str, list[tuple[str, bool]]]:
    """The output of a run on a terminal of 80 x 30: whole, and in pieces, each with whether a frames task had ended by then."""
    ours, theirs = pty.openpty()
    env = {**toy.env(), "TERM": "xterm-256color", "COLUMNS": "80", "LINES": "30", **environment}
    process = subprocess.Popen(
        toy.command("run", str(toy.file), "--jobs", "2", *arguments), env=env, stdin=theirs, stdout=theirs, stderr=theirs
    )
    os.close(theirs)
    pieces = []
    while True:
        try:
            piece = os.read(ours, 65536).decode(errors="replace")  # a piece may end in the middle of a character
        except OSError:  # the other end is closed
            break
        if not piece:
            break
        pieces.append((piece, any((toy.work / "cache").glob("frames/*/*.json"))))
    os.close(ours)
    assert process.wait() in {0, 3}
    return "".join(piece for piece, _ in pieces), pieces


def test_a_terminal_shows_progress_before_the_first_task_has_ended(toy: ToySite) -> None:
    toy.fault("slow", "0.8")
    toy.capture("roof").write_text("broken")
    written, pieces = on_a_terminal(toy)
    early = ESCAPES.sub("", "".join(piece for piece, some_done in pieces if not some_done))
    assert "planning the run" in early
    assert re.search(r"frames .*0/4", early)
    assert re.search(r"toy .*0/\d+ 0:00:0\d .*frames gate", early), "tasks at work are named"
    text = ESCAPES.sub("", written)
    assert "roof                 frames     failed    roof.txt is not an image" in text
    assert re.search(r"^next    roof: .*it is used again as soon as it\s+delivers usable\s+captures\s*$", text, re.M | re.S)
    assert written.count("\x1b[?25h") == written.count("\x1b[?25l"), "the cursor is there again"
    assert written.rfind("\x1b[?25h") > written.rfind("\x1b[?25l")


def test_the_first_planned_event_comes_before_the_code_is_read(toy: ToySite, monkeypatch: pytest.MonkeyPatch) -> None:
    heard: list[object] = []
    refresh = Plan.refresh

    def looking(plan: Plan) -> None:
        heard.append("looked at")
        refresh(plan)

    monkeypatch.setattr(Plan, "refresh", looking)
    monkeypatch.setenv("TOY_FAULTS", str(toy.folder / "faults"))
    wbflow.run(toy.file, backend="threading", jobs=1, until="frames", listen=heard.append)
    assert heard[0] == PlannedEvent({"frames": 4})
    assert heard[1] == "looked at"


def test_no_color_disables_colours(toy: ToySite) -> None:
    written, _ = on_a_terminal(toy, "--until", "features", NO_COLOR="1")
    assert "features" in written
    assert not re.search(r"\x1b\[[0-9;]*3[0-9][;m]", written)


def test_without_a_terminal_each_stage_has_one_plain_line_with_its_time(toy: ToySite) -> None:
    toy.capture("roof").write_text("broken")
    result = toy.wbflow("run", "--jobs", "2")
    ended = [LINE.match(line) for line in result.stdout.splitlines()]
    assert [(found[1], found[2] == found[3]) for found in ended if found] == [
        (name, True)
        for name in (
            "frames",
            "features",
            "overlap",
            "pairs",
            "matches",
            "geometry",
            "poses",
            "rectify",
            "disparity",
            "depth",
            "fuse",
        )
    ]
    assert re.search(r"^\S+T\S+ roof +frames +failed +roof.txt is not an image", result.stderr, re.MULTILINE)
    assert not re.search(r"[\x00-\x09\x0b-\x1f\x7f]", result.stdout + result.stderr)


def test_quiet_prints_only_problems_and_json_only_the_record(toy: ToySite) -> None:
    toy.capture("roof").write_text("broken")
    quiet = toy.wbflow("run", "--jobs", "1", "-q")
    assert quiet.stdout == ""
    assert "degraded" in quiet.stderr
    assert "T" not in quiet.stderr.split()[0]
    assert json.loads(toy.wbflow("run", "--jobs", "1", "--json").stdout)["exit_code"] == 3


def test_v_prints_every_task_with_its_seconds(toy: ToySite) -> None:
    printed = toy.wbflow("run", "--jobs", "1", "-v").stdout
    assert re.search(r"gate +frames +ran +\d+\.\d s", printed)


def test_a_log_file_gets_progress_lines_while_a_stage_runs(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("wbflow.cli.display.PROGRESS_SECONDS", 0.0)
    lines = LogLines("harbour")
    lines.receive(PlannedEvent({"frames": 4}))
    lines.receive(StartedEvent(Task("frames", ("gate",))))
    assert re.search(r"T[\d:]+ 0 of 4 tasks done; running: frames gate$", capsys.readouterr().out.strip())


def test_a_stage_is_reported_once_after_it_and_all_earlier_ones_have_ended(capsys: pytest.CaptureFixture[str]) -> None:
    lines = LogLines("harbour")
    tasks = [Task(stage, (name,)) for stage in ("frames", "features") for name in ("gate", "roof")]
    for k, task in enumerate(tasks):
        lines.receive(PlannedEvent({"frames": 2, "features": 2 * (k > 1)}))
        lines.receive(TaskEvent(task, "ran", "t", fresh=True, cpu=1.0))
    lines.receive(PlannedEvent({"frames": 2, "features": 2}))
    lines.receive(PlannedEvent({"frames": 2, "features": 2}))
    assert [line.partition(" ")[2] for line in capsys.readouterr().out.splitlines()] == [
        "frames: 2 of 2 done: 2 ran; 2.0 CPU s",
        "features: 2 of 2 done: 2 ran; 2.0 CPU s",
    ]


def test_cached_tasks_are_counted_but_not_reported(capsys: pytest.CaptureFixture[str]) -> None:
    lines = LogLines("harbour")
    for name in ("gate", "roof"):
        lines.receive(TaskEvent(Task("frames", (name,)), "cached", "t"))
    lines.receive(PlannedEvent({"frames": 2}))
    assert lines.totals == (2, 2)
    assert capsys.readouterr().out == ""
