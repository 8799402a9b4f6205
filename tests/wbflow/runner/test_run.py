"""The work of a night: which tasks run, which are not repeated, and what survives kills and damage."""

from __future__ import annotations

import json
import os
import random
import shutil
import signal
import subprocess
import time
from pathlib import Path

import pytest

from tests.helpers.toy_site import ToySite
from wbflow.cache.ply import read_ply

PAIRS = 6


def test_a_run_leaves_cloud_cameras_report_and_record(toy: ToySite) -> None:
    record = toy.run()
    folder = toy.work / "runs" / record["run"]
    left = ["cameras.json", "cloud.ply", "log.jsonl", "metrics.prom", "report.html", "run.json"]
    assert sorted(p.name for p in folder.iterdir()) == left
    assert (toy.work / "runs" / "latest").resolve() == (toy.work / "runs" / "latest-good").resolve() == folder
    assert record["tasks"] == {"cached": 0, "ran": 4 * 3 + 3 + PAIRS * 4 + 1, "rejected": 0, "failed": 0, "skipped": 0}
    assert record["cloud"]["points"] == 2 * PAIRS
    assert [camera["outcome"] for camera in record["cameras"]] == ["ok"] * 4
    assert all(pair["outcome"] == "ok" and pair["density"] == 1.0 for pair in record["pairs"])


def test_the_header_of_a_georeferenced_cloud_states_its_coordinates(toy: ToySite) -> None:
    toy.run()
    assert b"comment crs" not in toy.cloud
    site = json.loads(toy.file.read_text())
    site["cameras"] = [
        {"id": name, "pose": {"latitude": 53.5 + 1e-4 * k, "longitude": 10.0, "height": 20.0}}
        for k, name in enumerate(toy.cameras)
    ]
    toy.file.write_text(json.dumps(site))
    before = read_ply(toy.work / "runs" / "latest-good" / "cloud.ply")
    record = toy.run()
    header = toy.cloud.split(b"end_header")[0].decode().splitlines()
    assert f"comment crs {record['poses']['crs']}" in header
    assert "comment x y z are metres east, north and up of latitude 53.5 longitude 10.0 height 20.0 (WGS 84)" in header
    after = read_ply(toy.work / "runs" / "latest-good" / "cloud.ply")
    assert all((before[name] == after[name]).all() for name in before)


def test_a_second_run_does_nothing_and_publishes_the_same_cloud(toy: ToySite) -> None:
    first = toy.run()
    cloud = toy.cloud
    second = toy.run()
    assert second["tasks"]["ran"] == 0
    assert second["tasks"]["cached"] == first["tasks"]["ran"]
    assert toy.cloud == cloud
    assert first["run"] != second["run"]


def test_a_new_time_stamp_on_the_same_bytes_runs_nothing(toy: ToySite) -> None:
    toy.run()
    for camera in toy.cameras:
        os.utime(toy.capture(camera), (1, 1))
    assert toy.run()["tasks"]["ran"] == 0


def test_a_changed_parameter_runs_exactly_what_depends_on_it(toy: ToySite) -> None:
    toy.run()
    toy.parameters = {"disparity": {"tolerance": 2.0}}
    toy.write()
    toy.run()
    assert {task.split()[0] for task in toy.ran()} == {"disparity", "depth", "fuse"}


def test_tasks_after_a_rerun_with_the_same_result_do_not_run(toy: ToySite) -> None:
    toy.run()
    toy.run("--force", "matches")
    assert {task.split()[0] for task in toy.ran()} == {"matches"}


def test_force_reruns_a_single_task(toy: ToySite) -> None:
    toy.run()
    toy.run("--force", "matches gate--roof")
    assert toy.ran() == {"matches gate--roof"}


def test_a_replaced_capture_runs_only_what_involves_its_camera_and_the_cloud(toy: ToySite) -> None:
    toy.run()
    toy.capture("roof").write_text("another view")
    toy.run()
    ran = toy.ran()
    assert {"frames roof", "matches gate--roof", "fuse"} <= ran
    whole = {"overlap", "pairs", "poses", "depth", "fuse"}  # every other camera is paired with the roof
    assert all("roof" in task or task.split()[0] in whole for task in ran)


def test_a_broken_and_a_missing_capture_cost_only_their_cameras(toy: ToySite) -> None:
    toy.capture("roof").write_text("broken")
    toy.capture("crane").unlink()
    record = toy.run(code=3)
    reasons = {camera["id"]: camera["reason"] for camera in record["cameras"]}
    assert "roof.txt is not an image" in reasons["roof"]
    assert "crane.txt" in reasons["crane"]
    assert reasons["gate"] is None
    assert record["cloud"]["points"] == 2
    assert [(p["left"], p["right"]) for p in record["pairs"]] == [("gate", "mast-1")]


