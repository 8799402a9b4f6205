"""The command line as a user meets it: fast help, plain error messages, exit codes, no tracebacks."""

from __future__ import annotations

import errno
import json
import os
import re
import subprocess
import sys
import time
from pathlib import Path

import pytest
from click.testing import CliRunner

from tests.helpers.toy_site import ToySite
from wbflow.cache.layout import WorkFolder
from wbflow.cli.main import main
from wbflow.pipeline.exports import EXPORTS
from wbflow.records.run_folder import hold_to_write

COMMANDS = ["run", "status", "check", "report", "history", "clean", "demo", "compare"]


def wbflow(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-m", "wbflow", *arguments], capture_output=True, text=True, timeout=60, check=False)


def test_help_names_every_command_and_loads_nothing_heavy() -> None:
    result = wbflow("--help")
    assert result.returncode == 0
    assert all(command in result.stdout for command in COMMANDS)
    heavy = ("numpy", "yaml", "joblib", "networkx", "pydantic", "rich")
    code = f"import sys, wbflow.cli.main; print([m for m in {heavy} if m in sys.modules])"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert loaded.strip() == "[]"


@pytest.mark.parametrize("command", sorted(main.commands))
def test_the_help_of_every_command_shows_what_to_type(command: str) -> None:
    text = CliRunner().invoke(main, [command, "--help"]).output
    assert re.search(rf"^  wbflow {command}\b", text, re.MULTILINE)


def test_the_help_of_run_shows_defaults() -> None:
    text = " ".join(CliRunner().invoke(main, ["run", "--help"]).output.split())
    assert "[default: processes]" in text
    assert "(all cores)" in text


def test_every_export_of_the_table_is_an_option_with_its_help() -> None:
    text = " ".join(CliRunner().invoke(main, ["export", "--help"], terminal_width=200).output.split())
    assert EXPORTS
    assert all(f"--{row.name} {row.help}" in text for row in EXPORTS)


def test_an_unknown_command_is_refused_with_a_suggestion() -> None:
    result = CliRunner().invoke(main, ["histroy", "site.yaml"])
    assert result.exit_code == 2
    assert "did you mean  wbflow history?" in result.output


def test_check_reports_too_few_cameras_and_misspelt_names(toy: ToySite) -> None:
    toy.cameras[:] = ["door"]
    toy.write()
    assert "1 camera: a cloud needs two or more" in toy.wbflow("check").stdout
    toy.cameras[:] = ["gat", "roof"]
    toy.write()
    printed = toy.wbflow("check").stdout
    assert "camera gat: there is no capture" in printed
    assert "did you mean 'gate'? There are captures of it" in printed


def test_a_run_that_finds_everything_cached_loads_no_vision_libraries(toy: ToySite) -> None:
    toy.run()
    code = (
        "import sys; from wbflow.cli.main import main\n"
        f"try: main(['run', {str(toy.file)!r}])\n"
        "except SystemExit as e:\n"
        "    print(e.code, [m for m in ('scipy', 'numba', 'open3d', 'networkx') if m in sys.modules])"
    )
    result = subprocess.run([sys.executable, "-c", code], env=toy.env(), capture_output=True, text=True, check=True)
    assert result.stdout.splitlines()[-1] == "0 []"


def test_a_site_file_with_errors_ends_with_2_and_writes_nothing(tmp_path: Path) -> None:
    (tmp_path / "site.yaml").write_text("site: s\ncaptures: {pattern: x}\ncameras: [a, a]\nstages: {mtches: {}}\n")
    result = wbflow("run", str(tmp_path))
    assert result.returncode == 2
    assert "site.yaml:3:14: cameras[1]: camera 'a' is named twice" in result.stderr
    assert "did you mean 'matches'?" in result.stderr
    assert [p.name for p in tmp_path.iterdir()] == ["site.yaml"]


def test_a_site_file_that_is_not_there_is_not_to_be_checked(tmp_path: Path) -> None:
    lines = wbflow("run", str(tmp_path / "nowhere.yaml")).stderr.splitlines()
    assert lines[0].endswith("nowhere.yaml: cannot be read: No such file or directory")
    assert lines[1:] == ["  give the path of a site file"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("run", "nowhere.yaml"), "cannot be read"),
        (("run",), "Missing argument"),
        (("run", "SITE", "--until", "coffee"), "there is no such stage"),
        (("run", "SITE", "--force", "coffee"), "name a stage"),
        (("run", "SITE", "--force", "matches roof--gate"), "did you mean 'matches gate--roof'?"),
        (("run", "SITE", "--date", "noon"), "is no day"),
        (("run", "SITE", "--backend", "dask"), "needs --scheduler"),
        (("report", "SITE", "19990101T000000Z"), "no run"),
        (("compare", "nowhere", "nowhere"), "is not the folder of a run"),
        (("fly",), "No such command"),
    ],
)
def test_wrong_usage_ends_with_2_and_no_traceback(toy: ToySite, arguments: tuple[str, ...], message: str) -> None:
    full = [str(toy.file) if a == "SITE" else a for a in arguments]
    result = subprocess.run(toy.command(*full), env=toy.env(), capture_output=True, text=True, check=False)
    assert result.returncode == 2
    assert message in result.stderr
    assert "Traceback" not in result.stderr


