"""Labelled pairs of many scenes, for the score of a pair: measured once, kept as JSON beside the renderings."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from itertools import combinations, product
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from pairs_with_truth import TrueView, photographed, pose_error_deg, rendered_scene
from verdict_fit import LabelledPair

from wbflow_stages.geometry import estimate_geometry
from wbflow_stages.matches import match
from wbflow_stages.twoview.pair_score import PairEvidence
from wbflow_stages.twoview.rivals import Rival
from wbflow_stages.types import Float64s, Geometry, Matches

if TYPE_CHECKING:
    from wbflow_stages.synthetic.shots import Daytime

SETS = (
    "fountain-768", "entry-768", "nothing", "yard-day", "yard-night", "square-day", "square-night",
    "hall-day", "hall-2-day", "hall-4-day", "houses-day", "carpark-day", "containers-day",
)  # fmt: skip
"""Photographs by scene and width, demo scenes by name and light; nothing: views of fountain with views of entry."""
TURNS = {"hall": 4, "hall-2": 2, "hall-4": 4}
"""A hall looks the same after this part of a turn (the first but for a few small things)."""

REPEATING = ("hall", "houses", "containers")
"""Scenes that look the same from other sides or along a row."""


def scene_of(name: str) -> str:
    """What is left out together: a scene by all lights and with all symmetries."""
    return name.split("-")[0]


def labelled(name: str, cache: Path) -> list[LabelledPair]:
    """The pairs of a set that have a geometry."""
    file = cache / f"verdict-{name}.json"
    if not file.exists():
        related = name != "nothing"
        rows = [row for a, b in _pairs(name, cache) if (row := _measured(name, a, b, related)) is not None]
        file.write_text(json.dumps(rows))
    return [_restored(row) for row in json.loads(file.read_text())]


def true_rotations(name: str, cache: Path) -> dict[str, Float64s]:
    """World to camera, of each camera of a set."""
    file = cache / f"verdict-{name}-rotations.json"
    if not file.exists():
        file.write_text(json.dumps({view.name: view.camera.R.tolist() for view in _views(name, cache).values()}))
    return {camera: np.array(R) for camera, R in json.loads(file.read_text()).items()}


def symmetry(name: str) -> list[Float64s]:
    """Turns about the vertical after which the scene of a set looks the same."""
    count = TURNS.get(name.rpartition("-")[0], 1)
    return [_turn(2 * np.pi * k / count) for k in range(count)]


def _turn(angle: float) -> Float64s:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])


def _pairs(name: str, cache: Path) -> list[tuple[TrueView, TrueView]]:
    if name == "nothing":
        return list(product(photographed("fountain", 768, list("01234")).values(), photographed("entry", 768).values()))
    return list(combinations(_views(name, cache).values(), 2))


def _views(name: str, cache: Path) -> dict[str, TrueView]:
    scene, _, rest = name.rpartition("-")
    if scene in ("fountain", "entry"):
        return photographed(scene, int(rest))
    return rendered_scene(scene, cast("Daytime", rest), cache)


def _measured(name: str, left: TrueView, right: TrueView, related: bool) -> dict[str, Any] | None:
    """A pair as JSON; None where matching or geometry have nothing."""
    matches = match(left.features, right.features)
    if not isinstance(matches, Matches):
        return None
    g = estimate_geometry(matches, left.features, right.features, min_score=-1000.0)
    if not isinstance(g, Geometry):
        return None
    errors = (180.0, 180.0), (180.0, 180.0)
    if related:
        errors = _errors(left, right, g, [np.eye(3)]), _errors(left, right, g, symmetry(name))
    rival = Rival(g.rival_inliers, g.rival_elsewhere, g.rival_turned_deg) if np.isfinite(g.rival_turned_deg) else None
    evidence = PairEvidence(
        g.inliers, g.distinct_cells, g.distinct_share, g.agreement, g.half_rotation_deg, g.stretch, g.angle_deg, rival
    )
    pair = LabelledPair(name, left.name, right.name, evidence, g.model == "F", errors[0], errors[1])
    assert g.cam2_R_cam1 is not None and g.cam2_t_cam1 is not None
    return asdict(pair) | {"R": g.cam2_R_cam1.tolist(), "t": g.cam2_t_cam1.tolist()}


def _errors(left: TrueView, right: TrueView, g: Geometry, turns: list[Float64s]) -> tuple[float, float]:
    """Of the pose, against the nearest copy of the right camera."""
    found = []
    for turn in turns:
        copy = replace(right.camera, R=right.camera.R @ turn.T, C=turn @ right.camera.C)
        if np.linalg.norm(copy.C - left.camera.C) > 1e-6:
            found.append(pose_error_deg(left.camera, copy, g.cam2_R_cam1, g.cam2_t_cam1))
    return min(found)


def _restored(row: dict[str, Any]) -> LabelledPair:
    evidence = dict(row["evidence"])
    rival = evidence.pop("rival")
    made = PairEvidence(**evidence, rival=None if rival is None else Rival(**rival))
    errors = tuple(row["error_deg"]), tuple(row["error_of_copy_deg"])
    R, t = np.array(row["R"]), np.array(row["t"])
    return LabelledPair(row["set"], row["left"], row["right"], made, row["contradicted"], *errors, R, t)