def test_without_captures_there_is_no_cloud_and_the_last_one_stays_published(toy: ToySite) -> None:
    good = toy.run()
    for camera in toy.cameras:
        toy.capture(camera).write_text("broken")
    record = toy.run(code=1)
    assert record["cloud"] is None
    assert (toy.work / "runs" / "latest-good").resolve().name == good["run"]
    assert (toy.work / "runs" / "latest").resolve().name == record["run"]


def test_each_component_of_cameras_gets_a_cloud_of_its_own(toy: ToySite) -> None:
    toy.parameters = {"poses": {"worlds": 2}}
    toy.write()
    record = toy.run()
    assert [cloud["path"] for cloud in record["other_clouds"]] == ["cloud-component-2.ply"]
    assert (toy.work / "runs" / "latest-good" / "cloud-component-2.ply").is_file()
    assert toy.run()["tasks"]["ran"] == 0


def test_a_run_with_one_usable_camera_fails_with_a_reason(toy: ToySite) -> None:
    for camera in toy.cameras[1:]:
        toy.capture(camera).write_text("broken")
    assert "only camera gate has a usable capture" in toy.run(code=1)["reason"]


def test_a_run_without_a_cloud_names_the_first_cause(toy: ToySite) -> None:
    toy.parameters = {"rectify": {"reject": True}}
    toy.write()
    record = toy.run(code=1)
    assert record["reason"].startswith("rectify ") and record["reason"].endswith(": almost no baseline (and 5 more like it)")
    assert "skipped" not in record["reason"]


def test_failed_tasks_are_retried_in_the_next_run_and_rejected_ones_are_not(toy: ToySite) -> None:
    toy.capture("roof").write_text("broken")
    toy.run(code=3)
    toy.run(code=3)
    assert toy.ran() == set()
    assert toy.ran("failed") == {"frames roof"}
    number = str(_first_pixel(b"a view from gate"))
    toy.parameters = {"matches": {"reject": number}}
    toy.write()
    record = toy.run(code=3)
    assert record["tasks"]["rejected"] == 2
    assert "matches" in {task.split()[0] for task in toy.ran()}
    toy.run(code=3)
    assert toy.ran() == set()


def test_a_camera_without_a_usable_pair_is_reported(toy: ToySite) -> None:
    toy.parameters = {"matches": {"reject": str(_first_pixel(b"a view from gate"))}}
    toy.write()
    (finding,) = toy.run(code=3)["verdict"]["findings"]
    assert (finding["kind"], finding["subject"]) == ("camera-no-usable-pair", ["gate"])
    assert "none of its 3 pairs could be used" in finding["text"]


def test_the_number_of_jobs_does_not_change_the_cloud(toy: ToySite) -> None:
    toy.run("--jobs", "1")
    one = toy.cloud
    shutil.rmtree(toy.work)
    result = toy.wbflow("run", "--jobs", "2")
    assert result.returncode == 0, result.stderr
    assert toy.cloud == one


def test_a_damaged_artifact_is_quarantined_and_made_again(toy: ToySite) -> None:
    toy.run()
    cloud = toy.cloud
    for stage in ("frames", "rectify", "fuse"):
        victim = next(p for p in sorted((toy.work / "cache" / stage).rglob("*")) if p.suffix in {".wbf", ".ply"})
        data = bytearray(victim.read_bytes())
        data[-3] ^= 1
        victim.write_bytes(data)
    toy.run("--force", "disparity", "--force", "rectify", "--force", "fuse")
    assert toy.cloud == cloud
    assert any((toy.work / "quarantine").iterdir())


def test_a_damaged_cloud_artifact_is_repaired_even_when_nothing_else_runs(toy: ToySite) -> None:
    toy.keys = {"pin": "none"}  # a reference would restore its copy instead
    toy.write()
    toy.run()
    cloud = toy.cloud
    victim = next((toy.work / "cache" / "fuse").rglob("*.ply"))
    data = bytearray(victim.read_bytes())
    data[-1] ^= 1
    victim.write_bytes(data)
    toy.run()
    assert toy.cloud == cloud
    assert toy.ran() == {"fuse"}


def test_losing_the_ledger_loses_no_history(toy: ToySite) -> None:
    first = toy.run()
    for file in toy.work.glob("ledger.sqlite*"):
        file.unlink()
    second = toy.run()
    assert second["tasks"]["ran"] == 0
    history = toy.wbflow("history").stdout
    assert first["run"] in history
    assert second["run"] in history


def test_until_stops_after_the_given_stage_without_a_cloud(toy: ToySite) -> None:
    record = toy.run("--until", "geometry")
    assert record["cloud"] is None
    assert {task.split()[0] for task in toy.ran()} == {"frames", "features", "overlap", "pairs", "matches", "geometry"}


