"""Loops of a site confirm right pairs and expose look-alikes."""

from dataclasses import replace

import numpy as np
import pytest

from wbflow_stages.sfm.loops import WITHOUT_REPETITION, check_loops
from wbflow_stages.twoview.pair_score import probability
from wbflow_stages.types import Geometry, Pair, View

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
    """Cameras on an arc that look at its centre: rotation R and centre C by name."""
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
        homography_share=0.3, score=score, good_probability=probability(score), distinct_cells=20, rival_turned_deg=0.0,
    )  # fmt: skip


def site(count: int, score: float = 2.0, wrong: dict[Pair, float] | None = None) -> dict[Pair, Geometry]:
    """All pairs of a ring; those in `wrong` have another pose, and the score given there."""
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


def test_all_right_pairs_are_accepted_and_all_triangles_close() -> None:
    checks = check_loops(site(5))
    assert all(v.rejected is None for v in checks.values())
    assert all(v.closed == v.triangles == 3 for v in checks.values())
    assert min(v.good_probability for v in checks.values()) > 0.95


@pytest.mark.parametrize("score", [1.0, 3.0])
def test_a_wrong_pair_of_good_score_is_rejected_as_a_look_alike(score: float) -> None:
    checks = check_loops(site(5, wrong={("c1", "c3"): score}))
    assert checks["c1", "c3"].rejected is not None and checks["c1", "c3"].rejected.code == "look-alike"
    assert checks["c1", "c3"].closed == 0 and checks["c1", "c3"].good_probability <= 0.5
    assert all(v.rejected is None for pair, v in checks.items() if pair != ("c1", "c3"))


def test_closed_loops_confirm_a_pair_that_is_doubtful_by_itself() -> None:
    doubtful = site(5)
    doubtful["c0", "c4"] = geometry(*pose(doubtful["c0", "c4"]), score=-0.7)
    assert check_loops(doubtful)["c0", "c4"].rejected is None
    alone = check_loops({("c0", "c4"): doubtful["c0", "c4"]})["c0", "c4"]
    assert alone.rejected is not None and alone.rejected.code == "not-believed"


def pose(g: Geometry) -> tuple[np.ndarray, np.ndarray]:
    assert g.cam2_R_cam1 is not None and g.cam2_t_cam1 is not None
    return g.cam2_R_cam1, g.cam2_t_cam1


def test_unlikely_pairs_do_not_confirm_each_other() -> None:
    """Scores of a square by night: three pairs that agree confuse opposite sides.  Triangles of wrong pairs rarely close here."""
    scores = {("c0", "c1"): 0.93, ("c0", "c3"): -1.32, ("c1", "c2"): -2.94, ("c1", "c3"): -2.3, ("c2", "c3"): -0.67}
    pairs = {pair: replace(site(4)[pair], score=score) for pair, score in scores.items()}
    checks = check_loops(pairs, None, replace(WITHOUT_REPETITION, closed_wrong=0.01))
    assert all(checks[pair].closed == checks[pair].triangles > 0 for pair in scores)
    assert all(checks[pair].rejected is not None for pair, score in scores.items() if score < 0)


def test_a_pair_of_only_two_cameras_needs_a_high_score() -> None:
    pair = next(iter(site(2).values()))
    modest, sure = (check_loops({("a", "b"): geometry(*pose(pair), score=s)})["a", "b"] for s in (0.8, 3.5))
    assert modest.rejected is not None and modest.rejected.code == "unconfirmed"
    assert sure.rejected is None


def test_a_pair_of_score_zero_is_ambiguous() -> None:
    pair = next(iter(site(2).values()))
    check = check_loops({("a", "b"): geometry(*pose(pair), score=0.0)})["a", "b"]
    assert check.rejected is not None and check.rejected.code == "ambiguous"


