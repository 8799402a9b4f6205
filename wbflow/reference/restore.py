"""Restores results that the reference or the cache has lost, from the other one."""

from __future__ import annotations

from ..cache.atomic import clear, write_atomic
from ..cache.checksum import Damaged, read_checksummed, sha256_of
from ..cache.layout import WorkFolder
from ..cache.store import Cache, Receipt
from ..records.reference import PinnedArtifact, Reference
from ..task import Task
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
            (to_cache if restore_to_cache(work, pinned) else lost).append(task)
        elif _copy_differs(cache, receipt) and (receipt.file is None or sha256_of(cache.path(receipt))[:32] == receipt.digest):
            for path in files_of(cache, receipt):
                clear(work.pinned(path))
                write_atomic(work.pinned(path), path.read_bytes(), own_path=True)
            copied.append(task)
    return to_cache, copied, lost


def restore_to_cache(work: WorkFolder, pinned: PinnedArtifact) -> bool:
    """Put a result of the reference back into the cache; returns False if the reference's own copy is damaged or gone.

    The caller holds the lock.  Raises OSError.
    """
    path = work.receipt(pinned.task, pinned.key)
    copies = sorted(work.pinned(path).parent.glob(f"{pinned.key}.*"), key=lambda p: p.suffix == path.suffix)
    artifacts = [copy for copy in copies if copy.suffix != path.suffix]
    try:
        is_intact = read_checksummed(work.pinned(path), work.identity_of(path)) is not None
    except Damaged:
        is_intact = False
    if not is_intact or (pinned.digest and [sha256_of(copy)[:32] for copy in artifacts if copy.is_file()] != [pinned.digest]):
        return False
    for copy in copies:  # the receipt last
        write_atomic(path.with_suffix(copy.suffix), copy.read_bytes(), own_path=True)
    return True


def _copy_differs(cache: Cache, receipt: Receipt) -> bool:
    """Quick check: is the reference's copy of a receipt or an artifact gone, or of another size?"""
    work, path = cache.work, cache.work.receipt(receipt.preimage.task, receipt.key)
    try:
        if work.pinned(path).stat().st_size != path.stat().st_size:
            return True
        return receipt.file is not None and work.pinned(cache.path(receipt)).stat().st_size != receipt.bytes
    except OSError:
        return True
