"""What is known of pairs before they are matched, and which of very many are worth a closer look."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from typing import TYPE_CHECKING, Any

from ..task import camera_of

if TYPE_CHECKING:
    import numpy as np

Pair = tuple[str, str]
Known = tuple[float, float, float]
"""Of a pair: angle in degrees, nan where it is unknown; share; how much it promises."""
Evidence = Mapping[Pair, Known]

MOST_CANDIDATES = 96
"""So many of a view's pairs are thought over, the most promising first: a view takes a third of them at most."""
ALL_KNOWN = 32
"""Of so many views each pair has a row; of more, those that share nothing may have none."""
_LESS_ALIKE, _AIM_DEG = 0.047, 12.0
"""Share by which views look less alike for each degree between them, and the angle that is best where only looks are known."""
MOST_DROPPED = 24
"""So many of a camera's dropped pairs are told of, the most promising first."""


def cameras_of(pair: Pair) -> frozenset[str]:
    """The cameras whose views make a pair."""
    return frozenset(map(camera_of, pair))


def worth(angle: np.ndarray, shared: np.ndarray) -> np.ndarray:
    """(m,) how much pairs promise: what they share, best at 10 to 25 degrees: wide enough to be exact, narrow enough to match."""
    import numpy as np

    off = np.maximum(0.0, (10 - angle) / 10) ** 2 + np.maximum(0.0, (angle - 25) / 15) ** 2
    promise: np.ndarray = shared / (1 + np.nan_to_num(off))
    return promise


def unfit(angle: float, shared: float, angles: tuple[float, float]) -> str | None:
    """Why a pair is not worth matching, if it is not; angles: between which it is."""
    min_angle, max_angle = angles
    if shared <= 0:
        return "they share nothing"
    if not math.isnan(angle) and not min_angle <= angle <= max_angle:
        side, bound = ("below", min_angle) if angle < min_angle else ("above", max_angle)
        return f"views {angle:.0f} degrees apart, {side} {bound:g}"
    return None


def evidence_of(overlap: Any, angles: tuple[float, float], asked: Collection[frozenset[str]]) -> tuple[dict[Pair, Known], int]:
    """The evidence of pairs that may be chosen or told of, and how many pairs there are.

    Two views of one camera tell no depth and are no pair.  Where views have more pairs than can be thought over, each has its
    most promising ones, and as many more as it takes that all hang together that can.

    Parameters
    ----------
    overlap : Overlap
        Angle and shared share by pair.
    angles : (float, float)
        Degrees between which pairs are fit.
    asked : collection of frozenset of str
        Pairs of cameras that the site file names: theirs are all looked at.
    """
    import numpy as np

    names = overlap.cameras
    camera_names = [camera_of(name) for name in names]
    number = {camera: k for k, camera in enumerate(dict.fromkeys(camera_names))}
    camera = np.array([number[name] for name in camera_names], np.int64)
    rows = np.flatnonzero(camera[overlap.pairs[:, 0]] != camera[overlap.pairs[:, 1]])
    count, promise = len(rows), worth(overlap.angle_deg, _apart_enough(overlap))
    if count > len(names) * MOST_CANDIDATES // 2:
        wanted = {tuple(sorted(number[name] for name in pair)) for pair in asked if pair <= number.keys()}
        rows = _promising(overlap, rows, promise, camera, angles, wanted)
    columns = (x[rows].tolist() for x in (overlap.pairs, overlap.angle_deg, overlap.shared, promise))
    return {(names[i], names[j]): tuple(known) for (i, j), *known in zip(*columns, strict=True)}, count


def _apart_enough(overlap: Any) -> np.ndarray:
    """(m,) shares; of many views without poses less where two are too much alike: they look from one place, and tell no depth.

    How alike views look falls with the angle between them, on two photographed sites by the same 4.7 % for each degree.  What the
    views' best have is taken for views from one place, and a pair counts as if it were as much farther from 12 degrees as it is
    nearer.
    """
    import numpy as np

    shared: np.ndarray = overlap.shared.copy()
    alike = np.isnan(overlap.angle_deg) & (shared > 0)
    if len(overlap.cameras) > ALL_KNOWN and alike.any():
        best = np.zeros(len(overlap.cameras))
        for side in overlap.pairs[alike].T:
            np.maximum.at(best, side, shared[alike])
        aim = math.exp(-_LESS_ALIKE * _AIM_DEG) * float(np.median(best[best > 0]))
        shared[alike] = np.minimum(shared[alike], aim**2 / shared[alike])
    return shared


def _promising(
    overlap: Any,
    rows: np.ndarray,
    promise: np.ndarray,
    camera: np.ndarray,
    angles: tuple[float, float],
    wanted: Collection[tuple[int, ...]],
) -> np.ndarray:
    """Those of the rows that are worth thinking over, in their order.

    Parameters
    ----------
    overlap, angles
        As of `evidence_of`.
    rows
        Of the overlap, that are pairs of two cameras.
    promise
        What each row of the overlap promises.
    camera
        The number of each view's camera.
    wanted
        Pairs of these numbers that are all looked at.
    """
    import numpy as np

    pairs, angle, promise = overlap.pairs[rows], overlap.angle_deg[rows], promise[rows]
    fit = (promise > 0) & (np.isnan(angle) | ((angle >= angles[0]) & (angle <= angles[1])))
    keep = _among_best(pairs, promise, MOST_DROPPED)
    fits = np.flatnonzero(fit)
    keep[fits[_among_best(pairs[fits], promise[fits], MOST_CANDIDATES)]] = True
    ends = np.sort(camera[pairs], axis=1)
    for one, other in wanted:
        keep |= (ends[:, 0] == one) & (ends[:, 1] == other)
    groups = list(range(int(camera.max()) + 1))

    def group(at: int) -> int:
        while groups[at] != at:
            groups[at] = at = groups[groups[at]]
        return at

    best_first = fits[np.argsort(-promise[fits], kind="stable")]
    kept_first = np.concatenate([best_first[keep[best_first]], best_first[~keep[best_first]]])
    for row, (one, other) in zip(kept_first.tolist(), ends[kept_first].tolist(), strict=True):
        if (a := group(one)) != (b := group(other)):
            groups[a] = b
            keep[row] = True
    promising: np.ndarray = rows[keep]
    return promising


def _among_best(pairs: np.ndarray, promise: np.ndarray, most: int) -> np.ndarray:
    """(m,) bool: is a pair among the most promising of one of its views?"""
    import numpy as np

    order = np.argsort(-promise, kind="stable")
    ends = pairs[order].ravel()  # of the most promising first
    by_view = np.argsort(ends, kind="stable")
    starts = np.searchsorted(ends[by_view], ends[by_view], side="left")
    place = np.empty(len(ends), np.int64)
    place[by_view] = np.arange(len(ends)) - starts
    found = np.zeros(len(pairs), bool)
    found[order] = (place.reshape(-1, 2) < most).any(axis=1)
    return found