def test_an_old_name_in_the_site_file_is_reported_on_screen_and_in_the_log(toy: ToySite) -> None:
    site = json.loads(toy.file.read_text())
    site["stages"]["features"] = {"keypoints": 500}
    toy.file.write_text(json.dumps(site, indent=1))
    printed = toy.wbflow("run", "--until", "frames", "--jobs", "1").stderr
    assert printed.count("'keypoints' is written 'max_keypoints' now") == 1
    log = toy.work / "runs" / "latest" / "log.jsonl"
    warnings = [event for line in log.read_text().splitlines() if (event := json.loads(line))["event"] == "warning"]
    assert [f"{toy.file}:" in event["what"] and "write max_keypoints" in event["remedy"] for event in warnings] == [True]


def test_an_error_in_one_of_several_sites_does_not_stop_the_others(toy: ToySite, tmp_path: Path) -> None:
    wrong, locked = ToySite(tmp_path / "wrong", ["gate"], keys={"cameras": 5}), ToySite(tmp_path / "locked", ["gate"])
    runner = CliRunner()
    with hold_to_write(WorkFolder(locked.work), wait=False):
        files = [str(site.file) for site in (wrong, locked, toy)]
        result = runner.invoke(main, ["run", *files, "--jobs", "1", "--json", "--until", "frames"], env=toy.env())
    assert result.exit_code == 2
    assert [record["site"] for record in json.loads(result.stdout)] == ["toy"]
    assert f"{wrong.file}:" in result.stderr
    assert f"{locked.file}: another run" in result.stderr
    refused = runner.invoke(main, ["run", *files, "--work", str(tmp_path / "work")])
    assert refused.exit_code == 2
    assert "--work is the folder of one site" in refused.output


def test_json_prints_the_record_and_nothing_else(toy: ToySite) -> None:
    toy.capture("roof").write_text("broken")
    result = toy.wbflow("run", "--json", "--jobs", "1")
    record = json.loads(result.stdout)
    assert result.returncode == record["exit_code"] == 3
    assert json.loads((toy.work / "runs" / record["run"] / "run.json").read_text()) == record


