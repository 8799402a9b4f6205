"""The reference's copies of results: one is put back into the cache when the cache has lost its own."""

from __future__ import annotations

from ..cache.atomic import write_atomic
from ..cache.checksum import Damaged, read_checksummed, sha256_of
from ..cache.layout import WorkFolder
from ..records.reference import PinnedArtifact


def restore_to_cache(work: WorkFolder, pinned: PinnedArtifact) -> bool:
    """Put a result of the reference back into the cache; returns False if the reference's own copy is damaged or gone.

    The caller holds the lock.  Raises OSError.
    """
    receipt = work.receipt(pinned.task, pinned.key)
    receipt_copy = work.pinned(receipt)
    try:
        if read_checksummed(receipt_copy, work.identity_of(receipt)) is None:
            return False
    except Damaged:
        return False
    artifact_copies = [path for path in receipt_copy.parent.glob(f"{pinned.key}.*") if path.suffix != receipt.suffix]
    if pinned.digest:
        digests = [sha256_of(path)[:32] for path in artifact_copies if path.is_file()]
        if digests != [pinned.digest]:
            return False
    # the receipt last: a result exists from then on
    for copy in (*artifact_copies, receipt_copy):
        write_atomic(receipt.with_suffix(copy.suffix), copy.read_bytes(), own_path=True)
    return True
