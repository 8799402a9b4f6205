"""The ledger: an SQLite index of runs, with a summary of each, and of the costs of their tasks.

Receipts and run.json are authoritative: a missing or damaged ledger is rebuilt from them.  Readers never change it.
"""

from __future__ import annotations

import json
import os
import sqlite3
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import astuple, dataclass, fields
from statistics import fmean, median

from ..cache.atomic import clear
from ..cache.layout import WorkFolder
from ..cache.receipt import Receipt
from ..cache.store import Cache
from .costs import TaskCosts
from .record import RunRecord
from .run_folder import NoSuchRun, RunFolder
from .summary import RunSummary, summary_of

_FORMAT = 5
"""Format version, stored last (SQLite's user_version): a ledger with another one, or an incomplete one, is rebuilt."""
_BUSY_TIMEOUT_S = 5.0
"""Seconds to wait for another process that is writing."""
_MOST_TASKS = 20_000
"""Largest number of tasks, newest first, from which costs are estimated."""


@dataclass(frozen=True)
class LedgerRun:
    """A run in the ledger; the fields are the columns of its table."""

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
    """Number of points of the cloud; None without a cloud."""
    exit_code: int


_COLUMNS = ", ".join(column.name for column in fields(LedgerRun))
_SCHEMA = f"""
create table if not exists runs ({_COLUMNS}, summary, primary key (run));
create table if not exists artifacts (artifact primary key, stage, task, bytes, wall, peak_mb, finished);
"""


