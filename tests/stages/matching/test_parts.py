"""Parts of the matchers, compared with what they replace: dense SVD, brute force, exact maps."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from wbflow_stages.core.nearest_points import nearest_points
from wbflow_stages.matching.affine_field import fit_affine_field
from wbflow_stages.matching.assignment import assign, without_repeats
from wbflow_stages.matching.hao2011 import nearest_dominance, procrustes, published_dominance
from wbflow_stages.matching.neighbours import nearest_neighbours
from wbflow_stages.types import Float64s


def unit_rows(rng: np.random.Generator, n: int, d: int = 32) -> np.ndarray:
    x = rng.normal(size=(n, d)).astype(np.float32)
    return np.asarray(x / np.linalg.norm(x, axis=1, keepdims=True))


@settings(max_examples=20, deadline=None)
@given(st.integers(1, 700), st.integers(1, 60), st.integers(1, 6), st.integers(0, 1000))
def test_nearest_neighbours_equal_those_of_brute_force(n1: int, n2: int, k: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    a, b = unit_rows(rng, n1), unit_rows(rng, n2)
    near = nearest_neighbours(a, b, k)
    distance = np.linalg.norm(a[:, None].astype(float) - b[None], axis=2)
    k = min(k, n1, n2)
    np.testing.assert_allclose(near.row_distance, np.sort(distance, axis=1)[:, :k], atol=2e-3)
    np.testing.assert_allclose(near.column_distance, np.sort(distance, axis=0)[:k].T, atol=2e-3)
    np.testing.assert_allclose(np.take_along_axis(distance, near.rows.astype(int), 1), near.row_distance, atol=2e-3)


def test_the_first_of_equally_near_neighbours_is_returned() -> None:
    near = nearest_neighbours(np.eye(4, dtype=np.float32)[[0]], np.eye(4, dtype=np.float32)[[1, 0, 0, 2]], 1)
    assert near.rows[0, 0] == 1


@settings(max_examples=30, deadline=None)
@given(st.integers(1, 300), st.integers(1, 40), st.sampled_from([0.0, 1e-4, 1.0, 30.0]), st.integers(0, 1000))
def test_nearest_points_equal_those_of_brute_force_for_any_distribution(n: int, k: int, width: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = rng.random((n, 2)) * [500.0 * width, 500.0]
    points[: n // 3] = points[0] + rng.random((n // 3, 2))  # a cluster
    points[-1] = points[-1] * 10 + 5  # one point far away
    queries = np.vstack([rng.random((40, 2)) * 1200 - 300, points[: n // 2]])
    k = min(k, n)
    distance, index = nearest_points(points, queries, k)
    brute = np.linalg.norm(queries[:, None] - points[None], axis=2)
    np.testing.assert_allclose(np.sort(distance, axis=1), np.sort(brute, axis=1)[:, :k], atol=1e-9)
    np.testing.assert_allclose(np.take_along_axis(brute, index.astype(int), 1), distance, atol=1e-9)
    assert all(len(set(row)) == k for row in index.tolist())


def test_thin_procrustes_equals_the_dense_svd_on_the_row_space() -> None:
    rng = np.random.default_rng(0)
    X, Y = rng.normal(size=(90, 12)), rng.normal(size=(110, 12))
    thin = procrustes(X, Y, max_iterations=6)
    T = np.eye(12)
    for _ in range(6):
        dense_A = T[:2, :2].copy()
        U, _, Vt = np.linalg.svd(X @ T.T @ Y.T, full_matrices=False)
        P = U[:, :12] @ Vt[:12]
        T[:2, :2] = (Y.T @ P.T @ X)[:2, :2]
    np.testing.assert_allclose(thin.left @ thin.right.T, P, atol=1e-10)
    np.testing.assert_allclose(thin.affine, dense_A, rtol=1e-10, atol=1e-10)


def test_thin_procrustes_finds_a_permutation_of_few_points() -> None:
    rng = np.random.default_rng(1)
    X = rng.normal(size=(10, 12))
    order = rng.permutation(10)
    P = procrustes(X, X[order]).matrix()
    assert (P.argmax(axis=1) == np.argsort(order)).all()
    fired = published_dominance(P, 0.8)
    i, j, _ = nearest_dominance(P, 0.8)
    assert fired.sum() == 10 and fired[i, j].all() and len(i) == 10


def test_published_dominance_follows_the_published_inequality() -> None:
    P = np.array([[0.9, 0.1, -0.1], [0.2, 0.1, 0.1], [0.0, 0.1, 0.5]], np.float32)
    expected = np.array(
        [[P[k, j] > 0.8 * (abs(P[k]).sum() - abs(P[k, j])) and P[k, j] > 0.8 * (abs(P[:, j]).sum() - abs(P[k, j]))
          for j in range(3)] for k in range(3)]
    )  # fmt: skip
    assert (published_dominance(P, 0.8) == expected).all() and expected[0, 0] and not expected[1, 0]


@settings(max_examples=25, deadline=None)
@given(st.integers(1, 40), st.integers(1, 40), st.integers(0, 1000))
def test_assigned_probabilities_sum_to_at_most_one_per_row_and_column(n1: int, n2: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    keep = rng.random((n1, n2)) < 0.3
    i, j = (part.astype(np.int32) for part in np.nonzero(keep))
    p = assign(i, j, rng.normal(0, 4, len(i)), n1, n2, iterations=200)
    assert (p >= 0).all()
    assert (np.bincount(i, p, n1) <= 1 + 1e-6).all() and (np.bincount(j, p, n2) <= 1 + 1e-6).all()


def test_the_probability_of_a_lone_candidate_balances_its_odds() -> None:
    p = assign(np.zeros(1, np.int32), np.zeros(1, np.int32), np.array([2.0]), 1, 1, iterations=200)[0]
    assert p / (1 - p) ** 2 == pytest.approx(np.exp(2.0), rel=1e-6)  # mass = p / (what u leaves * what v leaves)


@settings(max_examples=25, deadline=None)
@given(st.integers(1, 60), st.integers(0, 1000))
def test_only_the_most_probable_of_nearby_matches_is_kept(n: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    x1, x2, p = rng.uniform(-4, 9, (n, 2)), rng.uniform(0, 12, (n, 2)), rng.random(n)
    keep = without_repeats(x1, x2, p)
    assert keep[p.argmax()]
    for x in (x1[keep], x2[keep]):
        gaps = np.linalg.norm(x[:, None] - x[None], axis=2) + 9 * np.eye(len(x))
        assert (gaps >= 1.5).all()
    for lost in np.flatnonzero(~keep):
        stronger = keep & (p >= p[lost])
        gaps = np.minimum(np.linalg.norm(x1[stronger] - x1[lost], axis=1), np.linalg.norm(x2[stronger] - x2[lost], axis=1))
        assert gaps.min() < 1.5


def test_the_affine_field_finds_a_smooth_map_in_spite_of_outliers() -> None:
    rng = np.random.default_rng(2)
    x1 = rng.uniform(0, [800, 600], (600, 2))

    def bend(x: Float64s) -> Float64s:
        return np.column_stack([0.8 * x[:, 0] + 1e-4 * x[:, 0] ** 2, 0.1 * x[:, 0] + 0.9 * x[:, 1]])

    x2 = bend(x1) + rng.normal(0, 0.3, x1.shape)
    wrong = rng.random(600) < 0.25
    x2[wrong] = rng.uniform(0, [800, 600], (wrong.sum(), 2))
    queries = rng.uniform(100, [700, 500], (200, 2))
    frames = np.repeat(np.diag([0.9, 0.9])[None], 600, axis=0)
    field = fit_affine_field(x1, x2, frames, np.ones(600), queries)
    error = np.linalg.norm(field.prediction - bend(queries), axis=1)
    assert np.median(error) < 0.5 and np.percentile(error, 95) < 2
    expected = np.array([[0.8 + 2e-4 * 400, 0], [0.1, 0.9]])
    assert np.median(np.abs(field.affine.mean(axis=0) - expected)) < 0.05


def test_the_affine_field_at_one_query_does_not_depend_on_the_others() -> None:
    rng = np.random.default_rng(5)
    x1, x2 = rng.uniform(0, [800, 600], (90, 2)), rng.uniform(0, [800, 600], (90, 2))
    queries = rng.uniform(0, [800, 600], (300, 2))
    frames, weight = rng.normal(size=(90, 2, 2)), rng.random(90)
    together = fit_affine_field(x1, x2, frames, weight, queries)
    for n in (0, 63, 127, 128, 299):
        alone = fit_affine_field(x1, x2, frames, weight, queries[n : n + 1])
        assert (alone.prediction == together.prediction[n]).all() and (alone.affine == together.affine[n]).all()
        assert alone.sigma_px == together.sigma_px[n] and alone.support == together.support[n]


def test_the_affine_field_ignores_the_match_at_the_query_itself() -> None:
    rng = np.random.default_rng(3)
    x1 = rng.uniform(0, 100, (50, 2))
    x2 = x1 + np.array([10, 0])
    x2[7] += 40
    field = fit_affine_field(x1, x2, np.repeat(np.eye(2)[None], 50, axis=0), np.ones(50), x1)
    np.testing.assert_allclose(field.prediction[7], x1[7] + [10, 0], atol=0.5)
