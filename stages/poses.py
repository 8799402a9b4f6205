"""Where the cameras are: taken from the calibration, solved from the pairs' geometries, or both at once.

Solved: rotations of all pairs are compared and contradictions dropped; what is left is grown into models view by view, with
bundle adjustment; each model is put into the world by whatever is known of it.  Known poses then stay where they are, unless the
images contradict them: a wrong one is named and solved like an unknown one.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from .control_points import control_landmarks
from .epipolar import fundamental_from_cameras, relative_pose, symmetric_epipolar_distance
from .georeference import Landmark, Similarity, align, upward
from .sfm.focal import Lenses, camera_of, guess_lenses, relative_rotations
from .sfm.mapping import Model, grow, refine, replace_cameras
from .sfm.rotations import angle_between, average_rotations, components
from .sfm.tracks import Edge, build_tracks, without_distortion
from .types import Camera, Float64s, Geometry, Pair, PairVerdict, Placement, Poses, Rejected, Survey, View
from .verdict import site_verdict

WORSE = 1.25
"""A pair is flagged where the adjusted F is worse on its inliers than its own by this factor and by `WORSE_PX`."""
WORSE_PX = 0.1


def solve_poses(
    views: Mapping[str, View],
    placements: Mapping[str, Placement],
    geometries: Mapping[Pair, Geometry],
    survey: Survey | None = None,
    *,
    max_rotation_error_deg: float = 4.0,
    max_epipolar_px: float = 2.0,
) -> Poses | Rejected:
    """Put the cameras into one world.

    Parameters
    ----------
    views
        The pinhole of each camera's frame, at working resolution.
    placements
        R and C as the site states them, where it does.
    geometries
        Two-view geometry of the pairs; not looked at where all poses and intrinsics are stated.
    survey
        Known distances and control points.
    max_rotation_error_deg
        A pair whose relative rotation is farther than this from what the other pairs agree on is dropped, in degrees.
    max_epipolar_px
        So is a pair whose inliers lie farther than this from the epipolar lines of the solved cameras (median), in pixels.

    Returns
    -------
    Poses, or Rejected where not even two cameras can be placed.
    """
    if len(views) < 2:
        return Rejected("one camera makes no cloud: two or more that see the same things are needed", {"cameras": len(views)})
    stated = stated_cameras(views, placements)
    exact = [name for name in stated if placements[name].sigma_m == 0]
    if len(exact) == len(views) or not geometries:
        return _as_stated(views, placements, stated)
    problem = _Problem.of(views, geometries)
    trusted, dropped = problem.consistent(np.radians(max_rotation_error_deg))
    models = problem.models(trusted)
    if not models:
        if len(stated) >= 2:
            return _as_stated(views, placements, stated)
        figures = {"cameras": float(len(views)), "pairs": float(len(trusted))}
        return Rejected("no two cameras could be placed: " + problem.why_nothing(trusted), figures)
    worlds = [_to_world(problem, model, placements, survey or Survey()) for model in models]
    return _collect(problem, worlds, stated, placements, dropped, max_epipolar_px, survey or Survey())


def stated_cameras(views: Mapping[str, View], placements: Mapping[str, Placement]) -> dict[str, Camera]:
    """The cameras whose intrinsics and pose are both known."""
    found = {}
    for name, view in views.items():
        stated = placements.get(name, Placement())
        if view.K is not None and view.focal_known and stated.R is not None and stated.C is not None:
            found[name] = camera_of(view, view.K, stated.R, stated.C)
    return found


def _as_stated(views: Mapping[str, View], placements: Mapping[str, Placement], stated: dict[str, Camera]) -> Poses | Rejected:
    """No image has a say."""
    unsolved = {}
    for name, view in views.items():
        if name not in stated:
            lacks_lens = view.K is None or not view.focal_known
            unsolved[name] = ("no intrinsics" if lacks_lens else "no pose") + " given, and no pair to solve it from"
    if not stated:
        return Rejected("no camera has a pose and intrinsics", {"cameras": float(len(views)), "solved": 0.0})
    metric = all(placements[name].metric for name in stated)
    scale = "calibration" if metric else "calibration, not metric"
    return Poses(stated, unsolved, {}, metric, "calibration", components=(tuple(stated),), scale=scale)


@dataclass(frozen=True)
class _World:
    """A model of one connected part of the site, in the world or in a frame of its own.

    placed: the frame is that of the site's known positions; scale: where it comes from; suspects: known poses that the images
    contradict, by id.
    """

    model: Model
    placed: bool
    metric: bool
    scale: str
    suspects: dict[str, str]
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class _Problem:
    """All views by number, what is known of their lenses, and the geometries of their pairs."""

    names: tuple[str, ...]
    views: tuple[View, ...]
    lenses: Lenses
    geometries: Mapping[Edge, Geometry]
    rotations: Mapping[Edge, Float64s]

    @classmethod
    def of(cls, views: Mapping[str, View], geometries: Mapping[Pair, Geometry]) -> _Problem:
        names = tuple(views)
        number = {name: k for k, name in enumerate(names)}
        edges = {(number[a], number[b]): geometry for (a, b), geometry in geometries.items() if a in number and b in number}
        lenses = guess_lenses(tuple(views.values()), edges)
        edges = relative_rotations(edges, lenses)
        rotations = {edge: g.cam2_R_cam1 for edge, g in edges.items() if g.cam2_R_cam1 is not None}
        return cls(names, tuple(views.values()), lenses, edges, rotations)

    def pair(self, edge: Edge) -> str:
        return f"{self.names[edge[0]]}--{self.names[edge[1]]}"

    def consistent(self, tolerance: float) -> tuple[list[Edge], dict[Edge, str]]:
        """The pairs that the site as a whole believes and whose rotations agree, and why the others are left out."""
        judged = site_verdict({(self.names[i], self.names[j]): geometry for (i, j), geometry in self.geometries.items()})
        verdicts = {edge: judged[self.names[edge[0]], self.names[edge[1]]] for edge in self.geometries}
        dropped = {edge: verdict.reason for edge, verdict in verdicts.items() if verdict.reason is not None}
        believed = {edge: R for edge, R in self.rotations.items() if edge not in dropped}
        averaged = average_rotations(believed, {edge: verdicts[edge].good_probability for edge in believed})
        trusted = []
        for edge, R in believed.items():
            off = angle_between(R, averaged[edge[1]] @ averaged[edge[0]].T)
            if off <= tolerance:
                trusted.append(edge)
            else:
                dropped[edge] = f"contradicts the other pairs: its rotation is {np.degrees(off):.0f} degrees off"
        return trusted, dropped

    def models(self, trusted: list[Edge]) -> list[Model]:
        """A model of every part that hangs together, largest first."""
        found = []
        waiting = components(trusted, sorted({view for edge in trusted for view in edge}))
        while waiting:
            part = waiting.pop(0)
            edges = {edge: self.geometries[edge] for edge in trusted if edge[0] in part and edge[1] in part}
            tracks = build_tracks(edges, len(self.names))
            model = grow({view: self.lenses.camera(view) for view in part}, tracks, edges, lenses=self.lenses.solved)
            if model is None:
                continue
            found.append(model)
            left = [view for view in part if view not in model.cameras]
            waiting += [p for p in components([e for e in edges if e[0] in left and e[1] in left], left) if len(p) > 1]
        return sorted(found, key=lambda model: (-len(model.cameras), min(model.cameras)))

    def why_nothing(self, trusted: list[Edge]) -> str:
        if not self.geometries:
            return "no pair has a geometry"
        return "the pairs contradict each other" if not trusted else "too few points are seen at an angle"


def _to_world(problem: _Problem, model: Model, placements: Mapping[str, Placement], survey: Survey) -> _World:
    """The model in the frame and scale of what is known, which then stays."""
    cameras = model.cameras
    placed = {view: placements[name] for view in cameras if (name := problem.names[view]) in placements}
    landmarks = [
        Landmark(problem.names[view], cameras[view].C, p.C, cameras[view].R if p.R is not None else None, p.R, p.sigma_m)
        for view, p in placed.items()
        if p.C is not None
    ]
    landmarks += control_landmarks(cameras, problem.names, problem.views, survey)
    metric = all(p.metric for p in placed.values() if p.C is not None)
    up = upward(list(cameras.values()))
    depth = _median_depth(model)
    scale, scale_notes = _scale_of_distances(problem, cameras, survey)
    alignment = align(landmarks, up, depth, scale if len(landmarks) < 2 else None) if landmarks else None
    if alignment is None:
        known_scale = scale is not None
        factor = scale if scale is not None else 1 / _median_baseline(problem, cameras)
        similarity = _own_frame(cameras, landmarks, up, factor)
        model = _moved(model, similarity)
        why = "known distances" if known_scale else "none: the median baseline is 1, the cloud is not metric"
        return _World(model, bool(landmarks), known_scale, why, {}, scale_notes)
    model = _moved(model, alignment.similarity)
    number = {name: view for view, name in enumerate(problem.names)}
    held = [number[name] for name in alignment.trusted if (p := placements.get(name)) and p.R is not None and p.sigma_m == 0]
    if len(held) >= 2:
        stated = {view: _at(model.cameras[view], placed[view]) for view in held}
        model = refine(replace_cameras(model, {**model.cameras, **stated}), held)
    suspects = {name: _suspicion(name, *off) for name, off in alignment.doubted.items()}
    source = "known distances" if len(landmarks) < 2 else _source(alignment.trusted, len(landmarks))
    return _World(model, True, metric or scale is not None, source, suspects, scale_notes)


def _source(trusted: tuple[str, ...], known: int) -> str:
    """What scale and frame come from, in words."""
    if not trusted:
        return f"{known} known positions, which the images contradict"
    points = sum(name.startswith("control point") for name in trusted)
    parts = [(len(trusted) - points, "known positions"), (points, "control points")]
    return " and ".join(f"{count} {what}" for count, what in parts if count)


def _scale_of_distances(problem: _Problem, cameras: Mapping[int, Camera], survey: Survey) -> tuple[float | None, tuple[str, ...]]:
    """Metres for each unit of the model from the known distances, and a note where they disagree."""
    ratios = []
    for i, j, metres in survey.distances:
        a, b = survey.cameras[int(i)], survey.cameras[int(j)]
        if a in problem.names and b in problem.names:
            u, v = problem.names.index(a), problem.names.index(b)
            if u in cameras and v in cameras:
                ratios.append(metres / np.linalg.norm(cameras[u].C - cameras[v].C))
    if not ratios:
        return None, ()
    scale = float(np.median(ratios))
    spread = max(abs(ratio / scale - 1) for ratio in ratios)
    return scale, (f"known distances disagree by up to {100 * spread:.1f} %",) if spread > 0.01 else ()


def _own_frame(cameras: Mapping[int, Camera], landmarks: list[Landmark], up: Float64s, scale: float) -> Similarity:
    """z up, x to the right of the first camera, which is at the origin (or at its known place)."""
    first = cameras[min(cameras)]
    right = first.R[0] - (first.R[0] @ up) * up
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


def _median_baseline(problem: _Problem, cameras: Mapping[int, Camera]) -> float:
    """Over the pairs that were matched."""
    lengths = [np.linalg.norm(cameras[i].C - cameras[j].C) for i, j in problem.geometries if i in cameras and j in cameras]
    return float(np.median(lengths))


def _suspicion(name: str, length: float, degrees: float) -> str:
    turned = "" if np.isnan(degrees) else f" and {degrees:.1f} degrees"
    what = name if name.startswith("control point") else f"the known pose of {name}"
    return f"{what} contradicts the images: it seems off by {length:.3g} m{turned}; left out"


def _collect(
    problem: _Problem,
    worlds: list[_World],
    stated: dict[str, Camera],
    placements: Mapping[str, Placement],
    dropped: dict[Edge, str],
    max_epipolar_px: float,
    survey: Survey,
) -> Poses:
    """All worlds as one result: those in the site's frame are the first component, each other is one of its own."""
    worlds = sorted(worlds, key=lambda world: not world.placed)
    cameras: dict[str, Camera] = {}
    groups: list[list[str]] = []
    for world in worlds:
        if not (world.placed and groups):
            groups.append([])
        for view, camera in world.model.cameras.items():
            cameras[problem.names[view]] = replace(camera, component=len(groups) - 1)
            groups[-1].append(problem.names[view])
    notes = [note for world in worlds for note in world.notes]
    if worlds[0].placed:
        for name, camera in stated.items():
            if name not in cameras:
                cameras[name] = camera
                groups[0].append(name)
                notes.append(f"{name}: pose as stated; no pair could check it")
    order = [name for name in problem.names if name in cameras]
    verdicts = {
        problem.pair(edge): _verdict(problem, edge, cameras, dropped.get(edge), max_epipolar_px) for edge in problem.geometries
    }
    unsolved = {name: _why_unsolved(problem, name, dropped) for name in problem.names if name not in cameras}
    suspects = {name: reason for world in worlds for name, reason in world.suspects.items()}
    errors = np.concatenate([world.model.error_px()[world.model.use] for world in worlds])
    main = worlds[0]
    return Poses(
        cameras={name: cameras[name] for name in order},
        unsolved=unsolved,
        dropped={pair: verdict.reason for pair, verdict in verdicts.items() if not verdict.kept},
        metric=main.metric,
        source="mixed" if set(stated) & set(cameras) - set(suspects) else "solved",
        verdicts=verdicts,
        suspects=suspects,
        focals=tuple(name for view, name in enumerate(problem.names) if view in problem.lenses.solved and name in cameras),
        components=tuple(tuple(name for name in order if name in group) for group in groups),
        joins=_joins(problem, groups),
        scale=main.scale,
        crs=survey.crs if main.placed else "",
        notes=tuple(notes),
        points=sum(int(np.isfinite(w.model.X[:, 0]).sum()) for w in worlds),
        reprojection_px=float(np.median(errors)),
    )


