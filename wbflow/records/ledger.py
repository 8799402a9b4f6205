"""The ledger: an SQLite index of runs, tasks and artifacts.  Not the truth: whatever is wrong with it, it is made again from
receipts, logs and run.json; and who only reads never changes it."""

from __future__ import annotations

import contextlib
import os
import sqlite3
import statistics
from collections.abc import Callable, Iterable
from dataclasses import astuple, dataclass, field, fields
from typing import Any, TypeVar

from ..cache.atomic import clear
from ..cache.layout import WorkFolder
from ..cache.store import Cache, Receipt
from .events import TaskEvent
from .record import RunRecord
from .run_folder import NoSuchRun, RunFolder

_FORM = 3
"""Written when a ledger is complete; one of another form, or cut short, is made again."""
_NOTHING = """
drop table if exists runs; drop table if exists uses; drop table if exists artifacts; drop table if exists unreadable;
drop table if exists again;
"""
_SCHEMA = """
create table if not exists runs (
    run text primary key, date text, started text, finished text, wall real, cpu real,
    cached integer, ran integer, rejected integer, failed integer, skipped integer, points integer, exit_code integer);
create table if not exists uses (run text, artifact text, outcome text, reason text, task text, primary key (run, task));
create table if not exists artifacts (
    artifact text primary key, task text, stage text, outcome text,
    digest text, bytes integer, wall real, cpu real, peak_mb real, finished text);
create table if not exists unreadable (run text primary key);
create index if not exists uses_artifact on uses (artifact);
"""
_PATIENCE_S = 5.0
"""How long to wait for somebody else who is writing."""
_RECENT = 200
"""So many of a stage's newest artifacts are averaged."""
_T = TypeVar("_T")


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
    """The ledger of one work folder; a context manager.  Whoever opens it can meet sqlite3.Error and OSError.

    Parameters
    ----------
    work : WorkFolder
        Whose.
    writes : bool
        The caller holds the lock: what is damaged or missing is made again on disk.  A reader looks at an index in memory
        instead, made for it alone.
    records : str
        Id of a run that the caller is about to record: it is not looked for on disk.
    """

    def __init__(self, work: WorkFolder, writes: bool = False, records: str = "") -> None:
        self.faults: list[str] = []
        """What was wrong with it and has been put right, or left out, in words."""
        self._work = work
        self._writes = writes
        self._records = records
        self._db = sqlite3.connect(":memory:")
        self._in_memory = True
        self._renewed = False
        try:
            self._open()
        except sqlite3.DatabaseError as error:
            self._again(error)

    def __enter__(self) -> Ledger:
        return self

    def __exit__(self, *error: object) -> None:
        self._db.close()

    def record_artifacts(self, receipts: Iterable[Receipt]) -> None:
        """Index finished tasks."""
        rows = [
            (r.key, r.task, r.preimage.stage, r.outcome, r.digest, r.bytes, r.wall, r.cpu, r.peak_rss_mb, r.finished)
            for r in receipts
        ]
        self._write(("insert or replace into artifacts values (?,?,?,?,?,?,?,?,?,?)", rows))

    def record_run(self, record: RunRecord, tasks: Iterable[TaskEvent]) -> None:
        """Index a run, and what each of its tasks used."""
        uses = [(record.run, task.key, task.outcome, task.reason, str(task.task)) for task in tasks]
        self._write(_row(record), ("insert or replace into uses values (?,?,?,?,?)", uses))

    def runs(self) -> list[LedgerRun]:
        """Every run, oldest first."""
        columns = ", ".join(column.name for column in fields(LedgerRun))
        return [LedgerRun(*row) for row in self._rows(f"select {columns} from runs order by run")]

    def keys_of_runs(self, runs: Iterable[str]) -> set[str]:
        """Keys of all artifacts that these runs used."""
        query = "select artifact from uses where run = ? and artifact is not null"
        return {key for run in set(runs) for (key,) in self._rows(query, run)}

    def usual_bytes(self) -> dict[str, float]:
        """What an artifact of each stage takes on disk, on average of the newest."""
        ranked = "select *, row_number() over (partition by stage order by finished desc) as age from artifacts"
        return dict(self._rows(f"select stage, avg(bytes) from ({ranked}) where age <= {_RECENT} group by stage"))

    def forget(self, runs: Iterable[str], keys: Iterable[str]) -> None:
        """Leave out what runs used and artifacts that have been removed; what the runs came to stays."""
        of_runs = ("delete from uses where run = ?", [(run,) for run in runs])
        self._write(of_runs, ("delete from artifacts where artifact = ?", [(key,) for key in keys]))
        if not self._in_memory:
            self._db.execute("vacuum")
            self._db.execute("pragma wal_checkpoint(truncate)")

    def _open(self) -> None:
        """Take the ledger on disk as it is, or make what is missing."""
        if obstacles := [path for path in self._work.ledger_files() if os.path.lexists(path) and not path.is_file()]:
            if not self._writes:
                self._fill()
                return
            for path in obstacles:
                self.faults.append(f"{path} was no file: made again from receipts and records")
                clear(path)
        if not self._work.ledger.exists() and not self._writes:
            self._fill()
            return
        mode = "rwc" if self._writes else "ro"
        database = sqlite3.connect(f"{self._work.ledger.resolve().as_uri()}?mode={mode}", uri=True, timeout=_PATIENCE_S)
        try:
            (form,) = database.execute("pragma user_version").fetchone()
            if self._writes:
                database.execute("pragma journal_mode = wal")
                database.execute("pragma synchronous = normal")
        except sqlite3.DatabaseError:
            database.close()
            raise
        self._db.close()
        self._db, self._in_memory = database, False
        if self._writes and form != _FORM:
            self._fill()
        elif self._writes:
            self._catch_up()
        elif form != _FORM:
            self._in_mind()

    def _in_mind(self) -> None:
        """An index for this reader alone."""
        self._db.close()
        self._db, self._in_memory = sqlite3.connect(":memory:"), True
        self._fill()

    def _fill(self) -> None:
        """Make all of it from what it indexes."""
        self._db.executescript(_NOTHING + _SCHEMA)
        self.record_artifacts(Cache(self._work).receipts())
        self._add_runs(run for run in self._work.run_ids() if run != self._records)
        self._db.execute(f"pragma user_version = {_FORM}")

    def _catch_up(self) -> None:
        """Add runs that were published, and whose process was killed before it came here."""
        known = {run for (run,) in self._db.execute("select run from runs union select run from unreadable")}
        self._add_runs(run for run in self._work.run_ids() if run not in known | {self._records})

    def _add_runs(self, names: Iterable[str]) -> None:
        for name in names:
            run = RunFolder.of(self._work, name)
            try:
                record = run.record()
            except NoSuchRun as error:
                self.faults.append(f"{error.what}: left out of the ledger")
                self._write(("insert or replace into unreadable values (?)", [(name,)]))  # and reported once
                continue
            try:
                tasks = list(run.tasks().values())
            except NoSuchRun as error:
                self.faults.append(f"{error.what}: the ledger does not say what its tasks used")
                tasks = []
            self.record_run(record, tasks)

    def _write(self, *statements: tuple[str, list[Any]]) -> None:
        """Do all of it or nothing."""

        def write() -> None:
            with self._db:
                for statement, rows in statements:
                    self._db.executemany(statement, rows)

        self._safely(write)

    def _rows(self, query: str, *values: str) -> list[Any]:
        return self._safely(lambda: self._db.execute(query, values).fetchall())

    def _safely(self, do: Callable[[], _T]) -> _T:
        """Do something; where pages turn out damaged, do it again with a ledger that is made anew."""
        try:
            return do()
        except sqlite3.DatabaseError as error:
            if self._in_memory or self._renewed:
                raise
            self._again(error)
            return do()

    def _again(self, error: sqlite3.DatabaseError) -> None:
        """Make a damaged ledger anew.  Raises what is no damage: a full disk, somebody else who holds it for long."""
        if _is_damage(error):
            self.faults.append(f"{self._work.ledger} was damaged ({error}): made again from receipts and records")
        elif self._writes:
            raise error
        if not self._writes:
            self._in_mind()
            return
        self._db.close()
        self._renewed = True
        for path in self._work.ledger_files():
            with contextlib.suppress(FileNotFoundError):
                path.unlink()
        self._open()


