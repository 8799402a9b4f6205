"""Candidate matches of two sets of keypoints: the nearest few by descriptor, and keypoints near a predicted position.

A pair of frames is matched view by view: the plain views with each other, learned keypoints with learned ones, and each
compressed view with the other's plain one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..core.jit import helper, kernel
from ..core.ordering import by_cell
from ..types import LEARNED, PLAIN, TILTED, Features, Float32s, Float64s, Int32s, Int64s, Matches
from .affine_field import AffineField
from .neighbours import LEAST_DISTANCE_PX, Neighbours, nearest_neighbours
from .turns import matching_turns

NEIGHBOURS = 7
"""Candidates that each keypoint proposes, by default.  More find a few more matches where a scene repeats, and cost time."""
NOISE_RANK = 2
"""A keypoint's local noise level is its descriptor distance to the neighbour this many ranks after its last candidate."""
TRUSTED = 0.5
"""Keypoints are searched near a prediction if its trust (0 to 1) is above this."""
MAX_SIGMA_PX = 15.0
"""Keypoints are searched near a prediction if its standard deviation is below this, pixels."""
MAX_RADIUS_PX = 40.0
"""Largest radius of the search around a prediction, pixels; usually it is three standard deviations and 2 px."""
SEARCH_CELL_PX = 12.0
"""Cell of the grid in which they are searched, pixels: the results do not depend on it."""
MAX_DISTANCE = 1.08
"""Limit of the descriptor distance, over the noise level, of candidates near a prediction."""


@dataclass(frozen=True)
class Candidates:
    """Pairs i--j, (c,) int32 sorted by i and j, that may match by their descriptors (n1, d) and (n2, d)."""

    descriptors1: Float32s
    descriptors2: Float32s
    neighbours: int
    near: Neighbours
    """The nearest neighbours both ways: the `neighbours` that are candidates, and `NOISE_RANK` more."""
    noise1: Float32s
    noise2: Float32s
    """(n1,) and (n2,), the local noise levels."""
    i: Int32s
    j: Int32s
    q: Float64s
    """(c,) descriptor distances over the mean noise level of both keypoints."""


@dataclass(frozen=True)
class ViewPair:
    """A view of the left frame, with n1 keypoints, and one of the right, with n2."""

    rows1: Int32s
    rows2: Int32s
    """(n1,) and (n2,) rows of the keypoints in the `Features`, ascending."""
    x1: Float64s
    x2: Float64s
    """(n1, 2) and (n2, 2) pixels of the frames."""
    frames1: Float64s
    """(n1, 2, 2) local affine frames of the left keypoints."""
    inverse_frames2: Float64s
    """(n2, 2, 2) inverses of those of the right keypoints."""
    has_frames: bool
    """False: the keypoints have neither scale nor orientation, and their frames say nothing about the pair."""
    candidates: Candidates
    """Rows of these arrays, not of the `Features`."""


def view_pairs(
    left: Features, right: Features, tilted: bool, neighbours: int = NEIGHBOURS, known: tuple[ViewPair, ...] = ()
) -> tuple[ViewPair, ...]:
    """Pairs of views to be matched: the plain views, learned keypoints, and each compressed view with the other's plain one.

    Parameters
    ----------
    left, right : keypoints of the two frames.
    tilted : include the compressed views.
    neighbours : candidates that each keypoint proposes.
    known : the pairs without the compressed views if they have been searched already, with the same `neighbours`.

    Returns
    -------
    The pairs with enough keypoints on both sides, the plain one first.
    """
    pairs: list[ViewPair | None] = list(known)
    if not known:
        pairs.append(_view_pair(left, right, PLAIN, PLAIN, neighbours))
        pairs.append(_view_pair(left, right, *matching_turns(left, right), neighbours))
    # not tilted with tilted: both frames compressed in x differ as the plain ones do
    if tilted:
        pairs.append(_view_pair(left, right, TILTED, PLAIN, neighbours))
        pairs.append(_view_pair(left, right, PLAIN, TILTED, neighbours))
    return tuple(pair for pair in pairs if pair is not None)


def searched_view_pairs(matches: Matches, left: Features, right: Features) -> tuple[ViewPair, ...]:
    """The view pairs that the matches come from: as handed on by their matcher, else searched again.

    They are searched with the default number of neighbours, so that the result does not depend on who asks for it.
    """
    from_matcher = tuple(pair for pair in matches.searched if isinstance(pair, ViewPair))
    if from_matcher and all(pair.candidates.neighbours == NEIGHBOURS for pair in from_matcher):
        return from_matcher
    return view_pairs(left, right, matches.tilted)


