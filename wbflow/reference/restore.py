"""Restores results that the reference or the cache has lost, from the other one."""

from __future__ import annotations

from ..cache.atomic import clear, write_atomic
from ..cache.checksum import sha256_of
from ..cache.receipt import Receipt
from ..cache.store import Cache
from ..records.reference import Reference
from ..task import Task
from .copies import restore_to_cache
from .folder import files_of


def restore(cache: Cache, reference: Reference) -> tuple[list[Task], list[Task], list[Task]]:
    """Restore results that the cache or the reference has lost, as far as the other still has them.  The caller holds the lock.

    Returns the tasks whose results were restored to the cache, copied to the reference, and found in neither.  Raises OSError.
    """
    work = cache.work
    to_cache: list[Task] = []
    copied: list[Task] = []
    lost: list[Task] = []
    for task, pinned in reference.artifacts.items():
        receipt = cache.by_key(task, pinned.key)
        if receipt is None:
            if restore_to_cache(work, pinned):
                to_cache.append(task)
            else:
                lost.append(task)
        # the digest last: it reads the whole artifact
        elif _copy_differs(cache, receipt) and _is_intact(cache, receipt):
            for path in files_of(cache, receipt):
                clear(work.pinned(path))
                write_atomic(work.pinned(path), path.read_bytes(), own_path=True)
            copied.append(task)
    return to_cache, copied, lost


def _copy_differs(cache: Cache, receipt: Receipt) -> bool:
    """Quick check: is the reference's copy of a receipt or an artifact gone, or of another size?"""
    work = cache.work
    path = work.receipt(receipt.preimage.task, receipt.key)
    try:
        if work.pinned(path).stat().st_size != path.stat().st_size:
            return True
        return receipt.file is not None and work.pinned(cache.path(receipt)).stat().st_size != receipt.bytes
    except OSError:
        return True


def _is_intact(cache: Cache, receipt: Receipt) -> bool:
    """Does the cache's artifact, if the task has one, have the digest that its receipt states?"""
    return receipt.file is None or sha256_of(cache.path(receipt))[:32] == receipt.digest