def _verdict(
    problem: _Problem, edge: Edge, cameras: Mapping[str, Camera], why: str | None, max_epipolar_px: float
) -> PairVerdict:
    """What the solved cameras say of a pair."""
    geometry = problem.geometries[edge]
    own = float(np.median(symmetric_epipolar_distance(geometry.F, geometry.x1, geometry.x2)))
    left, right = (cameras.get(problem.names[view]) for view in edge)
    if left is None or right is None:
        return PairVerdict(why is None, why or "a camera of it could not be placed", own)
    if left.component != right.component:
        return PairVerdict(False, why or "its cameras could not be brought into one frame", own)
    F = fundamental_from_cameras(left, right)
    adjusted = float(np.median(symmetric_epipolar_distance(F, geometry.x1, geometry.x2)))
    x1, x2 = without_distortion(left, geometry.x1), without_distortion(right, geometry.x2)
    straight = float(np.median(symmetric_epipolar_distance(F, x1, x2)))
    R = problem.rotations.get(edge)
    off = float("nan") if R is None else float(np.degrees(angle_between(R, relative_pose(left, right)[0])))
    if straight <= max_epipolar_px:
        why = None  # cameras that were solved without the pair agree with it after all
    elif why is None:
        why = f"contradicts the other pairs: its inliers are {straight:.1f} px off the epipolar lines of the solved cameras"
    flagged = adjusted > max(WORSE * own, own + WORSE_PX)
    note = f"adjusted epipolar error {adjusted:.2f} px, {own:.2f} px before" if flagged else ""
    return PairVerdict(why is None, why or note, own, adjusted, off, flagged)


def _why_unsolved(problem: _Problem, name: str, dropped: Mapping[Edge, str]) -> str:
    view = problem.names.index(name)
    mine = [edge for edge in problem.geometries if view in edge]
    if view not in problem.lenses.K:
        return "no focal length: none given, and no pair tells it"
    if not mine:
        return "no pair with it has a geometry"
    if all(edge in dropped for edge in mine):
        return f"each of its {len(mine)} pairs contradicts the others"
    return "too few points in common with the solved cameras"


def _joins(problem: _Problem, groups: list[list[str]]) -> tuple[str, ...]:
    """For each further component the pair that would join it to the main one best.

    Of cameras that already see much: the one with most inliers on each side.
    """

    def strength(name: str) -> int:
        view = problem.names.index(name)
        return sum(geometry.inliers for edge, geometry in problem.geometries.items() if view in edge)

    best = [max(group, key=lambda name: (strength(name), name)) for group in groups]
    order = {name: k for k, name in enumerate(problem.names)}
    return tuple("--".join(sorted((best[0], other), key=order.__getitem__)) for other in best[1:])
