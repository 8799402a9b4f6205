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
