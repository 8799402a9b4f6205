"""The ledger: an SQLite index of runs, tasks and artifacts.  Not the truth: deleted, it is rebuilt from run.json and receipts."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from .cache import Cache, Receipt

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


class Ledger:
    """The ledger of one work folder; a context manager."""

    def __init__(self, work: Path) -> None:
        self._path = work / "ledger.sqlite"
        fresh = not self._path.exists()
        try:
            self._db = self._open()
        except sqlite3.DatabaseError:
            for name in ("ledger.sqlite", "ledger.sqlite-wal", "ledger.sqlite-shm"):
                (work / name).unlink(missing_ok=True)
            fresh = True
            self._db = self._open()
        if fresh:
            self._rebuild(work)

    def __enter__(self) -> Ledger:
        return self

    def __exit__(self, *error: object) -> None:
        self._db.close()

    def record_artifacts(self, receipts: Iterable[Receipt]) -> None:
        """Index finished tasks."""
        rows = [(r.key, r.task, r.preimage.stage, r.outcome, r.digest, r.bytes, r.wall, r.cpu, r.finished) for r in receipts]
        with self._db:
            self._db.executemany("insert or replace into artifacts values (?,?,?,?,?,?,?,?,?)", rows)

    def record_run(self, record: dict[str, Any], uses: Iterable[tuple[str, str | None, str, str | None]]) -> None:
        """Index a run: its run.json, and for each task (task, key, outcome, reason)."""
        tasks, seconds, cloud = record["tasks"], record["seconds"], record.get("cloud") or {}
        row = [record[k] for k in ("run", "date", "started", "finished")] + [seconds["wall"], seconds["cpu"]]
        row += [tasks[k] for k in ("cached", "ran", "rejected", "failed", "skipped")] + [cloud.get("points"), record["exit_code"]]
        with self._db:
            self._db.execute(f"insert or replace into runs values ({','.join('?' * len(row))})", row)
            self._db.executemany(
                "insert or replace into uses values (?,?,?,?,?)",
                [(record["run"], key, outcome, reason, task) for task, key, outcome, reason in uses],
            )

    def runs(self) -> list[dict[str, Any]]:
        """Every run, oldest first."""
        cursor = self._db.execute("select * from runs order by run")
        names = [column[0] for column in cursor.description]
        return [dict(zip(names, row, strict=True)) for row in cursor]

    def keys_of_runs(self, runs: Iterable[str]) -> set[str]:
        """Keys of all artifacts that these runs used."""
        found: set[str] = set()
        for run in runs:
            found |= {
                row[0] for row in self._db.execute("select artifact from uses where run = ? and artifact is not null", (run,))
            }
        return found

    def _open(self) -> sqlite3.Connection:
        database = sqlite3.connect(self._path)
        database.execute("pragma journal_mode = wal")
        database.executescript(_SCHEMA)
        return database

    def _rebuild(self, work: Path) -> None:
        self.record_artifacts(Cache(work / "cache").receipts())
        for path in sorted(work.glob("runs/*/run.json")):
            if path.parent.is_symlink():
                continue
            try:
                record = json.loads(path.read_text())
                lines = [json.loads(line) for line in (path.parent / "log.jsonl").read_text().splitlines()]
                uses = [(e["task"], e["key"], e["outcome"], e["reason"]) for e in lines if e.get("event") == "task"]
                self.record_run(record, uses)
            except (OSError, ValueError, KeyError):
                continue
