"""Removing what no recent run uses."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

from .cache import Cache
from .ledger import Ledger


@dataclass(frozen=True)
class Cleaning:
    """files, bytes: what goes (or went); runs: folders of runs that go."""

    files: int
    bytes: int
    runs: tuple[str, ...]


def clean(work: Path, keep: int, dry_run: bool) -> Cleaning:
    """Remove artifacts that the last `keep` runs don't use, their quarantine, and the folders of older runs.

    The run that `runs/latest` shows is always kept.  The caller holds the lock.
    """
    runs = sorted(p.name for p in (work / "runs").glob("*") if p.is_dir() and not p.is_symlink() and not p.name.startswith("."))
    latest = (work / "runs" / "latest").resolve().name
    kept = {*runs[len(runs) - keep :], latest}
    with Ledger(work) as ledger:
        used = ledger.keys_of_runs(kept) | _logged_keys(work, kept)
    doomed: list[Path] = []
    for receipt in Cache(work / "cache").receipts():
        if receipt.key not in used:
            folder = Cache(work / "cache").folder(receipt.preimage.stage, receipt.preimage.subject)
            # the receipt goes first: what is left without one is not believed
            doomed += [
                p for p in (folder / f"{receipt.key}.json", *sorted(folder.glob(f"{receipt.key}.*"))) if p not in doomed[-3:]
            ]
    doomed += sorted((work / "quarantine").glob("*"))
    old = tuple(run for run in runs if run not in kept)
    for run in old:
        doomed += sorted((work / "runs" / run).glob("*"))
    size = sum(path.stat().st_size for path in doomed)
    if not dry_run:
        for path in doomed:
            path.unlink(missing_ok=True)
        for run in old:
            (work / "runs" / run).rmdir()
    return Cleaning(len(doomed), size, old)


def _logged_keys(work: Path, runs: set[str]) -> set[str]:
    """Keys that runs name in their own logs, in case the ledger has been lost."""
    found: set[str] = set()
    for run in runs:
        try:
            lines = (work / "runs" / run / "log.jsonl").read_text().splitlines()
        except OSError:
            continue
        found |= {key for key in (json.loads(line).get("key") for line in lines) if key}
    return found
