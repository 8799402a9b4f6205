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
    """How much of one view another sees, for all pairs of views that are placed in one frame, in the order of the views.

    No row for two views of one camera, for views placed in different frames, or for a pair that the cameras contradict.
    """
    names = tuple(poses.cameras)
    cameras = list(poses.cameras.values())
    number: dict[str, int] = {}
    own = np.array([number.setdefault(camera_id(*named), len(number)) for named in poses.cameras.items()], np.int64)
    frame = np.array([camera.component for camera in cameras], np.int64)
    found = []
    for component in np.unique(frame):
        among = np.flatnonzero(frame == component)
        pairs, angle, shared = shared_ground([cameras[k] for k in among])
        found.append((among[pairs], angle, shared))
    every, angle, shared = (np.concatenate(columns) for columns in zip(*found, strict=True))
    wrong = {pair for pair, check in poses.pair_checks.items() if not check.kept}
    right = np.array([f"{names[i]}--{names[j]}" not in wrong for i, j in every.tolist()], bool)
    keep = right & (own[every[:, 0]] != own[every[:, 1]])
    order = np.flatnonzero(keep)[np.lexsort(every[keep].T[::-1])]
    return Overlap(names, every[order].astype(np.int32), np.degrees(angle[order]), shared[order], "poses")
