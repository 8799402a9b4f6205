"""What is kept on disk: as much as the settings say, but never less than the newest and the last good run need."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import pytest

from tests.helpers.toy_site import ToySite
from wbflow.cache.layout import WorkFolder
from wbflow.records.cleanup import clean
from wbflow.records.keep import Keep


@pytest.fixture
def small(tmp_path: Path, toy: ToySite) -> ToySite:
    """A site with two cameras, so that a night takes no time."""
    return ToySite(tmp_path / "small", ["gate", "roof"], backend="threading")


def night(toy: ToySite, day: int, view: str = "", **keep: Any) -> str:
    """Run a night with new captures (or those of `view`); return the run's id."""
    site = json.loads(toy.file.read_text())
    toy.file.write_text(json.dumps({**site, **({"keep": keep} if keep else {})}))
    for camera in toy.cameras:
        toy.capture(camera).write_text(f"{camera} on {view or day}")
    return str(toy.run("--date", f"2026-11-{day:02}")["run"])


def bytes_under(folder: Path) -> int:
    """The size of a folder in whole blocks of 4096 bytes, as du counts it; files with several hard links count once."""
    sizes = {(found := os.lstat(path)).st_ino: found.st_size for path in folder.rglob("*")}
    return sum(-(-size // 4096) * 4096 for size in sizes.values())  # st_blocks includes space preallocated for new files


def test_thirty_nights_take_no_more_space_than_ten(small: ToySite) -> None:
    sizes = {}
    for day in range(1, 31):
        night(small, day, nights=7)
        if day in {10, 30}:
            sizes[day] = bytes_under(small.work)
    assert sizes[30] < 1.1 * sizes[10]
    assert len(WorkFolder(small.work).run_ids()) == 7
    assert small.wbflow("history").stdout.count("2026-11-") == 30, "what they came to is remembered"
    assert small.run("--date", "2026-11-30")["tasks"]["ran"] == 0


def test_a_night_in_which_nothing_ran_takes_almost_no_space(toy: ToySite) -> None:
    toy.run()
    before = bytes_under(toy.work)
    toy.run()
    assert bytes_under(toy.work) - before < 200_000


def test_identical_products_share_their_bytes_and_no_later_write_changes_both(toy: ToySite) -> None:
    first = toy.work / "runs" / toy.run()["run"] / "cloud.ply"
    second = toy.work / "runs" / toy.run()["run"] / "cloud.ply"
    cloud = first.read_bytes()
    assert second.read_bytes() == cloud
    shared = first.stat().st_ino == second.stat().st_ino  # otherwise the file system has made a clone
    assert shared or bytes_under(toy.work / "runs") > 2 * len(cloud)
    assert not first.stat().st_mode & 0o222, "no program may write through one name what the other then shows"
    toy.capture("roof").write_text("another view")
    third = toy.work / "runs" / toy.run()["run"] / "cloud.ply"
    assert third.read_bytes() != cloud
    assert first.read_bytes() == second.read_bytes() == cloud


def test_a_damaged_published_cloud_is_not_shared_with_the_next_run(toy: ToySite) -> None:
    first = toy.work / "runs" / toy.run()["run"] / "cloud.ply"
    cloud = first.read_bytes()
    first.chmod(0o644)
    first.write_bytes(cloud[:-1] + b"x")
    toy.run()
    assert toy.cloud == cloud


def test_clean_removes_published_clouds_and_reports_only_on_request(small: ToySite) -> None:
    runs = [night(small, day) for day in (1, 2, 3)]
    reported = small.wbflow("clean", "--keep", "1").stdout
    assert "and 0 runs" in reported
    assert all((small.work / "runs" / run / "cloud.ply").is_file() for run in runs)
    assert small.run("--date", "2026-11-03")["tasks"]["ran"] == 0
    assert small.wbflow("clean", "--keep", "1", "--clouds", "1", "--reports", "2").returncode == 0
    left = {
        run: sorted(p.suffix for p in (small.work / "runs" / run).glob("*"))
        for run in runs
        if (small.work / "runs" / run).exists()
    }
    assert list(left) == runs[1:]
    assert ".ply" not in left[runs[1]]
    assert ".html" in left[runs[1]]


def test_only_the_newest_run_may_exceed_the_limit_in_bytes(small: ToySite) -> None:
    small.keys = {"pin": "none"}  # a reference would keep its artifacts, too
    small.write()
    night(small, 1)
    one = bytes_under(small.work / "cache")
    for day in (2, 3):
        night(small, day)
    work = WorkFolder(small.work)
    assert clean(work, Keep(bytes=10**9), dry_run=True).files == 0
    assert clean(work, Keep(runs=5), dry_run=True).files == 0, "there are only three"
    limited = clean(work, Keep(bytes=1))
    assert limited.excess_bytes > 0
    assert bytes_under(small.work / "cache") < 1.5 * one
    assert small.run("--date", "2026-11-03")["tasks"]["ran"] == 0


def test_clouds_and_reports_are_kept_as_long_as_the_site_file_says(small: ToySite) -> None:
    runs = [night(small, day, nights=1, clouds="all", reports=2) for day in (1, 2, 3)]
    left = {run: {path.suffix for path in (small.work / "runs" / run).glob("*")} for run in runs}
    assert all(".ply" in suffixes for suffixes in left.values())
    assert [".html" in left[run] for run in runs] == [False, True, True]


def test_the_last_good_run_is_kept_with_all_that_it_uses(small: ToySite) -> None:
    good = night(small, 1, view="the same", nights=1, clouds=1, reports=1)
    small.capture("gate").write_text("broken")
    for day in (2, 3):
        small.run("--date", f"2026-11-{day:02}", code=1)
    assert good in WorkFolder(small.work).run_ids()
    small.capture("gate").write_text("gate on the same")
    assert small.run("--date", "2026-11-04")["tasks"]["ran"] == 0


def test_artifacts_without_a_receipt_are_removed(small: ToySite) -> None:
    night(small, 1)
    orphan = small.work / "cache" / "frames" / "gate" / f"{'0' * 32}.wbf"
    orphan.write_bytes(b"left by an earlier version")
    clean(WorkFolder(small.work), Keep(runs=1))
    assert not orphan.exists()
