"""A solved model in the world: what is known of positions, control points and distances gives frame and scale, and then stays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from ..core.cameras import camera_id, same_camera
from ..core.similarity import Similarity
from ..types import Camera, Float64s, Placement, Survey
from .alignment import Landmark, align, upward
from .control_points import control_landmarks
from .incremental import Model, refine, replace_cameras
from .rigs import rigs_of, whole_R
from .view_graph import ViewGraph

EXACT_SHARE = 1e-4
"""An exact position without a rotation counts as known to this share of the scene's distance..."""
LOOSE_SHARE = 0.005
"""...and where all are known no better than this, the images know the shape better: they give frame and scale only."""


@dataclass(frozen=True)
class World:
    """A model of one connected part of the site, in the world or in a frame of its own."""

    model: Model
    placed: bool
    """The frame is that of the site's known positions."""
    metric: bool
    scale: str
    """Where it comes from."""
    suspects: dict[str, str]
    """Known poses that the images contradict, by id."""
    notes: tuple[str, ...] = ()


def to_world(graph: ViewGraph, model: Model, placements: Mapping[str, Placement], survey: Survey) -> World:
    """The model in the frame and scale of what is known, which then stays.

    Parameters
    ----------
    graph : views and their names.
    model : cameras and points in a frame of their own.
    placements : what is known of the poses, by id.
    survey : distances and control points that are known.
    """
    cameras = model.cameras
    beside = {view for views in rigs_of(cameras).values() for view in views[1:]}  # where they are says nothing more
    firsts = [view for view in cameras if view not in beside]
    placed = {view: placements[name] for view in firsts if (name := graph.names[view]) in placements}
    landmarks = [
        Landmark(graph.names[view], cameras[view].C, p.C, cameras[view].R if p.R is not None else None, p.R, p.sigma_m)
        for view, p in placed.items()
        if p.C is not None
    ]
    landmarks += control_landmarks(cameras, graph.names, graph.views, survey)
    metric = all(p.metric for p in placed.values() if p.C is not None)
    up = upward([replace(cameras[view], R=whole_R(cameras[view])) for view in firsts])
    depth = _median_depth(model)
    scale, scale_notes = _scale_of_distances(graph, cameras, survey)
    alignment = align(landmarks, up, depth, scale if len(landmarks) < 2 else None) if landmarks else None
    if alignment is None:
        known_scale = scale is not None
        factor = scale if scale is not None else 1 / _median_baseline(graph, cameras)
        similarity = _own_frame(cameras, landmarks, up, factor)
        model = _moved(model, similarity)
        why = "known distances" if known_scale else "none: the median baseline is 1, the cloud is not metric"
        again = {graph.names[view] for views in rigs_of(dict(enumerate(graph.views))).values() for view in views[1:]}
        count = sum(p.C is not None for name, p in placements.items() if name not in again)
        alone = count == 1  # without a scale it fits nothing else that is placed
        return World(model, bool(landmarks) and (known_scale or alone), known_scale, why, {}, scale_notes)
    unplaced, model = model, _moved(model, alignment.similarity)
    exact = [view for view, p in placed.items() if p.R is not None and p.C is not None and max(p.sigma_m, p.sigma_deg) == 0]
    number = {name: view for view, name in enumerate(graph.names)}
    held = [number[name] for name in alignment.trusted if (p := placements.get(name)) and p.R is not None and p.sigma_m == 0]
    if len(held) < 2 <= len(exact):  # the model contradicts the known poses, and no more than it can be right
        names = " and ".join(graph.names[view] for view in exact)
        note = f"the model of {len(cameras)} cameras contradicts the known poses of {names}: it stands apart, unverified"
        similarity = _own_frame(unplaced.cameras, [], up, scale if scale is not None else 1 / _median_baseline(graph, cameras))
        why = "known distances" if scale is not None else "none: the median baseline is 1, the cloud is not metric"
        return World(_moved(unplaced, similarity), False, scale is not None, why, {}, (*scale_notes, note))
    if len(held) >= 2:
        held = [view for view in cameras if any(view == h or same_camera(cameras[view], cameras[h]) for h in held)]
        stated = {view: _at(model.cameras[view], placements[graph.names[view]]) for view in held}
        model = refine(replace_cameras(model, {**model.cameras, **stated}), held)
    else:
        measured = {number[name]: placements[name] for name in alignment.trusted if name in number}
        distance = depth * alignment.similarity.scale
        positions = {view: (p.C, max(p.sigma_m, EXACT_SHARE * distance)) for view, p in measured.items() if p.C is not None}
        if len(positions) >= 3 and min(sigma for _, sigma in positions.values()) < LOOSE_SHARE * distance:
            model = refine(model, positions=positions)
    known = {graph.names[view] for view in exact}
    suspects = {name: _suspicion(name, *off) for name, off in alignment.doubted.items() if name not in known}
    scale_notes += tuple(
        f"the known pose of {name} is unverified: the model of the others has it {off[0]:.3g} m away; it stays in use"
        for name, off in alignment.doubted.items()
        if name in known
    )
    source = "known distances" if len(landmarks) < 2 else _source(alignment.trusted, len(landmarks))
    return World(model, True, metric or scale is not None, source, suspects, scale_notes)