class Ledger:
    """The ledger of one work folder; a context manager.  Opening and using it can raise sqlite3.Error and OSError.

    writes: the caller holds the lock; a damaged or missing ledger is rebuilt on disk.  For a reader it is rebuilt in memory.
    """

    def __init__(self, work: WorkFolder, writes: bool = False) -> None:
        self.faults: list[str] = []
        """Faults that were found and repaired, and runs that were left out, in words."""
        self._work = work
        try:
            self._open("rwc" if writes else "ro")
        except sqlite3.DatabaseError as error:
            # for a reader, a missing ledger is no fault: it is built in memory
            if _is_damage(error):
                self.faults.append(f"{work.ledger} could not be used ({error}): rebuilt from receipts and records")
            elif writes:
                raise
            if writes:
                for path in work.ledger_files():
                    clear(path)
                self._open("rwc")
            else:
                self._open("memory")

    def __enter__(self) -> Ledger:
        return self

    def __exit__(self, *error: object) -> None:
        self._db.close()

    def record_artifacts(self, receipts: Iterable[Receipt]) -> None:
        """Index finished tasks."""
        rows = []
        for receipt in receipts:
            cost = (receipt.bytes, receipt.wall, receipt.peak_rss_mb)
            rows.append((receipt.key, receipt.preimage.stage, receipt.task, *cost, receipt.finished))
        with self._db:
            self._db.executemany("insert or replace into artifacts values (?,?,?,?,?,?,?)", rows)

    def record_run(self, record: RunRecord) -> None:
        """Index a run."""
        seconds = record.seconds
        points = record.cloud.points if record.cloud else None
        times = (record.started, record.finished, round(seconds.wall, 2), round(seconds.cpu, 2))
        summary = json.dumps(summary_of(record).to_json())
        row = (record.run, record.date, *times, *astuple(record.tasks), points, int(record.exit_code), summary)
        with self._db:
            self._db.execute(f"insert or replace into runs values ({','.join('?' * len(row))})", row)

    def catch_up(self) -> None:
        """Index runs newer than the newest one in the ledger: their process was killed between publishing and indexing."""
        # ids sort in the order of the runs
        (newest,) = self._db.execute("select max(run) from runs").fetchone()
        for name in self._work.run_ids():
            if name > (newest or ""):
                try:
                    self.record_run(RunFolder.of(self._work, name).record())
                except NoSuchRun as error:
                    self.faults.append(f"{error.what}: left out of the ledger")

    def runs(self) -> list[LedgerRun]:
        """Return all runs, oldest first."""
        return [LedgerRun(*row) for row in self._db.execute(f"select {_COLUMNS} from runs order by run")]

    def summaries(self) -> list[RunSummary]:
        """Return the summaries of all runs, oldest first."""
        texts = self._db.execute("select summary from runs order by run")
        return [RunSummary.from_json(json.loads(text)) for (text,) in texts]

    def costs(self) -> TaskCosts:
        """Return the time, memory and disk space that the newest tasks took."""
        query = f"select stage, task, wall, peak_mb, bytes from artifacts order by finished desc limit {_MOST_TASKS}"
        oldest_first = self._db.execute(query).fetchall()[::-1]
        walls: dict[str, list[float]] = defaultdict(list)  # by stage
        sizes: dict[str, list[int]] = defaultdict(list)
        stages_mb: dict[str, float] = {}
        tasks: dict[str, float] = {}
        tasks_mb: dict[str, float] = {}
        for stage, task, wall, peak_mb, size in oldest_first:
            walls[stage].append(wall)
            sizes[stage].append(size)
            stages_mb[stage] = max(peak_mb, stages_mb.get(stage, 0.0))
            # later ones replace earlier ones: a task has the costs of its last run
            tasks[task] = wall
            tasks_mb[task] = peak_mb
        stages = {stage: median(values) for stage, values in walls.items()}
        stages_bytes = {stage: fmean(values) for stage, values in sizes.items()}
        return TaskCosts(stages, stages_mb, tasks, tasks_mb, stages_bytes)

    def forget(self, keys: Iterable[str]) -> None:
        """Remove artifacts from the index, after their files have been removed."""
        with self._db:
            self._db.executemany("delete from artifacts where artifact = ?", [(key,) for key in keys])
        self._db.execute("vacuum")

    def _open(self, mode: str) -> None:
        """Open the ledger on disk, or build one in memory; raises sqlite3.DatabaseError if it is damaged or of another format."""
        if mode != "memory":
            for path in self._work.ledger_files():
                if os.path.lexists(path) and not path.is_file():
                    raise sqlite3.DatabaseError("it is no file")
        self._db = sqlite3.connect(f"{self._work.ledger.resolve().as_uri()}?mode={mode}", uri=True, timeout=_BUSY_TIMEOUT_S)
        try:
            (version,) = self._db.execute("pragma user_version").fetchone()
            (check,) = self._db.execute("pragma quick_check").fetchone()
            if check != "ok":
                raise sqlite3.DatabaseError(check)
            is_new = version == 0 and mode != "ro"
            if version != _FORMAT and not is_new:
                raise sqlite3.DatabaseError(f"form {version}")
            if mode == "rwc":
                self._db.executescript("pragma journal_mode = wal; pragma synchronous = normal")
            if version != _FORMAT:
                self._db.executescript(_SCHEMA)
                self.record_artifacts(Cache(self._work).receipts())
                self.catch_up()
                # last: a ledger whose process was killed before has version 0, and is filled again
                self._db.execute(f"pragma user_version = {_FORMAT}")
        except (sqlite3.Error, OSError):
            self._db.close()
            raise


def _is_damage(error: sqlite3.DatabaseError) -> bool:
    """Is the file itself damaged, as opposed to a full disk or a lock that another process holds?"""
    code = getattr(error, "sqlite_errorcode", sqlite3.SQLITE_ERROR) & 0xFF
    return code in {sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB, sqlite3.SQLITE_ERROR, sqlite3.SQLITE_MISMATCH}


def read_costs(work: WorkFolder) -> TaskCosts:
    """Return the costs in a work folder's ledger; none if it cannot be read."""
    try:
        with Ledger(work) as ledger:
            return ledger.costs()
    except (sqlite3.Error, OSError):
        return TaskCosts()
