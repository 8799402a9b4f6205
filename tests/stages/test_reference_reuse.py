"""Geometries and poses of the reference, corrected for cameras that have turned or moved since."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tests.helpers.exact_pairs import PairSite, make_pair_site, pair_geometry
from wbflow_stages.core.cameras import project
from wbflow_stages.core.epipolar import symmetric_epipolar_distance
from wbflow_stages.core.rotations import angle_between_deg, rotation_matrix
from wbflow_stages.reference_reuse import hold_poses, turn_geometry
from wbflow_stages.types import CalibrationCheck, Camera, CameraHealth, Geometry, Poses

OK = CameraHealth("ok", "where it was")
TURN = rotation_matrix(np.radians([0.1, -0.2, 0.05]))


def nudged(camera: Camera) -> CameraHealth:
    """Health of a camera that has turned by TURN."""
    return CameraHealth("shifted", "turned", corrected=True, turn=TURN, homography=camera.K @ TURN @ np.linalg.inv(camera.K))


def reference(site: PairSite) -> Poses:
    cameras = site.cameras
    return Poses(
        cameras, metric=True, source="calibration", components=(tuple(cameras),), sources=dict.fromkeys(cameras, "stated")
    )


def tonight(site: PairSite, cameras: dict[str, Camera]) -> dict[tuple[str, str], Geometry]:
    """Geometries of the pairs as these cameras give them."""
    pixels = {name: project(camera, site.X)[0] for name, camera in cameras.items()}
    return {pair: pair_geometry(cameras, site.views, pixels, pair, 0.0) for pair in site.geometries}


def test_the_geometry_of_a_turned_camera_fits_its_new_direction() -> None:
    site = make_pair_site(3)
    cameras = {**site.cameras, "c1": replace(site.cameras["c1"], R=TURN @ site.cameras["c1"].R)}
    for pair, health in {("c0", "c1"): (OK, nudged(cameras["c1"])), ("c1", "c2"): (nudged(cameras["c1"]), OK)}.items():
        turned = turn_geometry(site.geometries[pair], *health)
        assert isinstance(turned, Geometry)
        true = tonight(site, cameras)[pair]
        assert symmetric_epipolar_distance(turned.F, true.x1, true.x2).max() < 1e-6
        assert symmetric_epipolar_distance(true.F, turned.x1, turned.x2).max() < 1e-6
        assert turned.cam2_R_cam1 is not None
        assert true.cam2_R_cam1 is not None
        assert np.abs(turned.cam2_R_cam1 - true.cam2_R_cam1).max() < 1e-9


def test_the_geometry_of_unmoved_cameras_stays_unchanged() -> None:
    site = make_pair_site(2)
    turned = turn_geometry(site.geometries["c0", "c1"], OK, OK)
    assert isinstance(turned, Geometry)
    assert np.allclose(np.abs(turned.F), np.abs(site.geometries["c0", "c1"].F))
    assert len(turned.x1) == len(site.geometries["c0", "c1"].x1)


def test_a_turned_camera_is_corrected_and_the_others_stay_unchanged() -> None:
    site = make_pair_site(4)
    healths = dict.fromkeys(site.cameras, OK) | {"c2": nudged(site.cameras["c2"])}
    found = hold_poses(reference(site), healths, site.views, {})
    assert isinstance(found, Poses)
    assert np.array_equal(found.cameras["c2"].R, TURN @ site.cameras["c2"].R)
    assert all(found.cameras[n] is site.cameras[n] for n in ("c0", "c1", "c3"))
    assert found.sources["c2"] == "corrected"
    assert any("c2" in note for note in found.notes)


def test_a_moved_camera_is_solved_from_the_others() -> None:
    site = make_pair_site(5)
    away = rotation_matrix(np.radians([2.0, -3.0, 1.0]))
    at = site.cameras["c2"]
    now = {**site.cameras, "c2": replace(at, R=away @ at.R, C=at.C + np.array([0.4, -0.2, 0.1]))}
    healths = dict.fromkeys(site.cameras, OK) | {"c2": CameraHealth("moved", "turned by 3.7 degrees")}
    found = hold_poses(reference(site), healths, site.views, tonight(site, now))
    assert isinstance(found, Poses)
    assert np.linalg.norm(found.cameras["c2"].C - now["c2"].C) < 1e-3
    assert angle_between_deg(found.cameras["c2"].R, now["c2"].R) < 0.01
    assert found.sources["c2"] == "solved"
    for name in ("c0", "c1", "c3", "c4"):
        assert np.array_equal(found.cameras[name].R, site.cameras[name].R)
        assert np.array_equal(found.cameras[name].C, site.cameras[name].C)


def test_captures_exchanged_since_the_reference_are_detected() -> None:
    """Both cameras look elsewhere; the check of tonight is reported instead of the reference's, whose calibration was right."""
    site = make_pair_site(6)
    right = replace(reference(site), calibration=CalibrationCheck(900, 6, True, 1.0))
    one, other = site.cameras["c1"], site.cameras["c4"]
    now = site.cameras | {"c1": replace(other, K=one.K), "c4": replace(one, K=other.K)}
    healths = dict.fromkeys(site.cameras, OK) | dict.fromkeys(("c1", "c4"), CameraHealth("moved", "looks elsewhere"))
    found = hold_poses(right, healths, site.views, tonight(site, now))
    assert isinstance(found, Poses) and found.calibration is not None
    assert found.calibration.contradicted and set(found.calibration.cameras) == {"c1", "c4"}
    assert "exchanged" in found.calibration.cause


def test_a_moved_camera_without_shared_matches_is_left_out_with_the_reason() -> None:
    site = make_pair_site(4)
    healths = dict.fromkeys(site.cameras, OK) | {"c3": CameraHealth("moved", "turned by 40 degrees")}
    found = hold_poses(reference(site), healths, site.views, {})
    assert isinstance(found, Poses)
    assert set(found.cameras) == {"c0", "c1", "c2"}
    assert "moved" in found.unsolved["c3"]
    assert found.components == (("c0", "c1", "c2"),)
