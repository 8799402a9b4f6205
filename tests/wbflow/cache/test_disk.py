"""A full disk costs one night at most: the error states the space needed and free, and finished results are kept."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest

from tests.helpers.toy_site import ToySite
from wbflow.cache.atomic import write_atomic


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
