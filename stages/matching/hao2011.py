"""Hao's own matcher, to the letter (2011, section 3.3.2), for study and comparison.

Rows of X (m x d) and Y (n x d) are `[x, y, descriptor]`, normalised.  Iterate: P = U V^T from the SVD of X T^T Y^T, the
orthogonal Procrustes problem; T = diag(A, I), the nearest of that form to Y^T P^T X; until stable.  Accept (k, j) if p_kj
dominates its row and its column.

**Thin form.**  X T^T Y^T has rank at most d.  With X = Qx Rx, Y = Qy Ry (QR) and U D V^T = svd(Rx T^T Ry^T), of size d x d:
P = (Qx U)(Qy V)^T and Y^T P^T X = Ry^T V U^T Rx, so that an iteration never forms the m x n matrix.  The result equals the dense
SVD on the row space; beyond it, the dense U V^T is arbitrary.

As published, the dominance test accepts nothing on thousands of features: P has rank d, so that no entry of a row can outweigh
all the others.  `nearest_dominance` is the most similar test that does accept matches.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..contracts.defaults import NEIGHBOUR_RATIO
from ..types import Bools, Features, Float32s, Float64s, Int32s, Matches
from .matcher import keypoint_matches, plain_rows

_TINY = 1e-10
"""Singular values below this share of the largest one count as zero."""
_DEPENDENT = 1e-6
"""A column depends on the others if its diagonal entry of the triangular factor is below this share of the largest one."""


def match_hao2011(left: Features, right: Features, *, dominance: float = 0.8) -> Matches:
    """Match the keypoints of the plain views by the published test.  `probability` is 1: the test gives no ranking.

    Parameters
    ----------
    left, right : keypoints of the pair; those of compressed views are left out.
    dominance : an entry of P must exceed this times the sum of the rest of its row, and of its column; no unit.
    """
    rows1, rows2, P = _permutation(left, right)
    i1, i2 = np.nonzero(published_dominance(P, dominance))
    return keypoint_matches(left, right, rows1[i1], rows2[i2], np.ones(len(i1)))


def match_hao2011_dominance(left: Features, right: Features, *, ratio: float = NEIGHBOUR_RATIO) -> Matches:
    """Match the keypoints of the plain views by `nearest_dominance`; `probability` is 1 - second/best, which is only a ranking.

    Parameters
    ----------
    left, right : keypoints of the pair; those of compressed views are left out.
    ratio : largest ratio of the second largest to the largest entry of a row and of a column of P; no unit.
    """
    rows1, rows2, P = _permutation(left, right)
    i1, i2, second_to_best = nearest_dominance(P, ratio)
    return keypoint_matches(left, right, rows1[i1], rows2[i2], 1 - second_to_best.astype(np.float64))


def _permutation(left: Features, right: Features) -> tuple[Int32s, Int32s, Float32s]:
    """Rows of the plain views and their P (m, n), which is empty if a view has fewer than two keypoints."""
    rows1 = plain_rows(left)
    rows2 = plain_rows(right)
    if min(len(rows1), len(rows2)) < 2:
        return rows1, rows2, np.zeros((0, 0), np.float32)
    solution = procrustes(feature_matrix(left, rows1), feature_matrix(right, rows2))
    return rows1, rows2, solution.matrix()


@dataclass(frozen=True)
class Procrustes:
    """The relaxed permutation P = left @ right.T."""

    left: Float64s
    """(m, r) orthonormal columns."""
    right: Float64s
    """(n, r) orthonormal columns."""
    affine: Float64s
    """(2, 2) A of the last iteration."""

    def matrix(self) -> Float32s:
        """P (m, n) float32."""
        return np.asarray(self.left.astype(np.float32) @ self.right.astype(np.float32).T, dtype=np.float32)


def feature_matrix(features: Features, rows: Int32s) -> Float64s:
    """(n, 2 + d) rows `[x, y, descriptor]`: coordinates centred, of unit mean square length; descriptors of unit length."""
    xy = features.xy[rows] - features.xy[rows].mean(axis=0)
    xy /= np.sqrt((xy**2).sum(axis=1).mean())
    return np.column_stack([xy, features.descriptors[rows].astype(np.float64)])


def procrustes(X: Float64s, Y: Float64s, *, max_iterations: int = 20) -> Procrustes:
    """Alternate P and T in the thin form, from A = I, until A changes by less than a millionth of itself.

    X, Y: (m, d), (n, d) from `feature_matrix`; the first two columns are coordinates.
    """
    Qx, Rx = _orthonormal(X)
    Qy, Ry = _orthonormal(Y)
    A = np.eye(2)
    iterations = 0
    while True:
        iterations += 1
        # P for the present T
        mapped = np.column_stack([Rx[:, :2] @ A.T, Rx[:, 2:]])  # Rx T^T
        U, D, Vt = np.linalg.svd(mapped @ Ry.T)
        rank = int((_TINY * D[0] < D).sum())  # beyond the rank U and V are arbitrary
        U = U[:, :rank]
        Vt = Vt[:rank]
        # T for this P
        update = (Vt @ Ry[:, :2]).T @ (U.T @ Rx[:, :2])  # the corner of Y^T P^T X
        if iterations >= max_iterations or np.abs(update - A).max() < 1e-6 * np.abs(update).max():
            return Procrustes(Qx @ U, Qy @ Vt.T, A)
        A = update


def _orthonormal(X: Float64s) -> tuple[Float64s, Float64s]:
    """X = Q R with orthonormal columns Q, by the Cholesky factor of X^T X, twice: as exact as Householder reflections, in 1/4 of
    the time.  If a column nearly depends on the others, Householder is used (Yamamoto et al., ETNA 2015)."""
    Q = X
    R = np.eye(X.shape[1])
    # the first factorisation squares the condition number; the second removes the error that this leaves in Q
    for _ in range(2):
        try:
            step = np.linalg.cholesky(Q.T @ Q).T
        except np.linalg.LinAlgError:
            break
        if np.diag(step).min() < _DEPENDENT * np.diag(step).max():
            break
        Q = Q @ np.linalg.inv(step)
        R = step @ R
    else:
        return Q, R
    # reached by `break`
    Q, R = np.linalg.qr(X)
    return Q, R


def published_dominance(P: Float32s, dominance: float) -> Bools:
    """(m, n) True where an entry exceeds `dominance` times the absolute sum of the rest of its row, and of its column."""
    weight = np.abs(P)
    rest_of_row = weight.sum(axis=1, keepdims=True) - weight
    rest_of_column = weight.sum(axis=0, keepdims=True) - weight
    return np.asarray((dominance * rest_of_row < P) & (dominance * rest_of_column < P))


def nearest_dominance(P: Float32s, ratio: float) -> tuple[Int32s, Int32s, Float32s]:
    """Rows, columns and second/best of entries that are the best of both their row and column, with second/best below `ratio`."""
    if min(P.shape) < 2:
        return np.zeros(0, np.int32), np.zeros(0, np.int32), np.zeros(0, np.float32)
    j = P.argmax(axis=1)
    i = np.flatnonzero(P.argmax(axis=0)[j] == np.arange(len(P)))
    j = j[i]
    best = P[i, j]
    second_of_row = _second(P)[i]
    second_of_column = _second(np.ascontiguousarray(P.T))[j]
    second = np.maximum(second_of_row, second_of_column)
    with np.errstate(divide="ignore", invalid="ignore"):
        second_to_best = np.where(best > 0, second / best, np.inf).astype(np.float32)
    keep = second_to_best < ratio
    return i[keep].astype(np.int32), j[keep].astype(np.int32), np.maximum(second_to_best[keep], 0)


def _second(P: Float32s) -> Float32s:
    """(m,) the second largest of each row."""
    return np.asarray(np.partition(P, P.shape[1] - 2, axis=1)[:, -2], dtype=np.float32)
