"""Labelled pairs of many scenes for fitting the score of a pair; measured once and stored with the renderings."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations, product
from pathlib import Path
from typing import TYPE_CHECKING, cast

import numpy as np
from pairs_with_truth import TrueView, correct, photographed, pose_error_deg, rendered_scene
from verdict_fit import LabelledPair, LabelledSet

from wbflow.cache.artifact import decode, encode
from wbflow_stages.geometry import estimate_geometry
from wbflow_stages.matches import match
from wbflow_stages.types import Float64s, Geometry, Matches

if TYPE_CHECKING:
    from wbflow_demo.render.photograph import Daytime

SETS = (
    "fountain-768", "entry-768", "nothing", "yard-day", "yard-night", "square-day", "square-night",
    "hall-day", "hall-2-day", "hall-4-day", "houses-day", "carpark-day", "containers-day", "apron-day", "stadium-day",
)  # fmt: skip
"""Photographed sets by scene and width, demo sets by scene and light; nothing: views of fountain paired with views of entry."""
TURNS = {"hall": 4, "hall-2": 2, "hall-4": 4}
"""Rotational symmetry of the halls: each looks the same after 1/n of a turn (`hall` except for a few small things)."""

REPEATING = ("hall", "houses", "containers")
"""Scenes that look the same from several sides, or along a row."""


def scene_of(name: str) -> str:
    """The scene of a set; all its lights and symmetries are left out of a fit together."""
    return name.split("-")[0]


def labelled(name: str, cache: Path) -> LabelledSet:
    """The labelled pairs of a set that have a geometry, from the cache or measured now."""
    file = cache / f"verdict-{name}.pairs"
    if not file.exists():
        views = _views(name, cache)
        related = name != "nothing"
        pairs = [pair for a, b in _pairs(name, views) if (pair := _measured(name, a, b, related)) is not None]
        file.write_bytes(encode(LabelledSet(tuple(pairs), {view.name: view.camera for view in views})))
    found: LabelledSet = decode(file.read_bytes())
    return found


def symmetry(name: str) -> list[Float64s]:
    """Rotations about the vertical axis after which the scene of a set looks the same."""
    count = TURNS.get(name.rpartition("-")[0], 1)
    return [_turn(2 * np.pi * k / count) for k in range(count)]


def _turn(angle: float) -> Float64s:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])


def _pairs(name: str, views: list[TrueView]) -> list[tuple[TrueView, TrueView]]:
    if name == "nothing":
        fountain, entry = ([view for view in views if view.scene == scene] for scene in ("fountain", "entry"))
        return list(product(fountain, entry))
    return list(combinations(views, 2))


def _views(name: str, cache: Path) -> list[TrueView]:
    scene, _, rest = name.rpartition("-")
    if name == "nothing":
        return [*photographed("fountain", 768, list("01234")).values(), *photographed("entry", 768).values()]
    if scene in ("fountain", "entry"):
        return list(photographed(scene, int(rest)).values())
    return list(rendered_scene(scene, cast("Daytime", rest), cache).values())


def _measured(name: str, left: TrueView, right: TrueView, related: bool) -> LabelledPair | None:
    """A labelled pair; None if matching or geometry reject it."""
    matches = match(left.features, right.features)
    if not isinstance(matches, Matches):
        return None
    g = estimate_geometry(matches, left.features, right.features, min_score=-1000.0)
    if not isinstance(g, Geometry):
        return None
    errors = (180.0, 180.0), (180.0, 180.0)
    if related:
        errors = _errors(left, right, g, [np.eye(3)]), _errors(left, right, g, symmetry(name))
    good, judged = correct(left, right, g.x1, g.x2) if related else (0, 1)
    return LabelledPair(name, left.name, right.name, g, *errors, right_share=good / max(judged, 1))


def _errors(left: TrueView, right: TrueView, g: Geometry, turns: list[Float64s]) -> tuple[float, float]:
    """Errors of the pose against the nearest symmetric copy of the right camera."""
    found = []
    for turn in turns:
        copy = replace(right.camera, R=right.camera.R @ turn.T, C=turn @ right.camera.C)
        if np.linalg.norm(copy.C - left.camera.C) > 1e-6:
            found.append(pose_error_deg(left.camera, copy, g.cam2_R_cam1, g.cam2_t_cam1))
    return min(found)
