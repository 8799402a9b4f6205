"""The demo yard: is its truth true, and do its pictures behave like photographs?"""

from __future__ import annotations

import numpy as np
import pytest

from synthetic_site import small_yard
from wbflow_stages.epipolar import backproject, project
from wbflow_stages.synthetic.yard import yard


def test_the_same_arguments_give_the_same_bytes_on_any_number_of_threads():
    first = yard(2, (96, 54), captures=2, threads=1)
    second = yard(2, (96, 54), captures=2, threads=2)
    for a, b in zip(first.cameras, second.cameras, strict=True):
        assert all(np.array_equal(p, q) for p, q in zip(a.captures, b.captures, strict=True))
        assert np.array_equal(a.depth, b.depth)
    assert np.array_equal(first.reference.points, second.reference.points)


def test_depth_of_one_camera_agrees_with_what_its_neighbour_sees():
    site = small_yard()
    left, right = site.cameras[1], site.cameras[2]
    v, u = np.nonzero(left.depth > 0)
    points = backproject(left.camera, np.column_stack([u, v]).astype(float), left.depth[v, u].astype(float))
    x, z = project(right.camera, points)
    pixel = np.rint(x).astype(int)
    inside = (z > 0) & (pixel >= 0).all(axis=1) & (pixel < (320, 180)).all(axis=1)
    theirs = right.depth[pixel[inside, 1], pixel[inside, 0]]
    ratio = z[inside] / theirs
    assert inside.mean() > 0.6
    assert (np.abs(ratio - 1) < 0.01).mean() > 0.55
    assert (ratio < 0.97).mean() < 0.06  # a point may lie behind what the neighbour sees, hardly ever in front of it


def test_what_is_impossible_is_refused():
    with pytest.raises(ValueError, match="1 to 8 cameras"):
        yard(9, (96, 54))
    with pytest.raises(ValueError, match="at least 1 capture"):
        yard(2, (96, 54), captures=0)
