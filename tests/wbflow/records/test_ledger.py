"""The ledger is only an index: it is rebuilt from the run folders if it is lost or damaged; damage is reported."""

from __future__ import annotations

import sqlite3
from pathlib import Path

import pytest

from tests.wbflow.records.test_run_folder import publish
from wbflow.cache.layout import WorkFolder
from wbflow.records.ledger import Ledger


def test_a_lost_ledger_is_rebuilt_from_the_run_folders(tmp_path: Path) -> None:
    work = WorkFolder(tmp_path)
    publish(work, "20261120T031500Z")
    with Ledger(work) as ledger:
        (run,) = ledger.runs()
        assert (run.run, run.ran, run.points, run.exit_code) == ("20261120T031500Z", 7, 1843201, 3)
        assert ledger.faults == []


def test_a_damaged_ledger_is_rebuilt_and_reported(tmp_path: Path) -> None:
    work = WorkFolder(tmp_path)
    publish(work, "20261120T031500Z")
    work.ledger.write_bytes(b"not a database" * 1000)
    with Ledger(work, writes=True) as ledger:
        assert len(ledger.runs()) == 1
        assert "could not be used" in ledger.faults[0]
    with Ledger(work, writes=True) as ledger:
        assert ledger.faults == []


def full_ledger(work: WorkFolder, runs: int = 3) -> None:
    for k in range(runs):
        publish(work, f"2026112{k}T031500Z")
    with Ledger(work, writes=True):
        pass


def damage_pages(work: WorkFolder) -> None:
    """Damage all pages but the first, which identifies the file as a database."""
    data = bytearray(work.ledger.read_bytes())
    data[4096:] = b"\x5a" * len(data[4096:])
    work.ledger.write_bytes(data)


def test_damaged_pages_are_found_when_read_and_the_ledger_is_rebuilt(tmp_path: Path) -> None:
    work = WorkFolder(tmp_path)
    full_ledger(work)
    damage_pages(work)
    with Ledger(work, writes=True) as ledger:
        assert len(ledger.runs()) == 3
        assert "could not be used" in ledger.faults[0]
    with Ledger(work) as ledger:
        assert (len(ledger.runs()), ledger.faults) == (3, [])


def test_a_reader_does_not_change_the_ledger(tmp_path: Path) -> None:
    work = WorkFolder(tmp_path)
    publish(work, "20261119T031500Z")
    with Ledger(work) as ledger:
        assert len(ledger.runs()) == 1
    assert not work.ledger.exists()
    full_ledger(work)
    damage_pages(work)
    before = work.ledger.read_bytes()
    with Ledger(work) as ledger:
        assert len(ledger.runs()) == 4
        assert "could not be used" in ledger.faults[0]
    assert work.ledger.read_bytes() == before


@pytest.mark.parametrize("writes", [False, True])
def test_a_ledger_locked_by_another_process_is_never_removed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, writes: bool
) -> None:
    monkeypatch.setattr("wbflow.records.ledger._BUSY_TIMEOUT_S", 0.05)
    work = WorkFolder(tmp_path)
    full_ledger(work)
    inode = work.ledger.stat().st_ino
    holder = sqlite3.connect(work.ledger, isolation_level=None)
    holder.execute("pragma locking_mode = exclusive")
    holder.execute("begin exclusive")
    holder.execute("delete from runs where run = 'x'")
    if writes:
        with pytest.raises(sqlite3.OperationalError, match="locked"):
            Ledger(work, writes=True)
    else:
        with Ledger(work) as ledger:
            assert len(ledger.runs()) == 3
    assert work.ledger.stat().st_ino == inode
    holder.execute("commit")
    holder.close()


def test_a_run_that_was_not_indexed_because_of_a_kill_is_added_later(tmp_path: Path) -> None:
    work = WorkFolder(tmp_path)
    full_ledger(work)
    publish(work, "20261129T031500Z")
    with Ledger(work, writes=True) as ledger:
        ledger.catch_up()
        assert [run.run for run in ledger.runs()][-1] == "20261129T031500Z"


def test_an_unreadable_run_is_left_out_and_reported_once(tmp_path: Path) -> None:
    work = WorkFolder(tmp_path)
    publish(work, "20261120T031500Z")
    publish(work, "20261121T031500Z").paths.record.write_text("{")
    with Ledger(work, writes=True) as ledger:
        assert [run.run for run in ledger.runs()] == ["20261120T031500Z"]
        assert "20261121T031500Z" in ledger.faults[0]
    with Ledger(work, writes=True) as ledger:
        assert ledger.faults == [], "it is said once"
