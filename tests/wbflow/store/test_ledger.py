"""The ledger is an index: lost or damaged, it is made again, and says so."""

from __future__ import annotations

from pathlib import Path

from tests.wbflow.store.test_run_folder import publish
from wbflow.store.layout import WorkFolder
from wbflow.store.ledger import Ledger


def test_a_lost_ledger_is_made_again_from_what_it_indexes(tmp_path: Path) -> None:
    work = WorkFolder(tmp_path)
    publish(work, "20261120T031500Z")
    with Ledger(work) as ledger:
        (run,) = ledger.runs()
        assert (run.run, run.ran, run.points, run.exit_code) == ("20261120T031500Z", 7, 1843201, 3)
        assert ledger.keys_of_runs([run.run]) == {"ab"}
        assert ledger.faults == []


def test_a_damaged_ledger_is_made_again_and_says_so(tmp_path: Path) -> None:
    work = WorkFolder(tmp_path)
    publish(work, "20261120T031500Z")
    work.ledger.write_bytes(b"not a database" * 1000)
    with Ledger(work) as ledger:
        assert len(ledger.runs()) == 1
        assert "was damaged" in ledger.faults[0]


def test_a_run_that_cannot_be_read_is_left_out_and_named(tmp_path: Path) -> None:
    work = WorkFolder(tmp_path)
    publish(work, "20261120T031500Z")
    publish(work, "20261121T031500Z").paths.record.write_text("{")
    with Ledger(work) as ledger:
        assert [run.run for run in ledger.runs()] == ["20261120T031500Z"]
        assert "20261121T031500Z" in ledger.faults[0]
