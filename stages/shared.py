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
    numbers: dict[str, int] = {}
    camera_numbers = np.array([numbers.setdefault(camera_id(*item), len(numbers)) for item in poses.cameras.items()], np.int64)
    components = np.array([camera.component for camera in cameras], np.int64)
    parts = []
    for component in np.unique(components):
        members = np.flatnonzero(components == component)
        pairs, angle, shared = shared_ground([cameras[k] for k in members])
        parts.append((members[pairs], angle, shared))
    all_pairs, angle, shared = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    wrong_pairs = {pair for pair, check in poses.pair_checks.items() if not check.kept}
    is_right = np.array([f"{names[i]}--{names[j]}" not in wrong_pairs for i, j in all_pairs.tolist()], bool)
    keep = is_right & (camera_numbers[all_pairs[:, 0]] != camera_numbers[all_pairs[:, 1]])
    order = np.flatnonzero(keep)[np.lexsort(all_pairs[keep].T[::-1])]
    return Overlap(names, all_pairs[order].astype(np.int32), np.degrees(angle[order]), shared[order], "poses")
