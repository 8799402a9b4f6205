"""Scenes seen through other lenses: each kind of lens has the stated field of view and correct ground truth."""

from __future__ import annotations

import numpy as np
import pytest

from wbflow_demo.files import demo_files
from wbflow_demo.render.cameras import MOUNTS, camera_at, with_lenses
from wbflow_demo.render.photograph import DemoSite
from wbflow_demo.scenes import render
from wbflow_stages.core.cameras import project
from wbflow_stages.core.lenses import lens_rays, off_axis

SIZE = (96, 54)


def yard(lenses: str) -> DemoSite:
    return render("yard", size=SIZE, cameras=2, captures=1, lenses=lenses)


def test_a_fisheye_sees_180_degrees_and_its_depth_agrees_with_a_neighbour() -> None:
    site = yard("fisheye")
    pinhole, wide = site.cameras
    height, width = wide.captures[0].shape[:2]
    assert (width, height) == (2 * SIZE[0], 2 * SIZE[1])
    assert wide.lens.K is not None
    edges = np.array([[-0.5, wide.lens.K[1, 2]], [width - 0.5, wide.lens.K[1, 2]]])
    assert np.degrees(off_axis(lens_rays(wide.lens, edges))).sum() == pytest.approx(180, abs=0.5)
    y, x = np.nonzero(wide.depth)
    rays = lens_rays(wide.lens, np.column_stack([x, y]).astype(float))
    X = wide.camera.C + (rays * wide.depth[y, x, None]) @ wide.camera.R
    at, depth = project(pinhole.camera, X)
    with np.errstate(invalid="ignore"):
        inside = (depth > 0) & (at > 0).all(axis=1) & (at < np.array(SIZE) - 1).all(axis=1)
    there = pinhole.depth[tuple(np.rint(at[inside]).astype(int).T[::-1])]
    agree = np.abs(depth[inside] / np.maximum(there, 1e-3) - 1) < 0.03
    assert inside.sum() > 1000
    assert agree.mean() > 0.6  # the rest is hidden from one of the cameras
    assert len(site.reference.points) > 5000


def test_a_strongly_distorted_lens_sees_100_degrees() -> None:
    _, lens = camera_at(with_lenses(MOUNTS[0], 0, "brown"), SIZE)
    assert lens.K is not None
    edges = np.array([[-0.5, lens.K[1, 2]], [SIZE[0] - 0.5, lens.K[1, 2]]])
    assert np.degrees(off_axis(lens_rays(lens, edges))).sum() == pytest.approx(100, abs=1.0)


def test_neighbouring_mixed_cameras_differ_fourfold_in_width() -> None:
    small, large = (with_lenses(MOUNTS[k], k, "mixed").size(SIZE)[0] for k in range(2))
    assert large == 4 * small


def test_an_unknown_kind_of_lenses_is_refused() -> None:
    with pytest.raises(ValueError, match="lenses are standard, fisheye, brown, mixed"):
        demo_files("yard", lenses="fish-eye", small=True, cameras=1, captures=1)