def test_pairs_without_a_pose_are_judged_by_their_score() -> None:
    some = site(3)
    bare = {p: replace(g, cam2_R_cam1=None, cam2_t_cam1=None, rival_turned_deg=np.nan) for p, g in some.items()}
    checks = check_loops(bare)
    assert all(v.rejected is None and v.triangles == 0 for v in checks.values())
    assert check_loops({}) == {}


def test_the_loop_check_does_not_depend_on_the_order_of_the_pairs() -> None:
    pairs = site(5, wrong={("c0", "c2"): 1.5})
    there, back = check_loops(pairs), check_loops(dict(reversed(pairs.items())))
    assert {p: v.rejected is None for p, v in there.items()} == {p: v.rejected is None for p, v in back.items()}
    assert all(there[p].good_probability == pytest.approx(back[p].good_probability) for p in pairs)


def test_three_pairs_that_contradict_each_other_are_all_rejected() -> None:
    checks = check_loops(site(3, score=6.0, wrong={("c0", "c2"): 6.0}))
    assert all(v.rejected is not None and v.rejected.code == "look-alike" for v in checks.values())


def test_a_single_pair_joins_a_camera_only_if_it_has_a_high_score() -> None:
    pairs = site(4, score=2.0)
    for other in ("c1", "c2"):
        del pairs[other, "c3"]
    modest = check_loops(pairs)["c0", "c3"]
    assert modest.rejected is not None and modest.rejected.code == "unconfirmed"
    pairs["c0", "c3"] = geometry(*pose(pairs["c0", "c3"]), score=4.0)
    assert check_loops(pairs)["c0", "c3"].rejected is None


@pytest.mark.parametrize(("share", "believed"), [(0.2, False), (0.02, True)])
def test_a_building_with_identical_sides_is_rejected(share: float, believed: bool) -> None:
    """Its wrong pairs close all loops, too; only the rivals of most pairs, turned by 90 degrees, reveal them."""
    turned = {p: replace(g, rival_elsewhere=int(share * g.inliers), rival_turned_deg=90.0) for p, g in site(4, score=5.0).items()}
    checks = check_loops(turned)
    assert all((v.rejected is None) == believed for v in checks.values())
    assert believed or {v.rejected.code for v in checks.values() if v.rejected} == {"same-from-other-sides"}


@pytest.mark.parametrize(("degrees", "cells", "code"), [(90.0, 30, "same-from-other-sides"), (90.0, 6, ""), (40.0, 30, "")])
def test_distinct_pairs_in_quarter_turn_conflict_reveal_identical_sides(degrees: float, cells: int, code: str) -> None:
    """Cameras that look at two equal sides seem to be at one place: their pair has a low score, but distinctive matches."""
    pairs = site(4, score=5.0)
    R, t = pose(pairs["c0", "c2"])
    pairs["c0", "c2"] = replace(geometry(turn(degrees) @ R, t, score=-14.0), distinct_cells=cells)
    codes = {v.rejected.code if v.rejected else "" for pair, v in check_loops(pairs).items() if pair != ("c0", "c2")}
    assert codes == {code}


def test_a_triangle_left_open_by_a_guessed_focal_length_contradicts_nothing() -> None:
    """A focal length that is off by a fifth turns rotations by several degrees, a wrong pair by tens of degrees."""
    pairs = site(4, score=4.0)
    for k, pair in enumerate(pairs):
        R, t = pose(pairs[pair])
        pairs[pair] = geometry(turn((8.0, -9.0)[k % 2], axis=k % 3) @ R, t, score=4.0)
    known, guessed = check_loops(pairs), check_loops(pairs, dict.fromkeys(pairs, 12.0))
    assert all(check.rejected is not None for check in known.values())
    assert all(check.rejected is None for check in guessed.values())
    pairs["c0", "c2"] = geometry(turn(40.0, 0) @ pose(pairs["c0", "c2"])[0], pose(pairs["c0", "c2"])[1], score=4.0)
    assert check_loops(pairs, dict.fromkeys(pairs, 12.0))["c0", "c2"].rejected is not None
