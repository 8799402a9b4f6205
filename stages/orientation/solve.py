"""Solve cameras from the geometries of their pairs: grow models, align them with the world, judge every pair by them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ..core.cameras import relative_pose
from ..core.epipolar import fundamental_from_cameras, symmetric_epipolar_distance
from ..core.residual_distortion import UNDISTORTED_PX, residual_px, without_distortion
from ..core.rotations import angle_between_deg
from ..reasons import Reason, Rejected
from ..sfm.consistent_matches import consistent_matches
from ..sfm.incremental import Model, refine
from ..sfm.loops import USUAL, LoopStatistics
from ..sfm.rigs import rigs_of
from ..sfm.tracks import Edge
from ..sfm.view_graph import ViewGraph
from ..types import Camera, Geometry, Pair, PairCheck, Placement, PoseIssue, Poses, Survey, View
from .lens_sigma import MOST_SIGMA_PX, lens_sigmas, with_principal_points
from .pose_check import LEAST_PROBABILITY, confirmed, epipolar_error_px
from .triplet_consistency import FEWEST, MOST_INCONSISTENCY, inconsistency
from .world import World, to_world

WORSE_RATIO = 1.25
"""A pair is flagged if its inliers fit the adjusted F worse than its own F by this factor and by `WORSE_PX`."""
WORSE_PX = 0.1


def solve_from_pairs(
    views: Mapping[str, View],
    placements: Mapping[str, Placement],
    geometries: Mapping[Pair, Geometry],
    survey: Survey,
    stated: Mapping[str, Camera],
    max_rotation_error_deg: float,
    max_epipolar_px: float,
    usual: LoopStatistics = USUAL,
) -> Poses | Rejected:
    """Solve the poses that are not known.

    Parameters
    ----------
    views, placements, geometries, survey, max_rotation_error_deg, max_epipolar_px : see `poses.solve_poses`.
    stated : cameras whose intrinsics and poses are both known, by id.
    usual : statistics of scenes that do not repeat, for the check of the site's loops.
    """
    exact = {n: camera for n, camera in stated.items() if placements[n].sigma_m == 0 and placements[n].sigma_deg == 0}
    graph = ViewGraph.of(views, _consistent(exact, geometries, max_epipolar_px))
    trusted, dropped = graph.consistent(max_rotation_error_deg, usual)
    view_number = {name: view for view, name in enumerate(graph.names)}
    held = {view_number[name]: camera for name, camera in exact.items()}
    accepted = {edge: graph.geometries[edge] for edge in trusted}
    models, removed = _refined(graph.models(trusted, held), accepted, max_epipolar_px)
    strained = ((model, strain) for model in models if (strain := inconsistency(model, accepted)) > MOST_INCONSISTENCY)
    inconsistent = {graph.names[view]: strain for model, strain in strained for view in model.cameras}
    if inconsistent:
        confirmed_graph = replace(graph, geometries={**graph.geometries, **consistent_matches(accepted, FEWEST)})
        retried, retried_removed = _refined(confirmed_graph.models(trusted, held), accepted, max_epipolar_px)
        models, removed = (retried, retried_removed) if retried else (models, removed)
    if not models:
        return graph.why_nothing(trusted, dropped)
    worlds = [to_world(graph, model, placements, survey) for model in models]
    metric = all(placements[name].metric for name in exact)
    poses = _collect(graph, worlds, stated, exact, metric, dropped, {graph.names[v] for v in removed}, max_epipolar_px, survey)
    sigmas = {graph.names[view]: sigma for world in worlds for view, sigma in lens_sigmas(world.model).items()}
    uncertain = [name for name in graph.names if name in sigmas and not sigmas[name].border_px <= MOST_SIGMA_PX]
    issues = [PoseIssue("lens-undetermined", name, **vars(sigmas[name])) for name in uncertain]
    issues += [PoseIssue("inconsistent", name, strain=strain) for name, strain in inconsistent.items()]
    return replace(poses, issues=(*poses.issues, *issues))


def _refined(grown: Sequence[Model], accepted: Mapping[Edge, Geometry], max_epipolar_px: float) -> tuple[list[Model], list[int]]:
    """The models after adjustment, without unsupported views; and the views that were removed."""
    adjusted = [with_principal_points(refine(model, rounds=3)) for model in grown]
    supported = [without_unsupported(model, accepted, max_epipolar_px) for model in adjusted]
    return [model for model, _ in supported if model.use.any()], [view for _, removed in supported for view in removed]


def _consistent(exact: Mapping[str, Camera], geometries: Mapping[Pair, Geometry], max_epipolar_px: float) -> dict[Pair, Geometry]:
    """The geometries without pairs of exact cameras that contradict these; other such pairs, if probable, get the stated pose."""
    consistent = {}
    for pair, geometry in geometries.items():
        if set(pair) <= set(exact):
            if not epipolar_error_px(exact, pair, geometry) <= max_epipolar_px:
                continue
            if geometry.good_probability >= LEAST_PROBABILITY:  # improbable pairs may match look-alikes along the epipolar lines
                R, t = relative_pose(*(exact[name] for name in pair))
                t /= np.linalg.norm(t)
                geometry = replace(confirmed(geometry), cam2_R_cam1=R, cam2_t_cam1=t)
        consistent[pair] = geometry
    return consistent


def _collect(
    graph: ViewGraph,
    worlds: list[World],
    stated: Mapping[str, Camera],
    exact: Mapping[str, Camera],
    exact_metric: bool,
    dropped: dict[Edge, Rejected],
    unsupported: set[str],
    max_epipolar_px: float,
    survey: Survey,
) -> Poses:
    """All worlds as one result: those in the site's frame are the first component, each other world is one of its own."""
    worlds = sorted(worlds, key=lambda world: not world.placed)
    main = worlds[0]
    if not main.placed and len(exact) >= 2:  # the solved model is not aligned with the known cameras
        main = replace(main, metric=exact_metric, scale="calibration" if exact_metric else "calibration, not metric", placed=True)
    cameras: dict[str, Camera] = dict(exact) if main.placed else {}
    groups: list[list[str]] = [list(cameras)]
    for world in worlds:
        solved = {graph.names[view]: camera for view, camera in world.model.cameras.items()}
        new_names = [name for name in solved if name not in cameras]
        if not world.placed and groups[0]:
            groups.append([])
        for name in new_names:
            cameras[name] = replace(solved[name], component=len(groups) - 1)
            groups[-1].append(name)
    suspects = {name: reason for world in worlds for name, reason in world.suspects.items()}
    notes: list[str] = []
    if main.placed:
        for name, camera in stated.items():
            if name not in cameras:
                cameras[name] = camera
                groups[0].append(name)
    ordered = [name for name in graph.names if name in cameras]
    checks = {graph.pair(edge): _check(graph, edge, cameras, dropped.get(edge), max_epipolar_px) for edge in graph.geometries}
    unsolved = {name: _why_unsolved(graph, name, dropped, unsupported) for name in graph.names if name not in cameras}
    if distorted := {name: px for name in ordered if (px := residual_px(cameras[name])) > UNDISTORTED_PX}:
        message = f"the lenses of {', '.join(distorted)} bend straight lines (corners by up to {max(distorted.values()):.1f} px)"
        notes.append(
            f"{message}: later stages are corrected for it; matching is, too, once these solved cameras are the calibration"
        )
    errors = np.concatenate([world.model.error_px()[world.model.use] for world in worlds])
    return Poses(
        cameras={name: cameras[name] for name in ordered},
        unsolved=unsolved,
        dropped={pair: check.reason for pair, check in checks.items() if not check.kept},
        metric=main.metric,
        source="mixed" if set(stated) & set(cameras) - set(suspects) else "solved",
        pair_checks=checks,
        issues=(
            *(PoseIssue("moved", name, reason) for name, reason in suspects.items()),
            *(PoseIssue("unverified", name, reason) for world in worlds for name, reason in world.doubtful.items()),
            *(PoseIssue("contradicted", name, reason) for world in worlds for name, reason in world.contradicting.items()),
        ),
        focals=tuple(name for view, name in enumerate(graph.names) if view in graph.lenses.solved and name in cameras),
        components=tuple(tuple(name for name in ordered if name in group) for group in groups),
        joins=_joins(graph, groups),
        scale=main.scale,
        crs=survey.crs if main.placed else "",
        notes=tuple(notes),
        points=sum(int(np.isfinite(w.model.X[:, 0]).sum()) for w in worlds),
        reprojection_px=float(np.median(errors)),
    )


