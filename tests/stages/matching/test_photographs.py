"""Photographed pairs: more right matches than with the kd-tree, poses to a fraction of a degree, unrelated views rejected."""

import json
import os
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.helpers.images import read_image
from wbflow_stages.core.cameras import relative_pose, scaled_intrinsics
from wbflow_stages.core.epipolar import fundamental_from_cameras, symmetric_epipolar_distance
from wbflow_stages.core.rotations import angle_between_deg
from wbflow_stages.features import detect
from wbflow_stages.geometry import estimate_geometry
from wbflow_stages.matches import match
from wbflow_stages.types import Camera, Features, Frame, Geometry, Matches, Rejected, View

DATA = Path(os.environ.get("WBFLOW_DATA") or Path(__file__).resolve().parents[4] / "shared" / "data")
pytestmark = pytest.mark.skipif(not (DATA / "fountain").exists(), reason=f"no photographs in {DATA}")
WIDTH = 768


@cache
def view(scene: str, number: int) -> tuple[Features, Camera]:
    name = f"{number:04d}.jpg"
    c = json.loads((DATA / scene / "cameras.json").read_text())[name]
    pixels = read_image(DATA / scene / "images" / name)[..., ::-1]
    s = WIDTH / pixels.shape[1]
    image = np.ascontiguousarray(cv2.resize(pixels, None, fx=s, fy=s, interpolation=cv2.INTER_AREA))
    h, w = image.shape[:2]
    K = scaled_intrinsics(np.array(c["K"]), s, s)
    found = detect(Frame(image.astype(np.uint8), np.ones((h, w), bool), View(w, h, K)))
    assert isinstance(found, Features)
    return found, Camera(K, np.array(c["R"]), np.array(c["C"]), w, h)


def pair(left: int, right: int, **options: object) -> tuple[Matches, int]:
    """Matches of a pair of the fountain, and how many are within 1.5 pixels of their true epipolar lines."""
    (f, cam1), (g, cam2) = view("fountain", left), view("fountain", right)
    found = match(f, g, **options)  # type: ignore[arg-type]
    assert isinstance(found, Matches)
    distance = symmetric_epipolar_distance(fundamental_from_cameras(cam1, cam2), found.x1, found.x2)
    return found, int((distance < 1.5).sum())


@pytest.mark.parametrize(
    ("left", "right", "gain", "precision"), [(5, 4, 1.0, 0.92), (5, 2, 1.2, 0.85), (5, 9, 1.5, 0.75), (2, 9, 1.3, 0.62)]
)
def test_the_structural_matcher_finds_more_right_matches_than_the_kdtree(
    left: int, right: int, gain: float, precision: float
) -> None:
    structural, good = pair(left, right, tilt="never")
    _, kdtree_good = pair(left, right, matcher="kdtree")
    assert good > gain * kdtree_good
    assert good > precision * len(structural.x1)


@pytest.mark.parametrize(("left", "right"), [(5, 4), (5, 1), (5, 9), (5, 10)])
def test_the_relative_pose_is_right_to_a_fraction_of_a_degree(left: int, right: int) -> None:
    (f, cam1), (g, cam2) = view("fountain", left), view("fountain", right)
    matches, _ = pair(left, right)
    found = estimate_geometry(matches, f, g)
    assert isinstance(found, Geometry) and found.cam2_R_cam1 is not None and found.cam2_t_cam1 is not None
    R, t = relative_pose(cam1, cam2)
    assert angle_between_deg(R, found.cam2_R_cam1) < 0.3
    assert np.degrees(np.arccos(found.cam2_t_cam1 @ t / np.linalg.norm(t))) < 0.8
    assert found.good_probability > 0.8


@pytest.mark.parametrize(("left", "right"), [(0, 5), (2, 2), (4, 6)])
def test_views_of_different_scenes_are_rejected(left: int, right: int) -> None:
    f, g = view("fountain", left)[0], view("entry", right)[0]
    matches = match(f, g)
    found = estimate_geometry(matches, f, g) if isinstance(matches, Matches) else matches
    assert isinstance(found, Rejected) or found.score < 0