def _source(trusted: tuple[str, ...], known: int) -> str:
    """What scale and frame come from, in words."""
    if not trusted:
        return f"{known} known positions, which the images contradict"
    points = sum(name.startswith("control point") for name in trusted)
    parts = [(len(trusted) - points, "known positions"), (points, "control points")]
    return " and ".join(f"{count} {what}" for count, what in parts if count)


def _scale_of_distances(graph: ViewGraph, cameras: Mapping[int, Camera], survey: Survey) -> tuple[float | None, tuple[str, ...]]:
    """Metres for each unit of the model from the known distances, and a note where they disagree."""
    ratios = []
    placed = {camera_id(graph.names[view], camera): camera.C for view, camera in cameras.items()}
    for i, j, metres in survey.distances:
        a, b = survey.cameras[int(i)], survey.cameras[int(j)]
        if a in placed and b in placed:
            ratios.append(metres / np.linalg.norm(placed[a] - placed[b]))
    if not ratios:
        return None, ()
    scale = float(np.median(ratios))
    spread = max(abs(ratio / scale - 1) for ratio in ratios)
    return scale, (f"known distances disagree by up to {100 * spread:.1f} %",) if spread > 0.01 else ()


def _own_frame(cameras: Mapping[int, Camera], landmarks: list[Landmark], up: Float64s, scale: float) -> Similarity:
    """z up, x to the right of the first camera, which is at the origin (or at its known place)."""
    first = cameras[min(cameras)]
    right = whole_R(first)[0] - (whole_R(first)[0] @ up) * up
    right /= np.linalg.norm(right)
    R = np.array([right, np.cross(up, right), up])
    origin, target = first.C, np.zeros(3)
    if landmarks:
        origin, target = landmarks[0].model_X, landmarks[0].world_X
        if landmarks[0].world_R is not None and landmarks[0].model_R is not None:
            R = landmarks[0].world_R.T @ landmarks[0].model_R
    return Similarity(scale, R, target - scale * R @ origin)


def _at(camera: Camera, placement: Placement) -> Camera:
    """The camera where it is said to be."""
    assert placement.R is not None and placement.C is not None
    return replace(camera, R=placement.R, C=placement.C)


def _moved(model: Model, similarity: Similarity) -> Model:
    cameras = {view: similarity.camera(camera) for view, camera in model.cameras.items()}
    return replace(model, cameras=cameras, X=similarity.points(model.X))


def _median_depth(model: Model) -> float:
    depths = []
    for view, camera in model.cameras.items():
        rows = model.use & (model.tracks.view == view)
        depths.append((model.X[model.tracks.track[rows]] - camera.C) @ camera.R[2])
    return float(np.median(np.concatenate(depths)))


def _median_baseline(graph: ViewGraph, cameras: Mapping[int, Camera]) -> float:
    """Over the pairs that were matched."""
    lengths = [np.linalg.norm(cameras[i].C - cameras[j].C) for i, j in graph.geometries if i in cameras and j in cameras]
    return float(np.median(lengths))


def _suspicion(name: str, length: float, degrees: float) -> str:
    turned = "" if np.isnan(degrees) else f" and {degrees:.1f} degrees"
    what = name if name.startswith("control point") else f"the known pose of {name}"
    return f"{what} contradicts the images: it seems off by {length:.3g} m{turned}; left out"