def _check(
    graph: ViewGraph, edge: Edge, cameras: Mapping[str, Camera], rejection: Rejected | None, max_epipolar_px: float
) -> PairCheck:
    geometry = graph.geometries[edge]
    own_px = float(np.median(symmetric_epipolar_distance(geometry.F, geometry.x1, geometry.x2)))
    left, right = (cameras.get(graph.names[view]) for view in edge)
    if left is None or right is None:
        unplaced = rejection or Rejected(Reason.CAMERA_NOT_PLACED)
        return PairCheck(rejection is None, unplaced.reason, unplaced.code, own_px)
    if left.component != right.component:
        separate = rejection or Rejected(Reason.CAMERAS_APART)
        return PairCheck(False, separate.reason, separate.code, own_px)
    F = fundamental_from_cameras(left, right)
    adjusted_px = float(np.median(symmetric_epipolar_distance(F, geometry.x1, geometry.x2)))
    undistorted_px = undistorted_error_px(left, right, geometry)
    R = graph.rotations.get(edge)
    rotation_error = float("nan") if R is None else angle_between_deg(R, relative_pose(left, right)[0])
    if undistorted_px <= max_epipolar_px:
        rejection = None  # cameras that were solved without this pair agree with it after all
    elif rejection is None:
        rejection = Rejected(Reason.CONTRADICTS_CAMERAS, {"epipolar_px": undistorted_px})
    is_worse = adjusted_px > max(WORSE_RATIO * own_px, own_px + WORSE_PX)
    note = f"adjusted epipolar error {adjusted_px:.2f} px, {own_px:.2f} px before" if is_worse else ""
    if rejection is not None:
        return PairCheck(False, rejection.reason, rejection.code, own_px, adjusted_px, rotation_error, is_worse, "solved")
    return PairCheck(True, note, "", own_px, adjusted_px, rotation_error, is_worse, "solved")


