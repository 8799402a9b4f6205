"""Solve cameras from the geometries of their pairs: grow models, align them with the world, judge every pair by them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ..contracts.reasons import Reason, Rejected
from ..core.cameras import relative_pose
from ..core.epipolar import fundamental_from_cameras, symmetric_epipolar_distance
from ..core.residual_distortion import UNDISTORTED_PX, residual_px, without_distortion
from ..sfm.consistent_matches import consistent_matches
from ..sfm.incremental import Model, refine
from ..sfm.loops import USUAL, LoopStatistics
from ..sfm.rigs import first_views
from ..sfm.tracks import Edge
from ..sfm.view_graph import ViewGraph
from ..types import Camera, Geometry, Pair, PairCheck, Placement, PoseIssue, Poses, Survey, View
from .lens_sigma import MOST_SIGMA_PX, lens_sigmas, with_principal_points
from .pose_check import LEAST_PROBABILITY, confirmed, epipolar_error_px, turned_deg
from .triplet_consistency import FEWEST, MOST_INCONSISTENCY, inconsistency
from .world import World, to_world

MOST_EXCESS = 5.6e-4
"""Largest plausible `_excess_px` of a solved camera, as a share of the long side (0.18 px of 320).  On 15 rendered scenes, at 320
pixels, right poses had up to 0.16 px, and most that look-alikes put more than a degree off 0.20 to 1.1 px."""


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
    accepted, dropped = graph.consistent(max_rotation_error_deg, usual)
    held = {view: exact[name] for view, name in enumerate(graph.names) if name in exact}
    models, removed = _refined(graph.models(accepted, held), accepted, max_epipolar_px)
    strained = [(model, strain) for model in models if (strain := inconsistency(model, accepted)) > MOST_INCONSISTENCY]
    if strained:
        retried = _refined(graph.models(consistent_matches(accepted, FEWEST), held), accepted, max_epipolar_px)
        models, removed = retried if retried[0] else (models, removed)
    if not models:
        return graph.why_nothing(accepted, dropped)
    worlds = sorted((to_world(graph, model, placements, survey) for model in models), key=lambda world: not world.placed)
    main = worlds[0]
    if not main.placed and len(exact) >= 2:  # the solved model is not aligned with the known cameras, which are the main part
        metric = all(placements[name].metric for name in exact)
        main = replace(main, metric=metric, scale="calibration" if metric else "calibration, not metric", placed=True)
    cameras = _cameras_of(graph, worlds, exact if main.placed else {}, stated if main.placed else {})
    component_of = {name: camera.component for name, camera in cameras.items()}
    numbers = range(1 + max(component_of.values()))
    components = tuple(tuple(name for name, number in component_of.items() if number == k) for k in numbers)
    sound = set(stated) & set(cameras) - {name for world in worlds for name in world.suspects}
    checks = {}
    for edge in graph.geometries:
        checks["--".join(graph.ids(edge))] = _check(graph, edge, cameras, dropped.get(edge), max_epipolar_px)
    unsupported = {graph.names[view] for view in removed}
    errors = np.concatenate([world.model.error_px()[world.model.use] for world in worlds])
    return Poses(
        cameras=cameras,
        unsolved={name: _why_unsolved(graph, name, dropped, unsupported) for name in graph.names if name not in cameras},
        dropped={pair: check.reason for pair, check in checks.items() if not check.kept},
        metric=main.metric,
        source="mixed" if sound else "solved",
        pair_checks=checks,
        issues=_issues(graph, worlds, strained, checks, stated),
        focals=tuple(name for view, name in enumerate(graph.names) if view in graph.lenses.solved and name in cameras),
        components=components,
        joins=_joins(graph, components),
        scale=main.scale,
        crs=survey.crs if main.placed else "",
        notes=_notes(cameras),
        points=sum(int(np.isfinite(world.model.X[:, 0]).sum()) for world in worlds),
        reprojection_px=float(np.median(errors)),
    )


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


def _cameras_of(
    graph: ViewGraph, worlds: list[World], exact: Mapping[str, Camera], stated: Mapping[str, Camera]
) -> dict[str, Camera]:
    """The exact cameras, those of all worlds, and the other stated ones, by id.

    Those in the site's frame are the first component; each other world is one of its own.
    """
    cameras = dict(exact)
    for world in worlds:
        component = 0 if world.placed or not cameras else 1 + max(camera.component for camera in cameras.values())
        solved = {graph.names[view]: camera for view, camera in world.model.cameras.items()}
        cameras |= {name: replace(camera, component=component) for name, camera in solved.items() if name not in cameras}
    cameras = {**stated, **cameras}
    return {name: cameras[name] for name in graph.names if name in cameras}


def _issues(
    graph: ViewGraph, worlds: list[World], strained: list[tuple[Model, float]], checks: Mapping[str, PairCheck],
    stated: Mapping[str, Camera],
) -> tuple[PoseIssue, ...]:  # fmt: skip
    """The doubts about known poses, about lenses, and about solved cameras whose matches contradict each other."""
    suspects = {name: reason for world in worlds for name, reason in world.suspects.items()}
    sigmas = {graph.names[view]: sigma for world in worlds for view, sigma in lens_sigmas(world.model).items()}
    bendable = [(model, strain) for model, strain in strained if len(model.held) < 2]  # others have the frame of known cameras
    strains = {graph.names[view]: strain for model, strain in bendable for view in model.cameras}
    solved = {graph.names[view]: camera for world in worlds for view, camera in world.model.cameras.items()}
    limits = {name: MOST_EXCESS * max(camera.width, camera.height) for name, camera in solved.items() if name not in stated}
    uncertain = [name for name in graph.names if name in sigmas and not sigmas[name].border_px <= MOST_SIGMA_PX]
    return (
        *(PoseIssue("moved", name, reason) for name, reason in suspects.items()),
        *(PoseIssue("unverified", name, reason, True) for world in worlds for name, reason in world.doubtful.items()),
        *(PoseIssue("contradicted", name, reason, True) for world in worlds for name, reason in world.contradicting.items()),
        *(PoseIssue("lens-undetermined", name, **vars(sigmas[name])) for name in uncertain),
        *(PoseIssue("inconsistent", name, strain=strain) for name, strain in strains.items()),
        *(
            PoseIssue("inconsistent", name, excess_px=px)
            for name, limit in limits.items()
            if name not in strains and (px := _excess_px(name, graph, checks)) > limit
        ),
    )


def _excess_px(name: str, graph: ViewGraph, checks: Mapping[str, PairCheck]) -> float:
    """How much farther the matches of a camera's pairs are from the epipolar lines of the cameras than from those of their own F:
    the median of its pairs with stated lenses (F adapts to others), weighted by right inliers, in pixels; nan without pairs."""
    excesses: list[tuple[float, float]] = []
    for edge, geometry in graph.geometries.items():
        check = checks["--".join(graph.ids(edge))]
        has_lenses = not set(edge) & set(graph.lenses.solved)
        if name in graph.ids(edge) and has_lenses and np.isfinite(check.adjusted_px):
            excesses.append((check.adjusted_px - check.estimated_px, geometry.inliers * geometry.good_probability))
    values, weights = np.array(sorted(excesses)).reshape(-1, 2).T
    return float(values[np.searchsorted(weights.cumsum(), weights.sum() / 2)]) if len(values) else float("nan")


def _notes(cameras: Mapping[str, Camera]) -> tuple[str, ...]:
    distorted = {name: px for name, camera in cameras.items() if (px := residual_px(camera)) > UNDISTORTED_PX}
    if not distorted:
        return ()
    message = f"the lenses of {', '.join(distorted)} bend straight lines (corners by up to {max(distorted.values()):.1f} px)"
    return (f"{message}: later stages are corrected for it; matching is, too, once these solved cameras are the calibration",)


def _check(
    graph: ViewGraph, edge: Edge, cameras: Mapping[str, Camera], rejection: Rejected | None, max_epipolar_px: float
) -> PairCheck:
    geometry, pair = graph.geometries[edge], graph.ids(edge)
    own_px = float(np.median(symmetric_epipolar_distance(geometry.F, geometry.x1, geometry.x2)))
    left, right = (cameras.get(name) for name in pair)
    if left is None or right is None:
        unplaced = rejection or Rejected(Reason.CAMERA_NOT_PLACED)
        return PairCheck(rejection is None, unplaced.reason, unplaced.code, own_px)
    if left.component != right.component:
        separate = rejection or Rejected(Reason.CAMERAS_APART)
        return PairCheck(False, separate.reason, separate.code, own_px)
    adjusted_px, undistorted_px = epipolar_error_px(cameras, pair, geometry), undistorted_error_px(left, right, geometry)
    if undistorted_px <= max_epipolar_px:
        rejection = None  # cameras that were solved without this pair agree with it after all
    elif rejection is None:
        rejection = Rejected(Reason.CONTRADICTS_CAMERAS, {"epipolar_px": undistorted_px})
    reason, code = ("", "") if rejection is None else (rejection.reason, rejection.code)
    rotation_deg = turned_deg(cameras, pair, geometry)
    return PairCheck(rejection is None, reason, code, own_px, adjusted_px, rotation_deg, "solved")


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


def _joins(graph: ViewGraph, components: Sequence[Sequence[str]]) -> tuple[str, ...]:
    """For each further component, the pair that would join it best to the main one: of the cameras with most inliers in each."""

    def strength(name: str) -> tuple[int, str]:
        view = graph.names.index(name)
        return sum(geometry.inliers for edge, geometry in graph.geometries.items() if view in edge), name

    first, *others = [max(component, key=strength) for component in components]
    return tuple("--".join(sorted((first, other), key=graph.names.index)) for other in others)


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
    first = first_views(model.cameras)  # views of one camera are removed together
    while len(model.cameras) > 2:
        balance = dict.fromkeys((first[view] for view in model.cameras if view not in model.held), 0)
        for (i, j), geometry in geometries.items():
            if i in model.cameras and j in model.cameras:
                agrees = undistorted_error_px(model.cameras[i], model.cameras[j], geometry) <= max_epipolar_px
                for view in balance.keys() & {first[i], first[j]}:
                    balance[view] += geometry.inliers if agrees else -geometry.inliers
        worst = min(balance, key=lambda view: (balance[view], view), default=None)
        if worst is None or balance[worst] >= 0:
            break
        worst_views = [view for view in model.cameras if first[view] == worst]
        removed += worst_views
        cameras = {view: camera for view, camera in model.cameras.items() if view not in worst_views}
        model = refine(replace(model, cameras=cameras, use=model.use & ~np.isin(model.tracks.view, worst_views)), rounds=3)
    return model, removed
