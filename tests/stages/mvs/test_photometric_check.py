"""Pieces of a wall whose depths are noise: put on the wall's plane where the photographs show them there."""

from __future__ import annotations

import numpy as np

from tests.helpers.weak_wall import HEIGHT, WIDTH, Relief, make_wall
from wbflow_stages.core.cameras import transfer
from wbflow_stages.core.luminance import luminance
from wbflow_stages.mvs.photometric_check import checked_planes
from wbflow_stages.mvs.propagation import Propagation
from wbflow_stages.mvs.textureless import planes_of_regions, textureless_regions
from wbflow_stages.types import Float32s

SCALE, MAX_COST = np.float32(1300.0), 0.4
"""Pixels of a source for a unit of inverse depth: the cameras stand 2.5 and 5 m aside, the wall is 12 m away."""
PIECE = slice(185, 215)
"""Columns: a metre."""


def off_where_put(relief: Relief) -> Float32s:
    """(n,) errors in pixels of what was put on a plane between two pipes, where depths are up to 12 pixels off."""
    wall, rng = make_wall(relief), np.random.default_rng(0)
    camera, frame = wall.cameras[wall.name], wall.frames[wall.name]
    others = [name for name in wall.cameras if name != wall.name]
    M, b = (np.stack(part) for part in zip(*(transfer(camera, wall.cameras[name]) for name in others), strict=True))
    usable = np.ones((HEIGHT, WIDTH), bool)
    usable[:, PIECE.start - 3 : PIECE.start] = usable[:, PIECE.stop : PIECE.stop + 3] = False
    taps = np.array([(0, 0), *((i, j) for i in range(-3, 4) for j in range(-3, 4) if (i + j) % 2 == 0 and (i, j) != (0, 0))])
    sources = np.stack([luminance(wall.frames[name].image) for name in others])
    propagation = Propagation(luminance(frame.image), usable, sources, M, b, taps.astype(np.int32))
    known = (SCALE / wall.truth + rng.normal(0, 0.3, usable.shape)).astype(np.float32)
    known[:, PIECE] += rng.uniform(-12, 12, (HEIGHT, PIECE.stop - PIECE.start)).astype(np.float32)
    planes = np.stack([known / SCALE, np.zeros_like(known), np.zeros_like(known)])
    support, regions = propagation.support(planes, MAX_COST), textureless_regions(frame.image, usable, 1)
    found = planes_of_regions(regions, known, 1)
    checked = checked_planes(regions, found, propagation, support, usable & (support.first < MAX_COST), SCALE, MAX_COST, 1)
    assert checked.doubted[:, PIECE].mean() > 0.5
    assert not checked.doubted[:, : PIECE.start].any()
    off = checked.planes[0] - SCALE / wall.truth
    return np.asarray(off[:, PIECE][np.isfinite(off[:, PIECE])], dtype=np.float32)


def test_a_piece_that_lies_on_the_wall_is_put_there_whatever_its_depths() -> None:
    off = off_where_put(lambda x, z: 0 * x)
    assert len(off) > 0.5 * HEIGHT * (PIECE.stop - PIECE.start)
    assert np.percentile(np.abs(off), 90) < 0.3


def test_a_piece_that_stands_before_the_wall_is_not_put_on_it() -> None:
    off = off_where_put(lambda x, z: np.where(np.abs(x - 1.35) < 0.7, -0.6, 0.0))
    assert len(off) < 0.1 * HEIGHT * (PIECE.stop - PIECE.start)
