"""A full disk costs one night at most: the error states the space needed and free, and finished results are kept."""

from __future__ import annotations

import errno
import json
import os
import stat
from pathlib import Path

import pytest

import wbflow
from tests.helpers.toy_site import ToySite
from wbflow.cache.atomic import write_atomic
from wbflow.cache.layout import WorkFolder
from wbflow.errors import UsageError
from wbflow.runner.disk import bytes_of_sizes


def test_a_full_disk_error_states_the_needed_and_the_free_space(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(descriptor: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("wbflow.cache.atomic.free_bytes", lambda folder: 12_000)
    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match=r"the disk is full: 3.4 MB needed, 12 kB free") as raised:
        write_atomic(tmp_path / "a", b"x" * 3_400_000)
    assert raised.value.errno == errno.ENOSPC
    assert list(tmp_path.iterdir()) == []


def test_no_task_starts_without_disk_space_for_its_results(toy: ToySite, monkeypatch: pytest.MonkeyPatch) -> None:
    toy.run()
    cloud = toy.cloud
    toy.parameters = {"disparity": {"tolerance": 2.0}}
    toy.write()
    with monkeypatch.context() as full:
        full.setattr("wbflow.runner.limits.free_bytes", lambda folder: 1_000_000)
        record = toy.run(code=1)
    assert toy.ran() == set()
    assert "16.0 MB needed to go on, 1.0 MB free" in record["reason"]
    assert record["code"] == "disk-full"
    toy.run()
    assert {task.split()[0] for task in toy.ran()} == {"disparity", "depth", "fuse"}
    assert toy.cloud != cloud


def test_finished_results_survive_a_disk_that_fills_up_during_a_run(toy: ToySite, monkeypatch: pytest.MonkeyPatch) -> None:
    toy.run()
    cloud = toy.cloud
    toy.run("--force", "frames")
    fresh = ToySite(toy.folder.parent / "fresh", toy.cameras)
    replace, left = os.replace, iter(range(60))

    def fills_up(temporary: str, path: Path) -> None:
        if next(left, None) is None:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        replace(temporary, path)

    with monkeypatch.context() as full:
        full.setattr(os, "replace", fills_up)
        from click.testing import CliRunner

        from wbflow.cli.main import main

        result = CliRunner().invoke(
            main, ["run", str(fresh.file), "--backend", "threading", "--jobs", "1", "-q"], env=fresh.env()
        )
    assert result.exit_code == 1
    assert "the disk is full" in result.output
    record = fresh.run()
    assert record["tasks"]["cached"] >= 15
    assert fresh.cloud == cloud


def refuse_links(monkeypatch: pytest.MonkeyPatch, number: int = errno.EOPNOTSUPP) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(os, "symlink", refuse)
    monkeypatch.setattr(os, "link", refuse)


@pytest.mark.parametrize("number", [errno.EOPNOTSUPP, errno.EPERM, errno.ENOSYS])
def test_a_disk_without_links_has_files_that_name_the_latest_runs(
    toy: ToySite, monkeypatch: pytest.MonkeyPatch, number: int
) -> None:
    refuse_links(monkeypatch, number)
    first = toy.run()["run"]
    latest = toy.work / "runs" / "latest"
    assert latest.read_text().strip() == first
    assert not latest.is_symlink()
    second = toy.run()["run"]
    assert latest.read_text().strip() == (toy.work / "runs" / "latest-good").read_text().strip() == second
    listed = json.loads(toy.wbflow("history", "--json").stdout)
    assert [entry["run"] for entry in listed] == [first, second] or [entry["run"] for entry in listed] == [second, first]


def test_files_that_name_runs_become_links_where_the_disk_has_them(toy: ToySite, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as without:
        refuse_links(without)
        toy.run()
    second = toy.run()["run"]
    assert (toy.work / "runs" / "latest").readlink().name == second


def test_a_folder_that_cannot_be_synced_is_written_all_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sync = os.fsync

    def only_files(descriptor: int) -> None:
        if stat.S_ISDIR(os.fstat(descriptor).st_mode):
            raise OSError(errno.EINVAL, os.strerror(errno.EINVAL))
        sync(descriptor)

    monkeypatch.setattr(os, "fsync", only_files)
    write_atomic(tmp_path / "a", b"x")
    assert (tmp_path / "a").read_bytes() == b"x"


def test_cameras_whose_names_differ_in_case_are_refused_where_the_disk_ignores_it(
    toy: ToySite, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    site = ToySite(tmp_path / "other", ["gate", "Gate"])
    monkeypatch.setattr(WorkFolder, "folds_case", lambda work: True)
    with pytest.raises(UsageError, match="gate and Gate would share a folder"):
        wbflow.run(site.file, backend="threading", jobs=1)
    wbflow.run(toy.file, backend="threading", jobs=1)


def test_a_full_disk_is_one_finding_with_what_is_free_and_what_a_night_takes(
    toy: ToySite, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("wbflow.runner.limits.free_bytes", lambda folder: 1_000_000)
    monkeypatch.setattr("wbflow.verdict.rules.free_bytes", lambda folder: 1_000_000)
    record = toy.run(code=1)
    (finding,) = record["verdict"]["findings"]
    assert finding["kind"] == "disk-full"
    assert "1.0 MB free, a night of this site takes about" in finding["text"]
    assert finding["figures"]["tasks"] == 4
    assert finding["expected"]["free_bytes"] > 1_000_000
    assert "wbflow clean" in finding["remedy"]


@pytest.mark.parametrize(("size", "resolution", "scaled"), [((320, 180), 1600, (320, 180)), ((3200, 1800), 1600, (1600, 900))])
def test_the_space_of_a_night_is_estimated_at_working_resolution(
    size: tuple[int, int], resolution: int, scaled: tuple[int, int]
) -> None:
    assert bytes_of_sizes([size], resolution) == bytes_of_sizes([scaled], None)


def test_a_small_night_needs_megabytes_not_gigabytes() -> None:
    assert 10e6 < bytes_of_sizes([(320, 180)] * 4, 1600) < 30e6