def test_a_run_until_a_stage_without_a_result_fails(toy: ToySite) -> None:
    for camera in toy.cameras[1:]:
        toy.capture(camera).unlink()
    record = toy.run("--until", "poses", code=1)
    (found,) = [finding for finding in record["verdict"]["findings"] if finding["kind"] == "no-result"]
    assert record["verdict"]["level"] == "failed" and found["text"].startswith("no poses: ")


def test_dry_run_writes_nothing_and_gives_reasons(toy: ToySite) -> None:
    assert "never run" in toy.wbflow("run", "--dry-run").stdout
    assert not toy.work.exists()
    toy.run()
    toy.parameters = {"disparity": {"tolerance": 2.0}}
    toy.write()
    reported = toy.wbflow("status").stdout
    assert "parameter disparity.tolerance 1.0 → 2.0" in reported
    assert "fuse                             would run: 4 of" in reported


def test_a_second_run_at_the_same_time_is_refused_with_code_4(toy: ToySite) -> None:
    toy.fault("slow", "0.3")
    first = subprocess.Popen(toy.command("run", str(toy.file), "--jobs", "1"), env=toy.env(), stdout=subprocess.DEVNULL)
    try:
        _wait_for(toy.work / "cache" / "frames")
        second = toy.wbflow("run")
        assert second.returncode == 4
        assert f"process {first.pid}" in second.stderr
    finally:
        first.kill()
        first.wait()


@pytest.mark.parametrize("sent", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_run_keeps_what_is_finished(toy: ToySite, sent: signal.Signals) -> None:
    toy.fault("slow", "0.1")
    process = subprocess.Popen(
        toy.command("run", str(toy.file), "--jobs", "2"),
        env=toy.env(),
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=_heed_interrupts,
    )
    _wait_for(toy.work / "cache" / "geometry")
    process.send_signal(sent)
    assert process.wait(timeout=30) == 130
    assert process.stderr is not None
    assert "Traceback" not in process.stderr.read()
    (toy.folder / "faults" / "slow").unlink()
    record = toy.run()
    assert record["tasks"]["cached"] >= 8
    assert record["tasks"]["ran"] > 0


def test_kills_at_any_moment_do_not_change_the_cloud(toy: ToySite) -> None:
    toy.run()
    cloud = toy.cloud
    shutil.rmtree(toy.work)
    toy.fault("slow", "0.05")
    moments = random.Random(3)
    for _ in range(6):
        command = toy.command("run", str(toy.file), "--jobs", "2")
        process = subprocess.Popen(command, env=toy.env(), start_new_session=True, stdout=subprocess.DEVNULL)
        time.sleep(moments.uniform(0.4, 2.0))
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
    toy.run()
    assert toy.cloud == cloud
    assert not list((toy.work / "cache").rglob("*.tmp"))
    assert not list((toy.work / "runs").glob(".*"))


def test_a_task_whose_worker_is_killed_once_is_repeated(toy: ToySite) -> None:
    toy.fault("once", "matches")
    result = toy.wbflow("run", "--jobs", "2")
    assert result.returncode == 0, result.stderr


def test_a_task_that_always_kills_its_worker_fails_and_other_results_are_kept(toy: ToySite) -> None:
    toy.fault("die", "poses")
    result = toy.wbflow("run", "--jobs", "2")
    assert result.returncode == 1
    assert "killed" in result.stderr
    assert (toy.work / "cache" / "geometry").exists()


def test_clean_keeps_what_the_last_runs_use(toy: ToySite) -> None:
    toy.keys = {"pin": "none"}  # a reference would keep its artifacts, too
    toy.write()
    toy.run()
    toy.parameters = {"features": {"offset": 3.0}}
    toy.write()
    toy.run()
    before = len(list((toy.work / "cache").rglob("*.wbf")))
    assert "would remove" in toy.wbflow("clean", "--keep", "1", "--dry-run").stdout
    toy.wbflow("clean", "--keep", "1")
    assert len(list((toy.work / "cache").rglob("*.wbf"))) < before
    assert toy.run()["tasks"]["ran"] == 0


def test_compare_shows_what_differs(toy: ToySite) -> None:
    a = toy.run()["run"]
    toy.capture("roof").write_text("broken")
    b = toy.run(code=3)["run"]
    runs = toy.work / "runs"
    command = toy.command("compare", str(runs / a), str(runs / b))
    reported = subprocess.run(command, env=toy.env(), capture_output=True, text=True, check=True).stdout
    assert "roof" in reported
    assert "not an image" in reported


def _first_pixel(data: bytes) -> int:
    import hashlib

    return hashlib.sha256(data).digest()[0]


def _heed_interrupts() -> None:
    """Restore SIGINT: tests started in the background of a shell ignore it, and child processes inherit this."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def _wait_for(path: Path, seconds: float = 20.0) -> None:
    end = time.monotonic() + seconds
    while not path.exists():
        assert time.monotonic() < end, f"{path} never came"
        time.sleep(0.02)