def test_a_run_goes_on_if_its_output_pipe_is_closed(toy: ToySite) -> None:
    process = subprocess.Popen(
        toy.command("run", str(toy.file), "--jobs", "1", "-v"),
        env=toy.env(),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout and process.stderr
    process.stdout.close()  # as `| head` does once it has its lines
    assert process.stderr.read() == ""
    assert process.wait(timeout=60) == 0
    assert (toy.work / "runs" / "latest-good" / "cloud.ply").exists()


def test_failures_are_named_on_screen_with_a_traceback_only_if_verbose(toy: ToySite) -> None:
    toy.capture("roof").write_text("broken")
    plain = toy.wbflow("run", "--jobs", "1")
    assert "roof.txt is not an image" in plain.stderr
    assert "Traceback" not in plain.stderr + plain.stdout
    assert "Traceback" in toy.wbflow("run", "--jobs", "1", "-v").stderr


def test_a_fully_cached_run_takes_less_than_a_second_of_cpu_time(toy: ToySite, tmp_path: Path) -> None:
    """If everything is cached, a run takes less than 1 s of CPU time; the engine is compiled already, as after a first call."""
    import resource

    env = {**toy.env(), "PYTHONDONTWRITEBYTECODE": "", "PYTHONPYCACHEPREFIX": str(tmp_path / "compiled")}
    again = toy.command("run", str(toy.file))
    toy.run()
    subprocess.run(again, env=env, capture_output=True, check=True)
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(again, env=env, capture_output=True, check=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    assert (after.ru_utime + after.ru_stime) - (before.ru_utime + before.ru_stime) < 1.0


def test_a_work_folder_that_cannot_be_created_gives_no_traceback(toy: ToySite) -> None:
    (toy.folder / "file").write_text("")
    result = toy.wbflow("run", "--work", str(toy.folder / "file" / "work"))
    assert result.returncode == 1
    assert "Traceback" not in result.stderr
    assert "Not a directory" in result.stderr


def test_check_reports_faulty_captures_with_their_cameras(tmp_path: Path) -> None:
    import cv2
    import numpy as np

    folder = tmp_path / "images"
    folder.mkdir()
    noise = np.random.default_rng(0).integers(0, 255, (48, 64, 3)).astype(np.uint8)
    for name in ("good", "small"):
        cv2.imwrite(str(folder / f"{name}.png"), noise if name == "good" else noise[:24])
    (folder / "text.png").write_text("hello")
    size = "fx: 50.0, fy: 50.0, cx: 32.0, cy: 24.0, width: 64, height: 48"
    cameras = "".join(f"  - {{id: {name}, intrinsics: {{{size}}}}}\n" for name in ("good", "small", "text", "gone"))
    (tmp_path / "site.yaml").write_text(f"site: s\ncaptures: {{root: images, pattern: '{{camera}}.png'}}\ncameras:\n{cameras}")
    result = wbflow("check", str(tmp_path))
    assert result.returncode == 3
    assert "site.yaml:5:5: camera small: small.png is 64x24, its intrinsics are for 64x48" in result.stdout
    assert "camera text: text.png" in result.stdout
    assert "camera gone: there is no capture" in result.stdout
    assert "good" not in result.stdout


def test_report_is_one_file_that_shows_every_camera_and_pair(toy: ToySite) -> None:
    toy.capture("roof").write_text("broken")
    record = toy.run(code=3)
    page = (toy.work / "runs" / record["run"] / "report.html").read_text()
    assert "roof.txt is not an image" in page
    assert "gate--mast-1" in page
    assert "http" not in page.replace("http://www.w3.org", "")


def test_a_report_that_is_built_again_is_the_one_that_the_run_wrote(toy: ToySite) -> None:
    toy.run()
    toy.capture("roof").write_text("broken")
    report = toy.work / "runs" / toy.run(code=3)["run"] / "report.html"
    written = report.read_bytes()
    report.unlink()
    assert toy.wbflow("report").returncode == 0
    assert report.read_bytes() == written


def test_the_option_wait_waits_for_the_other_run(toy: ToySite) -> None:
    toy.fault("slow", "0.1")
    first = subprocess.Popen(toy.command("run", str(toy.file), "--jobs", "1"), env=toy.env(), stdout=subprocess.DEVNULL)
    end = time.monotonic() + 20
    while not (toy.work / "cache" / "frames").exists():
        assert time.monotonic() < end
        time.sleep(0.02)
    second = toy.wbflow("run", "--wait", "--json", "--jobs", "1")
    assert first.wait() == 0
    assert json.loads(second.stdout)["tasks"]["ran"] == 0


@pytest.mark.parametrize("command", [["report"], ["clean", "--keep", "3"]])
@pytest.mark.parametrize("number", [errno.EACCES, errno.EROFS])
def test_a_read_only_work_folder_is_a_plain_error(
    toy: ToySite, monkeypatch: pytest.MonkeyPatch, command: list[str], number: int
) -> None:
    toy.run()
    for name, value in toy.env().items():
        monkeypatch.setenv(name, value)

    def refuse(*_: object, **__: object) -> None:
        raise OSError(number, os.strerror(number), str(toy.work))

    monkeypatch.setattr("wbflow.records.run_folder.write_atomic", refuse)
    monkeypatch.setattr("wbflow.records.run_folder.hold", refuse)
    result = CliRunner().invoke(main, [command[0], str(toy.file), *command[1:]])
    assert result.exit_code == 1
    assert f"{toy.work}: {os.strerror(number)}" in result.output and "check the rights on the work folder" in result.output
    assert "wbflow itself failed" not in result.output
