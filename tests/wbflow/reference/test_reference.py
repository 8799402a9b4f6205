"""The pinned reference: later nights reuse its results, and no night changes it."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import signal
import subprocess
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from tests.helpers.toy_site import HELPERS, ToySite
from wbflow.cache import atomic, checksum
from wbflow.cache import store as cache
from wbflow.cache.layout import WorkFolder
from wbflow.cache.store import Cache
from wbflow.records import reference as reference
from wbflow.reference import folder
from wbflow.site.load import load_site
from wbflow.task import Task

GEOMETRY = {"features", "matches", "geometry", "poses", "rectify", "overlap", "pairs"}
FIRST, SECOND, THIRD = "2026-11-01", "2026-11-02", "2026-11-03"


@pytest.fixture(autouse=True)
def toy_stages(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(HELPERS))


@pytest.fixture
def toy(tmp_path: Path) -> ToySite:
    """A site with three cameras whose first night is pinned."""
    site = ToySite(tmp_path, ["a", "b", "c"], watched=True, dated=True, backend="threading")
    site.run("--date", FIRST)
    return site


def ran(site: ToySite) -> set[str]:
    """The tasks of pinned stages that the last run executed."""
    return {task for task in site.ran() if task.split(" ")[0] in GEOMETRY}


def record_of(site: ToySite) -> Path:
    return WorkFolder(site.work).reference_record


def camera(record: dict[str, Any], name: str) -> dict[str, Any]:
    found: dict[str, Any] = next(c for c in record["cameras"] if c["id"] == name)
    return found


def test_the_first_good_run_is_pinned_automatically_and_listed(toy: ToySite) -> None:
    pinned = json.loads(record_of(toy).read_text())
    assert pinned["date"] == FIRST
    assert pinned["pinned"] == "automatically"
    assert {name: bool(solved) for name, solved in pinned["cameras"].items()} == {"a": True, "b": True, "c": True}
    listed = toy.wbflow("pin", "--list").stdout
    assert pinned["run"] in listed
    assert "a--b" in listed


def test_a_second_night_runs_no_geometry(toy: ToySite) -> None:
    toy.night(SECOND)
    record = toy.run("--date", SECOND)
    assert ran(toy) == set()
    assert {task.split(" ")[0] for task in toy.ran()} == {"frames", "health", "disparity", "depth", "fuse"}
    assert record["reference"] == json.loads(record_of(toy).read_text())["run"]
    assert camera(record, "a")["health"]["state"] == "ok"


def test_repeating_the_night_of_the_reference_runs_nothing(toy: ToySite) -> None:
    cloud = toy.cloud
    assert toy.run("--date", FIRST)["tasks"]["ran"] == 0
    assert toy.cloud == cloud


def test_a_shifted_camera_is_solved_anew_and_only_its_pairs_are_rectified(toy: ToySite) -> None:
    toy.night(SECOND, b="shifted")
    toy.run("--date", SECOND, code=None)
    assert ran(toy) == {"poses", "geometry a--b", "geometry b--c", "rectify a--b", "rectify b--c"}


def test_a_moved_camera_is_matched_with_the_others_and_solved_anew(toy: ToySite) -> None:
    toy.night(SECOND, c="moved")
    toy.run("--date", SECOND, code=None)
    around_c = {f"{stage} {pair}" for stage in ("matches", "geometry", "rectify") for pair in ("a--c", "b--c")}
    assert ran(toy) - {f"rectify {pair}" for pair in ("a--c", "b--c")} <= {"poses", "features c", *around_c}
    assert {"features c", "matches a--c", "geometry b--c"} <= ran(toy)


@pytest.mark.parametrize("state", ["obscured", "wrong-scene"])
def test_an_obscured_camera_or_a_wrong_scene_loses_only_its_own_pairs(toy: ToySite, state: str) -> None:
    toy.night(SECOND, c=state)
    record = toy.run("--date", SECOND, code=3)
    assert ran(toy) == set()
    outcomes = {f"{p['left']}--{p['right']}": p["outcome"] for p in record["pairs"]}
    assert outcomes == {"a--b": "ok", "a--c": "skipped", "b--c": "skipped"}
    assert camera(record, "c")["health"]["state"] == state
    assert state in next(p["reason"] for p in record["pairs"] if p["right"] == "c")
    assert record["cloud"]["points"] > 0


def test_the_order_and_repetition_of_nights_change_no_reference_and_no_cloud(toy: ToySite) -> None:
    before = record_of(toy).read_bytes()
    clouds: dict[str, bytes] = {}
    for date in (THIRD, SECOND, FIRST, SECOND, THIRD):
        toy.night(date) if date != FIRST else None
        toy.run("--date", date)
        assert clouds.setdefault(date, toy.cloud) == toy.cloud
    assert record_of(toy).read_bytes() == before


def test_killed_and_repeated_nights_make_the_same_clouds_and_reference(toy: ToySite) -> None:
    dates = (FIRST, SECOND, THIRD)
    whole = []
    for date in dates:
        toy.night(date, b="shifted" if date == SECOND else "ok") if date != FIRST else None
        toy.run("--date", date, code=None)
        whole.append(toy.cloud)
    kept = {task: pinned.digest for task, pinned in _artifacts(toy).items()}
    shutil.rmtree(toy.work)
    for date, stage, expected in zip(dates, ("fuse", "rectify", "health"), whole, strict=True):
        toy.fault("slow", "0.02")
        command = toy.command("run", str(toy.file), "--jobs", "1", "--date", date)
        process = subprocess.Popen(command, env=toy.env(), start_new_session=True, stdout=subprocess.DEVNULL)
        deadline = time.monotonic() + 60
        while process.poll() is None and not list((toy.work / "cache" / stage).glob("*/*.json")) and time.monotonic() < deadline:
            time.sleep(0.01)
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        (toy.folder / "faults" / "slow").unlink()
        toy.run("--date", date, code=None)
        assert toy.cloud == expected
    assert {task: pinned.digest for task, pinned in _artifacts(toy).items()} == kept


def _artifacts(toy: ToySite) -> Mapping[Task, reference.PinnedArtifact]:
    pinned = reference.read_reference(WorkFolder(toy.work))
    return pinned.artifacts if pinned else {}


def test_the_health_of_a_camera_uses_earlier_nights(toy: ToySite) -> None:
    seen = []
    for date in (SECOND, THIRD):
        toy.night(date)
        seen.append(camera(toy.run("--date", date), "a")["health"]["figures"]["nights"])
    assert seen == [0, 1]


def test_the_reference_is_used_even_if_the_cache_was_deleted(toy: ToySite) -> None:
    shutil.rmtree(toy.work / "cache")
    toy.night(SECOND)
    toy.run("--date", SECOND)
    assert ran(toy) == set()


def test_clean_leaves_the_reference_usable(toy: ToySite) -> None:
    for date in (SECOND, THIRD):
        toy.night(date)
        toy.run("--date", date)
    toy.wbflow("clean", "--keep", "1")
    toy.night("2026-11-04")
    toy.run("--date", "2026-11-04")
    assert ran(toy) == set()


def test_a_night_makes_a_cloud_despite_a_damaged_reference_artifact(toy: ToySite) -> None:
    work = WorkFolder(toy.work)
    pinned = reference.read_reference(work)
    assert pinned is not None
    task = next(task for task in pinned.artifacts if task.stage == "frames" and task.subject == ("b",))
    file = work.artifact(task, pinned.artifacts[task].key, ".wbf")
    data = bytearray(file.read_bytes())
    data[-3] ^= 1
    for each in (file, work.pinned(file)):
        each.write_bytes(data)
    toy.night(SECOND)
    assert toy.run("--date", SECOND)["cloud"]["points"] > 0


def test_a_reference_with_other_settings_is_not_used_and_this_is_logged(toy: ToySite) -> None:
    toy.parameters["matches"] = {"shift": 2.0}
    toy.write()
    toy.night(SECOND)
    toy.run("--date", SECOND)
    assert {"matches a--b", "poses"} <= ran(toy)
    newest = WorkFolder(toy.work).run(WorkFolder(toy.work).run_ids()[-1])
    assert "matches.shift 1.0" in newest.log.read_text()


def test_changed_settings_of_unpinned_stages_keep_the_reference_in_use(toy: ToySite) -> None:
    toy.parameters["disparity"] = {"tolerance": 2.0}
    toy.write()
    toy.night(SECOND)
    toy.run("--date", SECOND)
    assert ran(toy) == set()


def test_forced_tasks_run_despite_the_reference(toy: ToySite) -> None:
    toy.night(SECOND)
    toy.run("--date", SECOND, "--force", "rectify")
    assert ran(toy) == {"rectify a--b", "rectify a--c", "rectify b--c"}


def test_pin_none_disables_the_reference(tmp_path: Path) -> None:
    site = ToySite(tmp_path, ["a", "b"], watched=True, dated=True, keys={"pin": "none"})
    for date in (FIRST, SECOND):
        site.night(date)
        record = site.run("--date", date)
    assert not record_of(site).exists()
    assert record["reference"] is None
    assert "matches a--b" in ran(site)


def test_another_run_is_pinned_by_hand_and_dropped(toy: ToySite) -> None:
    toy.night(SECOND)
    second = toy.run("--date", SECOND)["run"]
    assert toy.wbflow("pin", second).returncode == 0
    pinned = json.loads(record_of(toy).read_text())
    assert (pinned["run"], pinned["pinned"]) == (second, "by hand")
    toy.night(THIRD)
    toy.run("--date", THIRD)
    assert ran(toy) == set()
    assert toy.wbflow("pin", "--drop").returncode == 0
    assert not WorkFolder(toy.work).reference.exists()


def test_refine_pools_the_depth_of_several_nights_into_the_reference(toy: ToySite) -> None:
    early = toy.wbflow("pin", "--refine")
    assert early.returncode == 2
    assert "fewer than 3 nights" in early.stderr
    for date in (SECOND, THIRD):
        toy.night(date, c="shifted" if date == THIRD else "ok")
        toy.run("--date", date, code=None)
    before = reference.read_reference(WorkFolder(toy.work))
    pooled = toy.wbflow("pin", "--refine")
    after = reference.read_reference(WorkFolder(toy.work))
    assert before is not None
    assert after is not None
    changed = {task for task in after.artifacts if after.artifacts[task] != before.artifacts[task]}
    assert {str(task) for task in changed} == {"depth a", "depth b"}  # c was shifted on one night, so too few nights are left
    assert "depth a: pooled from 3 nights" in pooled.stdout
    toy.night("2026-11-04")
    toy.run("--date", "2026-11-04")
    assert ran(toy) == set()


def test_pooling_in_any_order_twice_or_after_a_kill_makes_the_same_reference(
    toy: ToySite, monkeypatch: pytest.MonkeyPatch
) -> None:
    from wbflow.reference.aggregate import aggregate_nights

    work, site = WorkFolder(toy.work), load_site(toy.file)
    for date in (SECOND, THIRD):
        toy.night(date)
        toy.run("--date", date)
    old = reference.read_reference(work)
    assert old is not None
    shutil.copytree(work.reference, toy.folder / "before")
    done = aggregate_nights(work, old, site)
    new, once = reference.read_reference(work), {path.name: path.read_bytes() for path in work.reference.rglob("*.json")}
    assert {str(task) for task in done} == {"depth a", "depth b", "depth c"}
    assert new is not None and aggregate_nights(work, new, site) == done
    assert {path.name: path.read_bytes() for path in work.reference.rglob("*.json")} == once
    shutil.rmtree(work.reference)
    shutil.copytree(toy.folder / "before", work.reference)
    for task in done:
        shutil.rmtree(Path(work.receipt(task, new.artifacts[task].key)).parent)
    for date in (THIRD, SECOND, THIRD, FIRST):
        toy.run("--date", date)
    functions = {(cache, "write_atomic"): atomic.write_atomic, (cache, "write_checksummed"): checksum.write_checksummed}
    functions |= {(folder, "write_atomic"): atomic.write_atomic}
    for last in (1, 2, 4, 6, 7, 30, 1000):  # 1000 steps are never reached, so the last one is not interrupted
        steps = iter(range(1000))
        for (module, name), function in functions.items():
            monkeypatch.setattr(module, name, _dying(function, steps, last))
        with contextlib.nullcontext() if last == 1000 else pytest.raises(KeyboardInterrupt):
            aggregate_nights(work, old, site)
        assert reference.read_reference(work) == (new if last == 1000 else old)


def test_matches_too_few_on_single_nights_suffice_when_pooled(tmp_path: Path) -> None:
    """Camera c is not placed, since its pairs need three matches and have one per night; three nights together have three."""
    lens = {"fx": 9, "fy": 9, "cx": 4, "cy": 4, "width": 8, "height": 8}
    stand = {"look_at": [0, 9, 0]}
    placed = [{"id": n, "intrinsics": lens, "pose": {"position": [k, 0, 0], **stand}} for k, n in enumerate("ab")]
    parameters: dict[str, dict[str, Any]] = {
        "geometry": {"needed": 3}, "poses": {"leave_out": "c"}, "rectify": {"use": "toy_stages:rectify_known"},
    }  # fmt: skip
    known = {"cameras": [*placed, {"id": "c"}]}
    toy = ToySite(tmp_path, ["a", "b", "c"], parameters, keys=known, watched=True, dated=True, backend="threading")
    first = toy.run("--date", FIRST, code=3)
    assert {pair["outcome"] for pair in first["pairs"] if pair["right"] == "c"} == {"rejected"}
    assert toy.wbflow("pin", first["run"]).returncode == 0
    for date, state in ((SECOND, "ok"), (THIRD, "moved"), ("2026-11-04", "ok")):
        toy.night(date, c=state)
        toy.run("--date", date, code=3)
    printed = toy.wbflow("pin", "--refine").stdout
    assert "matches a--c: pooled from 3 nights" in printed, "what c saw from elsewhere is no evidence"
    assert "geometry b--c: pooled from 3 nights" in printed
    for date, state, matches in (("2026-11-05", "ok", 3), ("2026-11-06", "moved", 1)):
        toy.night(date, c=state)
        record = toy.run("--date", date, code=None)
        pair = next(p for p in record["pairs"] if (p["left"], p["right"]) == ("a", "c"))
        assert (pair["matches"], "matches a--c" in ran(toy)) == (matches, state == "moved")


def test_a_run_without_a_cloud_cannot_be_pinned(toy: ToySite) -> None:
    run = toy.run("--date", FIRST, "--until", "poses")["run"]
    answer = toy.wbflow("pin", run)
    assert answer.returncode == 2
    assert "made no cloud" in answer.stderr


def test_a_kill_while_pinning_leaves_the_old_reference_or_the_new_one(toy: ToySite, monkeypatch: pytest.MonkeyPatch) -> None:
    from wbflow.reference.create import good_run, pin

    work = WorkFolder(toy.work)
    toy.night(SECOND)
    second = toy.run("--date", SECOND)["run"]
    old = reference.read_reference(work)
    for last in range(40):
        monkeypatch.setattr(folder, "write_atomic", _dying(atomic.write_atomic, iter(range(1000)), last))
        try:
            pin(Cache(work), good_run(work, second))
            break
        except KeyboardInterrupt:
            assert reference.read_reference(work) == old
            assert all(work.pinned(work.receipt(t, p.key)).is_file() for t, p in old.artifacts.items()) if old else False
    monkeypatch.undo()
    pin(Cache(work), good_run(work, second))
    now = reference.read_reference(work)
    assert now is not None
    assert now.run == second
    files = [path for path in work.reference.rglob("*") if path.is_file()]
    assert len(files) == 2 + sum(2 if pinned.digest else 1 for pinned in now.artifacts.values())


def _dying(function: Any, steps: Any, last: int) -> Any:
    def do(*arguments: Any, **options: Any) -> Any:
        if next(steps) >= last:
            raise KeyboardInterrupt
        return function(*arguments, **options)

    return do


@pytest.mark.parametrize("victim", ["reference.json", "reference-twin.json", "a pinned result", "the same in the cache"])
def test_damaged_files_of_the_reference_are_repaired(toy: ToySite, victim: str) -> None:
    work = WorkFolder(toy.work)
    pinned = _artifacts(toy)[Task("features", ("a",))]
    in_cache = work.artifact(pinned.task, pinned.key, ".wbf")
    names = {"a pinned result": work.pinned(in_cache), "the same in the cache": in_cache}
    file = names.get(victim, work.reference / victim)
    before = {path: path.read_bytes() for path in (file, work.reference_record)}
    toy.night(SECOND)
    file.write_bytes(before[file][:-1])
    record = toy.run("--date", SECOND)
    assert ran(toy) == set(), "the reference answers for the geometry as if nothing had been"
    assert record["repaired"]
    assert {path: path.read_bytes() for path in before} == before
    assert not toy.run("--date", SECOND)["repaired"]


def test_a_pipe_in_place_of_the_reference_record_is_replaced_by_its_twin(toy: ToySite) -> None:
    file = WorkFolder(toy.work).reference_record
    before = file.read_bytes()
    file.unlink()
    os.mkfifo(file)
    toy.night(SECOND)
    assert "is a pipe" in " ".join(toy.run("--date", SECOND)["repaired"])
    assert ran(toy) == set()
    assert file.read_bytes() == before


def test_the_next_good_night_is_pinned_if_the_reference_record_is_lost(toy: ToySite) -> None:
    work = WorkFolder(toy.work)
    for path in (work.reference_record, work.reference_twin):
        path.write_bytes(path.read_bytes().replace(b"2026", b"2025", 1))
    toy.night(SECOND)
    record = toy.run("--date", SECOND)
    assert "the next good night becomes the reference" in " ".join(record["repaired"])
    now = reference.read_reference(work)
    assert now is not None and now.run == record["run"]