def _row(record: RunRecord) -> tuple[str, list[Any]]:
    """The statement that adds a run."""
    seconds, counts = record.seconds, record.tasks
    times = (record.started, record.finished, round(seconds.wall, 2), round(seconds.cpu, 2))
    ended = (counts.cached, counts.ran, counts.rejected, counts.failed, counts.skipped)
    points = record.cloud.points if record.cloud else None
    row = astuple(LedgerRun(record.run, record.date, *times, *ended, points, int(record.exit_code)))
    return f"insert or replace into runs values ({','.join('?' * len(row))})", [row]


def _is_damage(error: sqlite3.DatabaseError) -> bool:
    """Is the file itself at fault?  (What no table or column is known by: it is no ledger of ours.)"""
    code = getattr(error, "sqlite_errorcode", sqlite3.SQLITE_ERROR) & 0xFF
    return code in {sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB, sqlite3.SQLITE_ERROR, sqlite3.SQLITE_MISMATCH}


_MOST = 20_000
"""Tasks that are looked at, the newest first."""


@dataclass(frozen=True)
class TaskCosts:
    """By stage and by task."""

    stages: dict[str, float] = field(default_factory=dict)
    """Seconds by the clock: median of a stage's tasks."""
    tasks: dict[str, float] = field(default_factory=dict)
    """Of a task, the last time."""
    stages_mb: dict[str, float] = field(default_factory=dict)
    """MB (2^20 bytes) that a stage's tasks held at most."""
    tasks_mb: dict[str, float] = field(default_factory=dict)
    """Of a task, the last time."""

    def expected(self, stage: str, task: str) -> float:
        """What a task will take, as far as one can say."""
        return self.tasks.get(task, self.stages.get(stage, 0.0))

    def held(self, stage: str, task: str, others: float = 0.0) -> float:
        """MB that a task will hold, as far as one can say; `others` of its stage held so much in the meantime."""
        return self.tasks_mb.get(task, max(others, self.stages_mb.get(stage, 0.0)))


def read_costs(work: WorkFolder) -> TaskCosts:
    """The costs that a work folder's ledger knows; reading changes nothing."""
    if not work.ledger.is_file():
        return TaskCosts()
    query = f"select stage, task, wall, peak_mb from artifacts where wall is not null order by finished desc limit {_MOST}"
    try:
        database = sqlite3.connect(f"{work.ledger.resolve().as_uri()}?mode=ro", uri=True, timeout=1.0)
        try:
            rows = [(str(stage), str(task), float(wall), float(mb or 0)) for stage, task, wall, mb in database.execute(query)]
        finally:
            database.close()
    except (sqlite3.Error, ValueError, TypeError):
        return TaskCosts()
    stages: dict[str, list[float]] = {}
    past = TaskCosts()
    for stage, task, wall, held in rows:
        stages.setdefault(stage, []).append(wall)
        past.tasks.setdefault(task, wall)
        past.tasks_mb.setdefault(task, held)
        past.stages_mb[stage] = max(held, past.stages_mb.get(stage, 0.0))
    past.stages.update({stage: statistics.median(walls) for stage, walls in stages.items()})
    return past
