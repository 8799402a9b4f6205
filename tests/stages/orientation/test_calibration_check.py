"""A stated calibration that is wrong as a whole is detected and its cause named; a right one is not contradicted."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from itertools import pairwise

import cv2
import numpy as np
import pytest

from tests.helpers.exact_pairs import PairSite, make_pair_site, pair_geometry, turned_wrong
from wbflow_stages.core.cameras import project
from wbflow_stages.core.epipolar import fundamental_from_cameras
from wbflow_stages.core.rotations import rotation_matrix
from wbflow_stages.orientation.calibration_check import CORNER, check_calibration, check_rows, check_solved_lens
from wbflow_stages.poses import solve_poses
from wbflow_stages.types import Camera, Geometry, Pair, Placement, Poses, RowMatches

Change = Callable[[str, Camera], Camera]


def zoomed(factor: float, vertical: float | None = None) -> Change:
    """vertical: factor of the vertical focal length, if it is another one."""

    def change(name: str, camera: Camera) -> Camera:
        K = camera.K.copy()
        K[[0, 1], [0, 1]] *= factor, factor if vertical is None else vertical
        return replace(camera, K=K)

    return change


def shifted(pixels: float) -> Change:
    def change(name: str, camera: Camera) -> Camera:
        K = camera.K.copy()
        K[0, 2] += pixels
        return replace(camera, K=K)

    return change


def from_corner(name: str, camera: Camera) -> Camera:
    K = camera.K.copy()
    K[:2, 2] += 0.5
    return replace(camera, K=K)


def tilted(name: str, camera: Camera) -> Camera:
    return replace(camera, R=rotation_matrix(np.radians([0.2, 0.0, 0.0])) @ camera.R)


def only_for(one: str, change: Change) -> Change:
    return lambda name, camera: change(name, camera) if name == one else camera


def turned(name: str, camera: Camera) -> Camera:
    return replace(camera, R=rotation_matrix(np.radians([0.0, 0.5, 0.0])) @ camera.R)


def mirrored(name: str, camera: Camera) -> Camera:
    return replace(camera, C=camera.C * [-1, 1, 1])


@pytest.fixture(scope="module")
def site() -> PairSite:
    return make_pair_site(6, noise_px=0.3)


def stated(site: PairSite, change: Change) -> dict[str, Camera]:
    return {name: change(name, camera) for name, camera in site.cameras.items()}


@pytest.mark.parametrize("cameras", [3, 4, 8])
@pytest.mark.parametrize("noise_px", [0.0, 0.3, 0.8])
def test_a_right_calibration_is_not_contradicted(cameras: int, noise_px: float) -> None:
    site = make_pair_site(cameras, noise_px=noise_px)
    check = check_calibration(site.cameras, site.geometries)
    assert check is not None and check.confirmed
    assert not check.contradicted
    assert check.misfit < 1.3


@pytest.mark.parametrize(
    ("change", "cause", "amount"),
    [
        (zoomed(1.10), "focal-lengths", -np.log(1.10)),
        (zoomed(0.97), "focal-lengths", -np.log(0.97)),
        (zoomed(1.06, 1.0), "pixel-shape", -np.log(1.06)),
        (zoomed(1.0, 1.04), "pixel-height", -np.log(1.04)),
        (shifted(8.0), "principal-points", None),
        (only_for("c2", turned), "turned", None),
        (mirrored, "mirrored-x", None),
        (lambda _, c: replace(c, R=c.R.T), "rotations-transposed", None),
        (lambda _, c: replace(c, R=np.diag([1.0, -1.0, -1.0]) @ c.R), "rotations-opengl", None),
        (lambda _, c: replace(c, C=-c.R @ c.C), "t-for-positions", None),
        (lambda _, c: replace(c, C=c.C[[1, 0, 2]]), "axes-exchanged", None),
        (lambda _, c: replace(c, C=c.C * [1.05, 1, 1]), "stretched-x", -np.log(1.05)),
        (lambda _, c: replace(c, C=c.C * [1, 1, 1.2]), "stretched-z", -np.log(1.2)),
        (lambda _, c: replace(c, R=c.R @ rotation_matrix(np.array([0.0, 0.0, -0.03]))), "headings", 0.03),
        (lambda _, c: replace(c, R=rotation_matrix(np.array([0.0, 0.0, -0.03])) @ c.R), "rolls", 0.03),
    ],
)
def test_the_cause_of_a_wrong_calibration_is_named(site: PairSite, change: Change, cause: str, amount: float | None) -> None:
    check = check_calibration(stated(site, change), site.geometries)
    assert check is not None and check.contradicted
    assert check.cause == cause
    if amount is not None:
        assert check.amount[0] == pytest.approx(amount, abs=0.005)


def rows_of(site: PairSite, pairs: Iterable[Pair], sigma_px: float = 0.05) -> dict[Pair, RowMatches]:
    """Row matches that dense matching would measure at points of a site, with noise of `sigma_px` in the second view."""
    rng = np.random.default_rng(8)
    found = {}
    for pair in pairs:
        x1, x2 = (project(site.cameras[name], site.X)[0][::12] for name in pair)
        found[pair] = RowMatches(x1, x2 + rng.normal(0, sigma_px, x2.shape), np.full(len(x1), sigma_px))
    return found


@pytest.mark.parametrize(
    ("change", "cause"),
    [
        (zoomed(1.0), ""),
        (from_corner, CORNER),
        (zoomed(1.02), "focal-lengths"),
        (zoomed(1.012), "focal-lengths"),
        (zoomed(1.0003), ""),
        (zoomed(1.03, 1.0), "pixel-shape"),
        (tilted, "principal-points"),
        (only_for("c2", turned), "turned"),
        (lambda _, c: replace(c, C=c.C * [1.001, 1, 1]), ""),
    ],
)
@pytest.mark.parametrize("chain_only", [False, True])
def test_rows_reveal_errors_that_are_too_small_for_keypoints(change: Change, cause: str, chain_only: bool) -> None:
    """chain_only: only a chain of pairs, in which no third camera can confirm a match."""
    site = make_pair_site(6, degrees=30.0)
    pairs = list(pairwise(site.cameras)) if chain_only else list(site.geometries)
    check = check_rows(stated(site, change), rows_of(site, pairs))
    assert check is not None
    assert (check.cause, check.contradicted) == (cause, bool(cause))


@pytest.mark.parametrize("count", [1, 2, 3])
@pytest.mark.parametrize(("factor", "contradicted"), [(1.0, False), (1.03, True)])
def test_rows_of_few_pairs_reveal_wrong_focal_lengths(count: int, factor: float, contradicted: bool) -> None:
    site = make_pair_site(6, degrees=30.0)
    check = check_rows(stated(site, zoomed(factor)), rows_of(site, list(site.geometries)[:count]))
    assert check is not None
    assert check.contradicted == contradicted


def test_half_of_the_half_pixel_in_three_pairs_does_not_blame_the_corner() -> None:
    def half_from_corner(name: str, camera: Camera) -> Camera:
        return replace(camera, K=(camera.K + from_corner(name, camera).K) / 2)

    site = make_pair_site(6, degrees=30.0)
    causes = []
    for count in (3, len(site.geometries)):
        check = check_rows(stated(site, half_from_corner), rows_of(site, list(site.geometries)[:count]))
        causes.append(check.cause if check else None)
    assert causes[0] != CORNER
    assert causes[1] == CORNER


def test_a_pair_alone_does_not_blame_a_camera_for_its_rows() -> None:
    """A move of c1 towards c2 leaves their epipolar lines; so only its pair with c0 speaks for it, and may match look-alikes."""
    site = make_pair_site(6, degrees=30.0)
    towards = site.cameras["c2"].C - site.cameras["c1"].C
    moved = replace(site.cameras["c1"], C=site.cameras["c1"].C + 0.2 * towards / np.linalg.norm(towards))
    rows = rows_of(site, pairwise(site.cameras))
    assert not _contradicts(site.cameras | {"c1": moved}, rows)
    assert _contradicts(site.cameras | {"c1": moved}, rows | rows_of(site, [("c1", "c3")]))


def _contradicts(cameras: dict[str, Camera], rows: dict[Pair, RowMatches]) -> bool:
    check = check_rows(cameras, rows)
    assert check is not None
    return check.contradicted


def test_rows_confirm_a_calibration_only_if_as_many_pairs_as_cameras_connect_all() -> None:
    site = make_pair_site(6, degrees=30.0)
    pairs = list(site.geometries)
    checks = [
        check_rows(site.cameras, rows_of(site, chosen))
        for chosen in (pairs, list(pairwise(site.cameras)), [pair for pair in pairs if "c5" not in pair])
    ]
    assert [check is not None and check.confirmed for check in checks] == [True, False, False]


def test_no_rows_give_no_result() -> None:
    site = make_pair_site(6, degrees=30.0)
    assert check_rows(site.cameras, {}) is None


def test_two_exchanged_poses_are_named(site: PairSite) -> None:
    cameras = dict(site.cameras)
    one, other = list(cameras)[1], list(cameras)[4]
    a, b = cameras[one], cameras[other]
    cameras |= {one: replace(a, R=b.R, C=b.C), other: replace(b, R=a.R, C=a.C)}
    check = check_calibration(cameras, site.geometries)
    assert check is not None and (check.cause, set(check.cameras)) == ("exchanged", {one, other})


def test_exchanged_captures_are_named(site: PairSite) -> None:
    """Lenses differ, so that exchanged poses explain the matches less well than exchanged captures."""
    lenses = [zoomed(1 + 0.1 * k) for k in range(len(site.cameras))]
    pixels = {name: lens(name, camera) for lens, (name, camera) in zip(lenses, site.cameras.items(), strict=True)}
    shown = {name: project(camera, site.X)[0] for name, camera in pixels.items()}
    geometries = {pair: pair_geometry(pixels, site.views, shown, pair, 0.3) for pair in site.geometries}
    one, other = list(pixels)[1], list(pixels)[4]
    check = check_calibration(pixels | {one: pixels[other], other: pixels[one]}, geometries)
    assert check is not None and (check.cause, set(check.cameras)) == ("captures-exchanged", {one, other})


@pytest.mark.parametrize("factor", [-1.0, 3.0])
def test_distortion_with_the_wrong_sign_or_size_is_named(site: PairSite, factor: float) -> None:
    """Each lens has its own distortion; the images were undistorted with `factor` times that."""
    rng = np.random.default_rng(2)
    right = {name: replace(c, distortion=np.array([rng.uniform(-0.2, -0.05), 0, 0, 0, 0])) for name, c in site.cameras.items()}
    wrong = {name: replace(c, distortion=factor * c.distortion) for name, c in right.items()}
    shown = {}
    for name, camera in right.items():
        ray = (project(camera, site.X)[0] - camera.K[:2, 2]) / camera.K[0, 0]
        rays = np.column_stack([ray, np.ones(len(ray))])
        captured = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), camera.K, camera.distortion)[0]
        shown[name] = cv2.undistortPoints(captured, camera.K, wrong[name].distortion, P=camera.K)[:, 0]
    geometries = {pair: _fitted(pair_geometry(right, site.views, shown, pair, 0.3)) for pair in site.geometries}
    check = check_calibration(wrong, geometries)
    assert check is not None and check.cause == "distortion-factor"
    assert 1 + check.amount[0] == pytest.approx(1 / factor, abs=0.1)


def test_randomly_wrong_poses_are_contradicted_without_a_named_cause(site: PairSite) -> None:
    rng = np.random.default_rng(4)
    cameras = {name: replace(c, R=rotation_matrix(rng.normal(0, 0.005, 3)) @ c.R) for name, c in site.cameras.items()}
    check = check_calibration(cameras, site.geometries)
    assert check is not None and (check.contradicted, check.cause) == (True, "")


def test_cameras_without_poses_confirm_matches_of_posed_cameras(site: PairSite) -> None:
    """Only two cameras have stated poses, one of them a wrong one."""
    names = list(site.cameras)
    two = {names[0]: site.cameras[names[0]], names[1]: turned(names[1], site.cameras[names[1]])}
    check = check_calibration(two, site.geometries)
    assert check is not None and (check.confirmed, check.contradicted) == (True, True)


def chain_of_pairs(site: PairSite, wrong: int) -> dict[Pair, Geometry]:
    """Only pairs of neighbours, so that no third camera confirms a match; the last `wrong` of them are look-alikes."""
    pairs = list(pairwise(site.cameras))
    right = len(pairs) - wrong
    return {pair: site.geometries[pair] if k < right else turned_wrong(site, pair, k) for k, pair in enumerate(pairs)}


@pytest.mark.parametrize(
    ("change", "cause"),
    [
        (zoomed(1.05), "focal-lengths"),
        (zoomed(1.2, 1.0), "pixel-shape"),
        (shifted(40.0), "principal-points"),
        (mirrored, "mirrored-x"),
        (lambda name, camera: replace(camera, C=camera.C * [1, 1, 1.2]), "stretched-z"),
        (lambda name, camera: replace(camera, R=camera.R.T), "rotations-transposed"),
    ],
)
def test_a_cause_that_explains_most_unconfirmed_pairs_is_named(change: Change, cause: str) -> None:
    site = make_pair_site(6, seed=1, noise_px=0.3)
    check = check_calibration(stated(site, change), chain_of_pairs(site, 2))
    assert check is not None and not check.confirmed
    assert (check.contradicted, check.cause) == (True, cause)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("wrong", [1, 2, 3, 5])
def test_look_alikes_in_some_pairs_do_not_contradict_a_right_calibration(seed: int, wrong: int) -> None:
    site = make_pair_site(6, seed=seed, noise_px=0.3)
    check = check_calibration(site.cameras, chain_of_pairs(site, wrong))
    assert check is not None and not check.contradicted


def test_look_alikes_in_a_single_pair_do_not_contradict_its_poses(site: PairSite) -> None:
    """The matches of two cameras are shifted in the second image, and obey epipolar lines of their own."""
    pair, geometry = next(iter(site.geometries.items()))
    wrong = replace(geometry, x2=geometry.x2 + np.array([40.0, 15.0]), F=_f_of_shifted_image2(geometry, [40.0, 15.0]))
    check = check_calibration({name: site.cameras[name] for name in pair}, {pair: wrong})
    assert check is not None and not check.confirmed
    assert not check.contradicted


def test_displaced_matches_among_right_ones_do_not_contradict_a_calibration(site: PairSite) -> None:
    names = list(site.cameras)[:3]
    geometries = {}
    for pair, geometry in site.geometries.items():
        if set(pair) <= set(names):
            x1, x2 = geometry.x1.copy(), geometry.x2.copy()
            few = np.arange(len(x1)) % 5 == 0
            x2[few] += [6.0, 25.0]
            geometries[pair] = replace(geometry, x1=x1, x2=x2)
    check = check_calibration({name: site.cameras[name] for name in names}, geometries)
    assert check is not None and not check.contradicted


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_look_alikes_among_few_matches_do_not_contradict_all_poses(seed: int) -> None:
    """Rows of equal seats: 5 of the 24 matches that third cameras confirm are of another seat and obey other epipolar lines.  All
    24 have more noise than the other matches, from which the noise is estimated."""
    site, rng = make_pair_site(3, points=3000), np.random.default_rng(seed)
    rolled = {
        name: replace(camera, R=rotation_matrix(np.radians([0, 0, degrees])) @ camera.R)
        for (name, camera), degrees in zip(site.cameras.items(), (0, -1, 1), strict=True)
    }
    off_centre = np.linalg.norm(project(site.cameras["c2"], site.X)[0] - site.cameras["c2"].K[:2, 2], axis=1)
    others, near = np.argsort(-off_centre)[100:105], np.argsort(off_centre)[:319]
    shared = np.concatenate([others, near[:19]])
    x = {name: project(camera, site.X)[0] for name, camera in site.cameras.items()}
    for name in x:
        x[name][others] = project(rolled[name], site.X[others])[0]
    x = {name: pixels + rng.normal(0, 0.3, pixels.shape) for name, pixels in x.items()}
    for pixels in x.values():
        pixels[shared] += rng.normal(0, 0.5, (len(shared), 2))
    geometries = {}
    for k, (pair, geometry) in enumerate(site.geometries.items()):
        rows = np.concatenate([shared, near[19 + k :: 3]])
        F = fundamental_from_cameras(rolled[pair[0]], rolled[pair[1]])
        x1, x2 = (x[name][rows] for name in pair)
        geometries[pair] = replace(
            geometry, F=F, x1=x1, x2=x2, i1=None, i2=None, probability=np.ones(len(rows), np.float32), noise_px=None
        )
    check = check_calibration(site.cameras, geometries)
    assert check is not None and check.confirmed and not check.contradicted
    turned_apart = {name: replace(c, R=rotation_matrix(rng.normal(0, 0.01, 3)) @ c.R) for name, c in site.cameras.items()}
    check = check_calibration(turned_apart, geometries)
    assert check is not None and check.contradicted


def test_without_matches_there_is_no_calibration_check(site: PairSite) -> None:
    assert check_calibration(site.cameras, {}) is None


def test_solved_poses_carry_the_calibration_check(site: PairSite) -> None:
    views = {name: replace(view, K=zoomed(1.1)(name, site.cameras[name]).K) for name, view in site.views.items()}
    placements = {name: Placement(camera.R, camera.C) for name, camera in site.cameras.items()}
    poses = solve_poses(views, placements, site.geometries)
    assert isinstance(poses, Poses) and poses.calibration is not None
    assert poses.calibration.cause == "focal-lengths"


@pytest.mark.parametrize("factor", [0.95, 1.0, 1.05])
def test_a_wrong_focal_length_of_a_solved_camera_is_named(site: PairSite, factor: float) -> None:
    """Its pose adapts to it, so that its matches stay near their epipolar lines."""
    views = {
        name: replace(view, K=only_for("c2", zoomed(factor))(name, site.cameras[name]).K) for name, view in site.views.items()
    }
    placements = {name: Placement(camera.R, camera.C) for name, camera in site.cameras.items() if name != "c2"}
    placements["c2"] = Placement()
    poses = solve_poses(views, placements, site.geometries)
    assert isinstance(poses, Poses) and poses.calibration is not None and poses.sources["c2"] == "solved"
    check = poses.calibration
    if factor == 1.0:
        assert not check.contradicted
    else:
        assert (check.contradicted, check.cause, check.cameras) == (True, "focal-length", ("c2",))
        assert check.amount == pytest.approx([-np.log(factor)], abs=0.005)


@pytest.mark.parametrize("factor", [0.95, 1.0, 1.05])
def test_one_solved_camera_beside_two_stated_ones_reveals_wrong_focal_lengths(factor: float) -> None:
    site = make_pair_site(3, noise_px=0.3)
    views = {name: replace(view, K=zoomed(factor)(name, site.cameras[name]).K) for name, view in site.views.items()}
    placements = {name: Placement(camera.R, camera.C) for name, camera in site.cameras.items()} | {"c1": Placement()}
    poses = solve_poses(views, placements, site.geometries)
    assert isinstance(poses, Poses) and poses.calibration is not None and poses.sources["c1"] == "solved"
    assert poses.calibration.cause == ("focal-lengths" if factor != 1.0 else "")


def test_one_pair_does_not_blame_the_lens_of_a_solved_camera(site: PairSite) -> None:
    cameras = {name: only_for("c1", zoomed(1.05))(name, site.cameras[name]) for name in ("c0", "c1", "c2")}
    assert check_solved_lens("c1", cameras, site.geometries) is not None
    del cameras["c2"]
    assert check_solved_lens("c1", cameras, site.geometries) is None


@pytest.mark.parametrize("seed", range(5))
def test_look_alikes_in_one_pair_do_not_blame_the_lens_of_a_solved_camera(site: PairSite, seed: int) -> None:
    pair = ("c1", "c2")
    geometries = {**site.geometries, pair: turned_wrong(site, pair, seed)}
    assert check_solved_lens("c1", site.cameras, geometries) is None


def _fitted(geometry: Geometry) -> Geometry:
    """The geometry with F refitted to all of its matches."""
    F, _ = cv2.findFundamentalMat(geometry.x1, geometry.x2, cv2.FM_8POINT)
    return replace(geometry, F=np.asarray(F))


def _f_of_shifted_image2(geometry: Geometry, by: list[float]) -> np.ndarray:
    """F after all pixels of image 2 have been shifted by `by`."""
    T = np.eye(3)
    T[:2, 2] = -np.array(by)
    return np.asarray(T.T @ geometry.F)
