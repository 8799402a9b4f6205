"""The ledger: an SQLite index of runs, tasks and artifacts.  Not the truth: deleted, it is rebuilt from run.json and receipts."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterable
from dataclasses import astuple, dataclass, fields

from .cache import Cache, Receipt
from .events import TaskEvent
from .layout import WorkFolder
from .record import RunRecord
from .run_folder import NoSuchRun, RunFolder

_SCHEMA = """
create table if not exists runs (
    run text primary key, date text, started text, finished text, wall real, cpu real,
    cached integer, ran integer, rejected integer, failed integer, skipped integer, points integer, exit_code integer);
create table if not exists uses (run text, artifact text, outcome text, reason text, task text, primary key (run, task));
create table if not exists artifacts (
    artifact text primary key, task text, stage text, outcome text,
    digest text, bytes integer, wall real, cpu real, finished text);
create index if not exists uses_artifact on uses (artifact);
"""


@dataclass(frozen=True)
class LedgerRun:
    """A run as the ledger knows it: the columns of its table."""

    run: str
    date: str
    started: str
    finished: str
    wall: float
    cpu: float
    cached: int
    ran: int
    rejected: int
    failed: int
    skipped: int
    points: int | None
    """Of the cloud; None where there is none."""
    exit_code: int


class Ledger:
    """The ledger of one work folder; a context manager.  Whoever opens it can meet sqlite3.Error and OSError."""

    def __init__(self, work: WorkFolder) -> None:
        self.faults: list[str] = []
        """What was wrong with it and has been put right, or left out, in words."""
        self._work = work
        fresh = not work.ledger.exists()
        try:
            self._db = self._open()
        except sqlite3.DatabaseError as error:
            self.faults.append(f"{work.ledger} was damaged ({error}): made again from receipts and records")
            for path in work.ledger_files():
                path.unlink(missing_ok=True)
            fresh = True
            self._db = self._open()
        if fresh:
            self._rebuild()

    def __enter__(self) -> Ledger:
        return self

    def __exit__(self, *error: object) -> None:
        self._db.close()

    def record_artifacts(self, receipts: Iterable[Receipt]) -> None:
        """Index finished tasks."""
        rows = [(r.key, r.task, r.preimage.stage, r.outcome, r.digest, r.bytes, r.wall, r.cpu, r.finished) for r in receipts]
        with self._db:
            self._db.executemany("insert or replace into artifacts values (?,?,?,?,?,?,?,?,?)", rows)

    def record_run(self, record: RunRecord, tasks: Iterable[TaskEvent]) -> None:
        """Index a run, and what each of its tasks used."""
        seconds, counts = record.seconds, record.tasks
        times = (record.started, record.finished, round(seconds.wall, 2), round(seconds.cpu, 2))
        ended = (counts.cached, counts.ran, counts.rejected, counts.failed, counts.skipped)
        points = record.cloud.points if record.cloud else None
        row = astuple(LedgerRun(record.run, record.date, *times, *ended, points, int(record.exit_code)))
        with self._db:
            self._db.execute(f"insert or replace into runs values ({','.join('?' * len(row))})", row)
            self._db.executemany(
                "insert or replace into uses values (?,?,?,?,?)",
                [(record.run, task.key, task.outcome, task.reason, str(task.task)) for task in tasks],
            )

    def runs(self) -> list[LedgerRun]:
        """Every run, oldest first."""
        columns = ", ".join(field.name for field in fields(LedgerRun))
        return [LedgerRun(*row) for row in self._db.execute(f"select {columns} from runs order by run")]

    def keys_of_runs(self, runs: Iterable[str]) -> set[str]:
        """Keys of all artifacts that these runs used."""
        found: set[str] = set()
        for run in runs:
            found |= {
                row[0] for row in self._db.execute("select artifact from uses where run = ? and artifact is not null", (run,))
            }
        return found

    def _open(self) -> sqlite3.Connection:
        database = sqlite3.connect(self._work.ledger)
        database.execute("pragma journal_mode = wal")
        database.executescript(_SCHEMA)
        return database

    def _rebuild(self) -> None:
        self.record_artifacts(Cache(self._work).receipts())
        for name in self._work.run_ids():
            run = RunFolder.of(self._work, name)
            try:
                self.record_run(run.record(), run.tasks().values())
            except NoSuchRun as error:
                self.faults.append(f"{error.what}: left out of the ledger")