def _view_pair(left: Features, right: Features, view1: int, view2: int, neighbours: int) -> ViewPair | None:
    """One view of the left frame with one of the right; None if either has too few keypoints for a noise level."""
    rows1 = np.flatnonzero(left.tilts == view1).astype(np.int32)
    rows2 = np.flatnonzero(right.tilts == view2).astype(np.int32)
    if min(len(rows1), len(rows2)) <= neighbours + NOISE_RANK:
        return None
    return ViewPair(
        rows1,
        rows2,
        x1=left.xy[rows1],
        x2=right.xy[rows2],
        frames1=left.frames[rows1],
        inverse_frames2=inverses(right.frames[rows2]),
        has_frames=max(view1, view2) < LEARNED,
        candidates=_candidates(left.descriptors[rows1], right.descriptors[rows2], neighbours),
    )


def _candidates(descriptors1: Float32s, descriptors2: Float32s, neighbours: int) -> Candidates:
    """Candidates of two sets of descriptors: each proposes its `neighbours` nearest."""
    near = nearest_neighbours(descriptors1, descriptors2, neighbours + NOISE_RANK)
    noise1 = near.row_distance[:, -1].copy()
    noise2 = near.column_distance[:, -1].copy()

    # the union of both lists, sorted by i and j: each candidate i--j as the number i * n2 + j
    n1 = len(descriptors1)
    n2 = len(descriptors2)
    from_rows = np.arange(n1)[:, None] * n2 + near.rows[:, :neighbours]
    from_columns = near.columns[:, :neighbours].astype(np.int64) * n2 + np.arange(n2)[:, None]
    edges = np.unique(np.concatenate([from_rows.ravel(), from_columns.ravel()]))
    i = (edges // n2).astype(np.int32)
    j = (edges % n2).astype(np.int32)

    q = np.empty(len(i))
    _relative_distances(descriptors1, descriptors2, noise1, noise2, i, j, q)
    return Candidates(descriptors1, descriptors2, neighbours, near, noise1, noise2, i, j, q)


def rival_distances(left: Features, right: Features, pairs: tuple[ViewPair, ...], i1: Int32s, i2: Int32s) -> Float64s:
    """(n,) descriptor distance of each match's nearest rival: a neighbour of one of its keypoints, at least
    `LEAST_DISTANCE_PX` from the other in the image.  Only the nearest few are searched: if all lie at the match itself, the last
    of them counts.

    Parameters
    ----------
    left, right : keypoints of the pair, (n1,) and (n2,).
    pairs : each view of the left frame against each of the right.
    i1, i2 : (n,) int32 rows of the matches in `left` and `right`.
    """
    rivals = np.full(len(i1), 2.0)  # the largest distance of unit vectors, for matches of none of the pairs
    for pair in pairs:
        in_pair = np.flatnonzero(np.isin(i1, pair.rows1) & np.isin(i2, pair.rows2))
        row1 = np.searchsorted(pair.rows1, i1[in_pair])
        row2 = np.searchsorted(pair.rows2, i2[in_pair])
        near = pair.candidates.near
        forward = _first_distant(pair.x2[near.rows[row1]], right.xy[i2[in_pair]], near.row_distance[row1])
        backward = _first_distant(pair.x1[near.columns[row2]], left.xy[i1[in_pair]], near.column_distance[row2])
        rivals[in_pair] = np.minimum(forward, backward)
    return rivals


def _first_distant(positions: Float64s, match: Float64s, distance: Float32s) -> Float64s:
    """Descriptor distance of the first neighbour, of (n, k), at least `LEAST_DISTANCE_PX` from the match, else of the last."""
    distant = np.linalg.norm(positions - match[:, None], axis=2) >= LEAST_DISTANCE_PX
    distant[:, -1] = True  # if all are too near, argmax takes the last
    return np.asarray(distance[np.arange(len(distance)), distant.argmax(axis=1)], dtype=np.float64)


def near_predictions(pair: ViewPair, field: AffineField, sigma: Float64s, trust: Float64s) -> tuple[Int32s, Int32s, Float64s]:
    """Candidates beyond the lists of nearest descriptors: keypoints of image 2 near a reliable prediction.

    Parameters
    ----------
    pair : keypoints and descriptors of both images.
    field : predicts the positions of keypoints of image 1 in image 2.
    sigma : (n,) standard deviation of the prediction, pixels.
    trust : (n,) weight of the field there against the descriptors alone, 0 to 1.
    """
    queries = np.flatnonzero((trust > TRUSTED) & (sigma < MAX_SIGMA_PX)).astype(np.int32)
    radius = np.minimum(3 * sigma[queries] + 2, MAX_RADIUS_PX)

    # keypoints of image 2 by the cells of a grid, and the candidates that are known by the keypoint of image 1
    cell = SEARCH_CELL_PX
    origin = pair.x2.min(axis=0)
    cells = ((pair.x2 - origin) / cell).astype(np.int64)
    columns, rows = cells.max(axis=0) + 1
    order, starts = by_cell(cells[:, 1] * columns + cells[:, 0], columns * rows)
    candidates = pair.candidates
    row_starts = np.searchsorted(candidates.i, np.arange(len(pair.x1) + 1)).astype(np.int32)

    # the kernel returns how many there are even if they do not fit: then it runs again, with enough room
    capacity = 4 * len(queries) + 16
    while True:
        i = np.empty(capacity, np.int32)
        j = np.empty(capacity, np.int32)
        q = np.empty(capacity)
        count = _search(
            queries, radius, field.prediction, pair.x2, origin, cell, columns, rows, order, starts, row_starts, candidates.j,
            candidates.descriptors1, candidates.descriptors2, candidates.noise1, candidates.noise2, i, j, q,
        )  # fmt: skip
        if count <= capacity:
            return i[:count], j[:count], q[:count]
        capacity = count


def inverses(m: Float64s) -> Float64s:
    """(n, 2, 2) inverses of matrices (n, 2, 2)."""
    # by hand: numpy's inverses of many small matrices take several times as long
    a = m[:, 0, 0]
    b = m[:, 0, 1]
    c = m[:, 1, 0]
    d = m[:, 1, 1]
    adjugate = np.stack([np.stack([d, -b], axis=1), np.stack([-c, a], axis=1)], axis=1)
    determinant = a * d - b * c
    return np.asarray(adjugate / determinant[:, None, None], dtype=np.float64)


@kernel
def _relative_distances(
    d1: Float32s, d2: Float32s, noise1: Float32s, noise2: Float32s, i: Int32s, j: Int32s, q: Float64s
) -> None:
    """Write the relative distance of each candidate i--j."""
    for c in range(len(i)):
        q[c] = _relative_distance(d1, d2, noise1, noise2, i[c], j[c])


@helper
def _relative_distance(d1: Float32s, d2: Float32s, noise1: Float32s, noise2: Float32s, i: int, j: int) -> float:
    """Descriptor distance over the mean noise level of the two keypoints."""
    # |a - b|^2 = 2 - 2 a b for unit vectors; rounding may make it negative
    dot = float(np.dot(d1[i], d2[j]))
    return float(np.sqrt(max(2 - 2 * dot, 0.0)) / (0.5 * (noise1[i] + noise2[j]) + 1e-9))


@kernel
def _search(
    queries: Int32s,
    radius: Float64s,
    prediction: Float64s,
    x2: Float64s,
    origin: Float64s,
    cell: float,
    columns: int,
    rows: int,
    order: Int64s,
    starts: Int64s,
    row_starts: Int32s,
    known: Int32s,
    d1: Float32s,
    d2: Float32s,
    noise1: Float32s,
    noise2: Float32s,
    out_i: Int32s,
    out_j: Int32s,
    out_q: Float64s,
) -> int:
    """Write new candidates, as far as they fit: keypoints of image 2 within the radius of a keypoint in `queries`, not listed yet
    (row_starts, known: the list by row), with a small relative distance, which is written, too.  Returns how many there are."""
    count = 0
    for n in range(len(queries)):
        a = queries[n]
        px = prediction[a, 0]
        py = prediction[a, 1]
        limit = radius[n] ** 2
        # the cells that the circle may touch, as numbers that are not whole yet
        left = (px - radius[n] - origin[0]) / cell
        right = (px + radius[n] - origin[0]) / cell
        top = (py - radius[n] - origin[1]) / cell
        bottom = (py + radius[n] - origin[1]) / cell
        # written so that a prediction that is nan is passed over, too
        if not (right >= 0 and left < columns and bottom >= 0 and top < rows):
            continue
        # clipped as floats: a wild prediction does not fit into an integer
        for row in range(int(max(top, 0.0)), int(min(bottom, rows - 1.0)) + 1):
            for column in range(int(max(left, 0.0)), int(min(right, columns - 1.0)) + 1):
                for entry in range(starts[row * columns + column], starts[row * columns + column + 1]):
                    b = order[entry]
                    if (x2[b, 0] - px) ** 2 + (x2[b, 1] - py) ** 2 >= limit:
                        continue
                    is_new = True
                    for k in range(row_starts[a], row_starts[a + 1]):
                        if known[k] == b:
                            is_new = False
                    if not is_new:
                        continue
                    q = _relative_distance(d1, d2, noise1, noise2, a, b)
                    if q >= MAX_DISTANCE:
                        continue
                    if count < len(out_i):
                        out_i[count] = a
                        out_j[count] = b
                        out_q[count] = q
                    count += 1
    return count
