"""The folder of the reference: its record, its record's twin, and copies of its artifacts, written so that a kill loses none."""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Iterable
from pathlib import Path

from ..cache.atomic import write_atomic
from ..cache.checksum import dump_with_checksum
from ..cache.layout import WorkFolder
from ..cache.receipt import Receipt
from ..cache.store import Cache
from ..records.reference import IDENTITY, Reference


def write_reference(cache: Cache, reference: Reference, receipts: Iterable[Receipt]) -> None:
    """Replace the reference of a work folder.  The caller holds the lock.  Raises OSError.

    receipts: the receipts of the reference's artifacts, which must be in the cache.
    """
    work = cache.work
    new_files = {work.reference_record, work.reference_twin}
    for receipt in receipts:
        for path in files_of(cache, receipt):
            write_atomic(work.pinned(path), path.read_bytes(), durable=False, own_path=True)
            new_files.add(work.pinned(path))
    os.sync()  # one sync for all copies, before the record is written
    data = dump_with_checksum(IDENTITY, reference.to_json(), in_lines=True)
    for path in (work.reference_twin, work.reference_record):
        write_atomic(path, data, own_path=True)
    for path in sorted(work.reference.rglob("*"), reverse=True):  # remove an earlier reference; the content of a folder first
        if path.is_dir() and not path.is_symlink():
            with contextlib.suppress(OSError):  # not empty
                path.rmdir()
        elif path not in new_files:
            path.unlink()


def drop_reference(work: WorkFolder) -> bool:
    """Remove the reference; return False if there is none.  The caller holds the lock."""
    existed = work.reference_record.exists() or work.reference_twin.exists()
    for path in (work.reference_twin, work.reference_record):
        path.unlink(missing_ok=True)
    if work.reference.exists():
        shutil.rmtree(work.reference)
    return existed


def files_of(cache: Cache, receipt: Receipt) -> list[Path]:
    """Return the paths of a task's artifact, if there is one, and of its receipt."""
    artifact = [cache.path(receipt)] if receipt.file else []
    return [*artifact, cache.work.receipt(receipt.preimage.task, receipt.key)]
