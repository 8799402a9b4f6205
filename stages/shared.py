"""How much posed cameras see in common, once poses are solved for a site file that states none.

The pairs to match were chosen by appearance; the pairs for dense matching are better chosen by poses.  Two cameras that were
never matched may have the best view of a thing, and their poses determine their rows.
"""

from __future__ import annotations

import numpy as np

from .core.cameras import camera_id
from .twoview.shared_ground import shared_ground
from .types import Overlap, Poses


def find_shared(poses: Poses) -> Overlap:
    """How much of one view another sees, for all pairs of views that are placed in one world, in the order of the views.

    No row for two views of one camera, for views placed in different worlds, or for a pair that the cameras contradict.
    """
    names = tuple(poses.cameras)
    cameras = list(poses.cameras.values())

    # 1. All pairs of views within each world.
    components = np.array([camera.component for camera in cameras], np.int64)
    pairs_of_worlds = []
    angles_of_worlds = []
    shares_of_worlds = []
    for component in np.unique(components):
        members = np.flatnonzero(components == component)
        member_pairs, angle, shared = shared_ground([cameras[k] for k in members])
        pairs_of_worlds.append(members[member_pairs])
        angles_of_worlds.append(angle)
        shares_of_worlds.append(shared)
    pairs = np.concatenate(pairs_of_worlds)
    angle = np.concatenate(angles_of_worlds)
    shared = np.concatenate(shares_of_worlds)

    # 2. Without those of one camera, and those that the cameras contradict.
    ids = [camera_id(name, camera) for name, camera in poses.cameras.items()]
    keep = np.ones(len(pairs), bool)
    for row, (i, j) in enumerate(pairs.tolist()):
        check = poses.pair_checks.get(f"{names[i]}--{names[j]}")
        is_contradicted = check is not None and not check.kept
        keep[row] = ids[i] != ids[j] and not is_contradicted

    # 3. In the order of the views: by the first of a pair, then by the second.
    order = np.flatnonzero(keep)[np.lexsort(pairs[keep].T[::-1])]
    return Overlap(names, pairs[order].astype(np.int32), np.degrees(angle[order]), shared[order], "poses")
