"""All runs of a site, and what each came to."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from ..cache.layout import WorkFolder
from ..records.ledger import Ledger, LedgerRun
from ..records.record import Verdict
from ..records.run_folder import NoSuchRun, RunFolder

MOST_WORDS = 80
"""A line has at most so many characters of a finding."""


@dataclass(frozen=True)
class Entry:
    """A run in the history of its site."""

    run: LedgerRun
    verdict: Verdict | None
    """None where its record is gone, or of an earlier version."""
    cleaned: bool
    """Is its folder gone?"""

    @property
    def words(self) -> str:
        """What it came to: the level, and the first finding."""
        if self.cleaned:
            return "cleaned"
        if self.verdict is None:
            return ""
        words = f"{self.verdict.level}: {self.verdict.findings[0]}" if self.verdict.findings else self.verdict.level
        return words if len(words) <= MOST_WORDS else f"{words[: MOST_WORDS - 3]}..."

    def to_json(self) -> dict[str, Any]:
        verdict = self.verdict.to_json() if self.verdict else None
        return {**asdict(self.run), "verdict": verdict, "cleaned": self.cleaned}


def history(work: WorkFolder) -> list[Entry]:
    """Every run, oldest first."""
    with Ledger(work) as ledger:
        return [_entry(work, run) for run in ledger.runs()]


def _entry(work: WorkFolder, run: LedgerRun) -> Entry:
    folder = RunFolder(work.run(run.run))
    try:
        record = folder.record()
        return Entry(run, record.verdict, cleaned=False)
    except NoSuchRun:
        return Entry(run, None, cleaned=not folder.paths.record.exists())


def places(work: WorkFolder) -> list[dict[str, Any]]:
    """Where every run lies, oldest first, for programs: paths are None where there is nothing any more."""
    return [_place(work, entry) for entry in history(work)] if work.root.exists() else []


def _place(work: WorkFolder, entry: Entry) -> dict[str, Any]:
    run, paths = entry.run, work.run(entry.run.run)
    level = entry.verdict.level if entry.verdict else None
    told = {"run": run.run, "night": run.date, "exit_code": run.exit_code, "level": level, "points": run.points}
    there = {
        "folder": None if entry.cleaned else paths.folder,
        "cloud": paths.cloud if paths.cloud.is_file() else None,
        "report": paths.report if paths.report.is_file() else None,
    }
    return told | {name: str(path) if path else None for name, path in there.items()}
