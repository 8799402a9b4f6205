"""A pair rises in score with distinctive evidence; loops of a site confirm right pairs and expose those that only look right."""

from itertools import product

import numpy as np
import pytest

from wbflow_stages.geometry import estimate_geometry
from wbflow_stages.matches import match
from wbflow_stages.twoview.pair_score import PairEvidence, pair_score, probability, rotation_angle_deg, site_verdict
from wbflow_stages.types import Features, Geometry, Matches, Pair, Rejected, View

K = np.array([[800.0, 0, 500], [0, 800, 333], [0, 0, 1]])
VIEW = View(1000, 667, K)


def turn(degrees: float, axis: int = 1) -> np.ndarray:
    a = np.radians(degrees)
    R = np.eye(3)
    i, j = [(1, 2), (2, 0), (0, 1)][axis]
    R[i, i] = R[j, j] = np.cos(a)
    R[i, j], R[j, i] = -np.sin(a), np.sin(a)
    return R


def ring(count: int) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Cameras on an arc that look at its centre: R and C by name."""
    cameras = {}
    for k in range(count):
        R = turn(-15.0 * k) @ turn(3.0 * (k % 2), 0)
        cameras[f"c{k}"] = (R, -R.T @ np.array([0, 0.2 * k, 12.0]))
    return cameras


def geometry(R: np.ndarray, t: np.ndarray, score: float) -> Geometry:
    nothing, none = np.zeros((0, 2)), np.zeros(0, np.int32)
    return Geometry(
        F=np.eye(3), x1=nothing, x2=nothing, i1=none, i2=none, probability=np.zeros(0, np.float32), view1=VIEW, view2=VIEW,
        cam2_R_cam1=R, cam2_t_cam1=t / np.linalg.norm(t), matches=100, inliers=100, model="E", epipolar_px=0.3, angle_deg=15.0,
        homography_share=0.3, score=score, good_probability=probability(score), distinct_cells=20,
    )  # fmt: skip


def site(count: int, score: float = 2.0, wrong: dict[Pair, float] | None = None) -> dict[Pair, Geometry]:
    """All pairs of a ring; `wrong` ones have another rotation, and the score given."""
    cameras, pairs, rng = ring(count), {}, np.random.default_rng(count)
    for a in range(count):
        for b in range(a + 1, count):
            (R1, C1), (R2, C2) = cameras[f"c{a}"], cameras[f"c{b}"]
            pair = (f"c{a}", f"c{b}")
            R, t = R2 @ R1.T, R2 @ (C1 - C2)
            pairs[pair] = geometry(turn(rng.normal(0, 0.2), int(rng.integers(3))) @ R, t, score)
            if wrong and pair in wrong:
                pairs[pair] = geometry(turn(40.0, 0) @ R, turn(50.0) @ t, wrong[pair])
    return pairs


def test_a_site_of_right_pairs_is_believed_and_all_triangles_close() -> None:
    verdicts = site_verdict(site(5))
    assert all(v.reason is None for v in verdicts.values())
    assert all(v.closed == v.triangles == 3 for v in verdicts.values())
    assert min(v.good_probability for v in verdicts.values()) > 0.95


@pytest.mark.parametrize("score", [1.0, 3.0])
def test_a_wrong_pair_of_good_score_is_dropped_as_a_lookalike(score: float) -> None:
    verdicts = site_verdict(site(5, wrong={("c1", "c3"): score}))
    assert verdicts["c1", "c3"].reason is not None and "look-alike" in verdicts["c1", "c3"].reason
    assert verdicts["c1", "c3"].closed == 0 and verdicts["c1", "c3"].good_probability <= 0.5
    assert all(v.reason is None for pair, v in verdicts.items() if pair != ("c1", "c3"))


def test_loops_confirm_a_pair_that_is_doubtful_alone() -> None:
    doubtful = site(5)
    doubtful["c0", "c4"] = geometry(*pose(doubtful["c0", "c4"]), score=-0.7)
    assert site_verdict(doubtful)["c0", "c4"].reason is None
    alone = site_verdict({("c0", "c4"): doubtful["c0", "c4"]})["c0", "c4"]
    assert alone.reason is not None and alone.reason.startswith("wrong")


def pose(g: Geometry) -> tuple[np.ndarray, np.ndarray]:
    assert g.cam2_R_cam1 is not None and g.cam2_t_cam1 is not None
    return g.cam2_R_cam1, g.cam2_t_cam1


def test_two_cameras_need_more_than_cameras_that_others_confirm() -> None:
    pair = next(iter(site(2).values()))
    modest, sure = (site_verdict({("a", "b"): geometry(*pose(pair), score=s)})["a", "b"] for s in (0.8, 2.5))
    assert modest.reason is not None and "no third camera" in modest.reason
    assert sure.reason is None


def test_what_two_poses_explain_is_ambiguous() -> None:
    pair = next(iter(site(2).values()))
    verdict = site_verdict({("a", "b"): geometry(*pose(pair), score=0.0)})["a", "b"]
    assert verdict.reason is not None and verdict.reason.startswith("ambiguous")


def test_pairs_without_pose_are_judged_by_their_score() -> None:
    some = site(3)
    bare = {p: Geometry(**{**vars(g), "cam2_R_cam1": None, "cam2_t_cam1": None}) for p, g in some.items()}
    verdicts = site_verdict(bare)
    assert all(v.reason is None and v.triangles == 0 for v in verdicts.values())
    assert site_verdict({}) == {}


def test_the_verdict_does_not_depend_on_the_order_of_the_pairs() -> None:
    pairs = site(5, wrong={("c0", "c2"): 1.5})
    there, back = site_verdict(pairs), site_verdict(dict(reversed(pairs.items())))
    assert {p: v.reason is None for p, v in there.items()} == {p: v.reason is None for p, v in back.items()}
    assert all(there[p].good_probability == pytest.approx(back[p].good_probability) for p in pairs)


GOOD = PairEvidence(inliers=300, distinct_cells=30, distinct_share=0.6, agreement=0.7, half_rotation_deg=0.2, stretch=0.15)


WORSE = [{"inliers": 30}, {"distinct_cells": 5}, {"distinct_share": 0.2}, {"agreement": 0.1}]


@pytest.mark.parametrize(("worse", "known"), [*product(WORSE, [True, False]), ({"half_rotation_deg": 8.0}, True)])
def test_less_evidence_is_a_lower_score(worse: dict[str, float], known: bool) -> None:
    unknown = {} if known else {"half_rotation_deg": float("nan")}
    good, bad = PairEvidence(**{**vars(GOOD), **unknown}), PairEvidence(**{**vars(GOOD), **unknown, **worse})
    assert pair_score(bad) < pair_score(good) and pair_score(good) > 1


def test_a_contradicted_pair_is_never_believed_alone() -> None:
    assert pair_score(GOOD) > 0 >= pair_score(GOOD, contradicted=True)


@pytest.mark.parametrize("degrees", [0.0, 0.01, 7.0, 90.0, 179.0])
def test_rotation_angle(degrees: float) -> None:
    assert rotation_angle_deg(turn(degrees, 0)) == pytest.approx(degrees, abs=1e-6)


def solid_pair(seed: int, lookalikes: bool) -> tuple[Features, Features]:
    """Two views of a solid; with `lookalikes` two thirds of the descriptors have a twin elsewhere in the image."""
    rng = np.random.default_rng(seed)
    X = np.column_stack([rng.uniform(-4, 6, 600), rng.uniform(-3, 3, 600), rng.uniform(9, 15, 600)])
    descriptors = rng.random((600, 128)).astype(np.float32) ** 3
    if lookalikes:
        descriptors[400:] = descriptors[200:400]
    views = []
    for R, C in ((np.eye(3), np.zeros(3)), (turn(-12.0), np.array([2.5, 0.2, 0.3]))):
        x = (X - C) @ R.T @ K.T
        xy = x[:, :2] / x[:, 2:] + rng.normal(0, 0.3, (600, 2))
        seen = np.abs(descriptors + rng.normal(0, 0.03, descriptors.shape).astype(np.float32))
        seen /= np.linalg.norm(seen, axis=1, keepdims=True)
        frames = np.repeat(np.eye(2)[None] * 4, 600, axis=0)
        views.append(Features(xy, frames, seen, np.ones(600, np.float32), np.zeros(600, np.uint8), VIEW))
    return views[0], views[1]


def test_distinctive_matches_are_believed_more_than_twins() -> None:
    scores = []
    for lookalikes in (False, True):
        left, right = solid_pair(1, lookalikes)
        matches = match(left, right)
        assert isinstance(matches, Matches)
        found = estimate_geometry(matches, left, right, min_score=-30.0)
        assert isinstance(found, Geometry)
        scores.append(found.score)
        assert found.good_probability == pytest.approx(probability(found.score))
    assert scores[0] > scores[1] + 2


def test_a_geometry_below_the_least_score_is_rejected_with_its_figures() -> None:
    left, right = solid_pair(2, lookalikes=True)
    matches = match(left, right)
    assert isinstance(matches, Matches)
    found = estimate_geometry(matches, left, right, min_score=30.0)
    assert isinstance(found, Rejected) and found.reason.startswith("wrong") and found.figures["score"] < 30