def _why_unsolved(graph: ViewGraph, name: str, dropped: Mapping[Edge, Rejected], unsupported: set[str]) -> str:
    view = graph.names.index(name)
    own_edges = [edge for edge in graph.geometries if view in edge]
    if view not in graph.lenses.K:
        return "no focal length: none is given, and none can be estimated from its pairs"
    if not own_edges:
        return "no pair with it has a geometry"
    if all(edge in dropped for edge in own_edges):
        no_proof = (Reason.UNCONFIRMED, Reason.NOT_BELIEVED)  # lack of evidence: without triangles, nothing contradicts a pair
        if all(dropped[edge].why in no_proof and not dropped[edge].figures["triangles"] for edge in own_edges):
            which_pairs = f"none of its {len(own_edges)} pairs" if len(own_edges) > 1 else "its only pair"
            verb = "is" if len(own_edges) > 1 else "is not"
            return f"{which_pairs} {verb} reliable: too few distinctive matches, and no third camera confirms them"
        which_pairs = f"each of its {len(own_edges)} pairs" if len(own_edges) > 1 else "its only pair"
        return f"{which_pairs} contradicts the others"
    if name in unsupported:
        return "the pose from its shared points contradicts the pairs with the most matches"
    return "too few points in common with the solved cameras"


def _joins(graph: ViewGraph, groups: list[list[str]]) -> tuple[str, ...]:
    """For each further component, the pair that would join it best to the main one.

    It consists of the camera with most inliers on each side.
    """

    def strength(name: str) -> int:
        view = graph.names.index(name)
        return sum(geometry.inliers for edge, geometry in graph.geometries.items() if view in edge)

    best = [max(group, key=lambda name: (strength(name), name)) for group in groups]
    position = {name: k for k, name in enumerate(graph.names)}
    return tuple("--".join(sorted((best[0], other), key=position.__getitem__)) for other in best[1:])


def undistorted_error_px(left: Camera, right: Camera, geometry: Geometry) -> float:
    """Median distance of a pair's inliers, with radial distortion removed, to the epipolar lines of its cameras."""
    x1, x2 = without_distortion(left, geometry.x1), without_distortion(right, geometry.x2)
    return float(np.median(symmetric_epipolar_distance(fundamental_from_cameras(left, right), x1, x2)))


def without_unsupported(model: Model, geometries: Mapping[Edge, Geometry], max_epipolar_px: float) -> tuple[Model, list[int]]:
    """The refined model without cameras whose accepted pairs contradict it with more inliers than agree, and the removed views.

    A few points of look-alikes that three views share can place a camera as well as right ones do, and the adjustment then
    rejects the right points: all that remain agree, but not the pair with most matches.  Known cameras stay.  A pair agrees
    up to a median distance of `max_epipolar_px` to the epipolar lines of its cameras.
    """
    removed: list[int] = []
    first_of = {view: first for first, views in rigs_of(model.cameras).items() for view in views}  # removed together
    while len(model.cameras) > 2:
        balance = dict.fromkeys((first_of.get(view, view) for view in model.cameras if view not in model.held), 0)
        for (i, j), geometry in geometries.items():
            if i in model.cameras and j in model.cameras:
                agrees = undistorted_error_px(model.cameras[i], model.cameras[j], geometry) <= max_epipolar_px
                for view in balance.keys() & {first_of.get(i, i), first_of.get(j, j)}:
                    balance[view] += geometry.inliers if agrees else -geometry.inliers
        worst = min(balance, key=lambda view: (balance[view], view), default=None)
        if worst is None or balance[worst] >= 0:
            break
        worst_views = [view for view in model.cameras if first_of.get(view, view) == worst]
        removed += worst_views
        cameras = {view: camera for view, camera in model.cameras.items() if view not in worst_views}
        model = refine(replace(model, cameras=cameras, use=model.use & ~np.isin(model.tracks.view, worst_views)), rounds=3)
    return model, removed
