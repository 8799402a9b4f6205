"""The last whole night, remembered: one on which nothing at all has changed since is not planned again.

What is believed here is no more than a plan would believe: each file that the night rests on (receipts, artifacts, pictures, the
reference and its copies, the products of the run) has the size, times and inode that it had, and everything else (site file,
code, captures) the digest.  Whatever is in doubt, the night is planned from its receipts.
"""

from __future__ import annotations

import hashlib
import os
import time
from array import array
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from .artifact import digest
from .atomic import write_atomic
from .layout import WorkFolder
from .outside import read_outside
from .signed import Damaged, read_signed, write_signed

_OF = "the last whole night"
_INODES = (1 << 63) - 1
_PATIENCE = 5
"""So often is a moment waited for the clock of the file system to go on."""


@dataclass(frozen=True)
class Unchanged:
    """A whole night, and what is published where it comes again."""

    run: str
    """The newest run: its products are published again."""
    rests_on: str
    """Digest of site, code and captures."""
    stamps: str
    """Digest of the stamps of all files that it rests on."""
    products: Mapping[str, list[int]] = field(default_factory=dict)
    """Size, time and inode of the files in the run's folder that are published again, by name."""
    files: tuple[str, ...] = ()
    """Those that it rests on."""
    log: str = ""
    """The log of a run that finds everything in the cache."""
    record: str = ""
    """Its run.json."""

    def holds(self, work: WorkFolder) -> bool:
        """Is every file as it was?"""
        folder = work.run(self.run).folder
        same = all(_product(folder / name) == stamp for name, stamp in self.products.items())
        return same and stamps_of(self.files)[0] == self.stamps


def recall(work: WorkFolder, rests_on: str) -> Unchanged | None:
    """What is remembered of a night that rests on just this; None where nothing is, or it cannot be believed."""
    try:
        told = read_signed(work.unchanged_memo, _OF)
        if not told or told["rests_on"] != rests_on:
            return None
        data = read_outside(work.unchanged_data)
        if told["data"] != digest(data):
            return None
        texts, end = [], 0
        for size in told["sizes"]:
            texts.append(data[end : end + size].decode(errors="surrogateescape"))
            end += size
        files, log, record = texts
        return Unchanged(told["run"], rests_on, told["stamps"], told["products"], tuple(files.split("\0")), log, record)
    except (Damaged, OSError, KeyError, TypeError, ValueError):
        return None


def keep(work: WorkFolder, night: Unchanged, newest: int) -> None:
    """Remember a night.  The caller holds the lock.

    Parameters
    ----------
    work : WorkFolder
        Where.
    night : Unchanged
        As it is now.
    newest : int
        When the youngest of its files was changed, nanoseconds: as long as the clock of the file system shows no later time,
        another change of it would not show, and nothing is remembered.

    Raises
    ------
    OSError
        The disk is full, or there is no right to write.
    """
    sections = ["\0".join(night.files), night.log, night.record]
    parts = [text.encode(errors="surrogateescape") for text in sections]
    data = b"".join(parts)
    write_atomic(work.unchanged_data, data, settle=False)
    for _ in range(_PATIENCE):
        if os.stat(work.unchanged_data).st_mtime_ns > newest:  # noqa: PTH116
            break
        time.sleep(0.01)
        os.utime(work.unchanged_data)
    else:
        return
    _write(work, night, {"data": digest(data), "sizes": [len(part) for part in parts]})


def show_again(work: WorkFolder, run: str) -> None:
    """The night has come again, as this run.  Raises OSError."""
    try:
        told = read_signed(work.unchanged_memo, _OF) or {}
        write_signed(work.unchanged_memo, _OF, {**told, "run": run}, settle=False)
    except Damaged:
        return


def products_of(work: WorkFolder, run: str, names: Iterable[str]) -> dict[str, list[int]]:
    """The stamps of files in a run's folder.  Raises OSError for one that is not there."""
    found = {name: _product(work.run(run).folder / name) for name in names}
    if missing := [name for name, stamp in found.items() if stamp is None]:
        raise FileNotFoundError(f"{missing[0]} of run {run} is gone")
    return {name: stamp for name, stamp in found.items() if stamp is not None}


def stamps_of(paths: Iterable[str]) -> tuple[str, int]:
    """One digest of size, times and inode of files, and when the youngest was changed (nanoseconds)."""
    stamps, stat = array("q"), os.stat
    for path in paths:
        try:
            status = stat(path)
        except OSError:
            stamps.extend((-1, -1, -1, -1))
        else:
            stamps.extend((status.st_size, status.st_mtime_ns, status.st_ctime_ns, status.st_ino & _INODES))
    newest = max((*stamps[1::4], *stamps[2::4]), default=0)
    return hashlib.sha256(stamps.tobytes()).hexdigest()[:32], newest


def _product(path: Path) -> list[int] | None:
    """Without the time of the last change of anything: a file that is published again gets one more name."""
    try:
        status = os.stat(path)  # noqa: PTH116
    except OSError:
        return None
    return [status.st_size, status.st_mtime_ns, status.st_ino]


def _write(work: WorkFolder, night: Unchanged, told: Mapping[str, object]) -> None:
    head = {"run": night.run, "rests_on": night.rests_on, "stamps": night.stamps, "products": dict(night.products)}
    write_signed(work.unchanged_memo, _OF, {**head, **told})
