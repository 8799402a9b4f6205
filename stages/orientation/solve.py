"""Solve cameras from the geometries of their pairs: grow models, align them with the world, judge every pair by them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ..contracts.reasons import Reason, Rejected
from ..contracts.unknown import known_or_none
from ..core.cameras import relative_pose
from ..core.epipolar import fundamental_from_cameras, symmetric_epipolar_distance
from ..core.residual_distortion import UNDISTORTED_PX, residual_px, without_distortion
from ..sfm.consistent_matches import consistent_matches
from ..sfm.incremental import Model, refine
from ..sfm.loops import WITHOUT_REPETITION, LoopStatistics
from ..sfm.rigs import first_views
from ..sfm.tracks import Edge
from ..sfm.view_graph import ViewGraph
from ..types import Camera, Geometry, Pair, PairCheck, Placement, PoseIssue, Poses, Survey, View
from .lens_sigma import MOST_SIGMA_PX, lens_sigmas, with_principal_points
from .pose_check import LEAST_PROBABILITY, confirmed, epipolar_error_px, turned_deg
from .triplet_consistency import FEWEST, MOST_INCONSISTENCY, inconsistency
from .world import World, to_world

MOST_EXCESS = 5.6e-4
"""Largest plausible `_excess_px` of a solved camera, as a share of the long side (0.18 px of 320).  With more, cameras that
look-alikes misplace go unnoticed (measured on 15 rendered scenes at 320 px: right poses up to 0.16 px, most that are more than a
degree off 0.20 to 1.1 px)."""


def solve_from_pairs(
    views: Mapping[str, View],
    placements: Mapping[str, Placement],
    geometries: Mapping[Pair, Geometry],
    survey: Survey,
    stated: Mapping[str, Camera],
    max_rotation_error_deg: float,
    max_epipolar_px: float,
    statistics: LoopStatistics = WITHOUT_REPETITION,
) -> Poses | Rejected:
    """Solve the poses that are not known.

    Parameters
    ----------
    views, placements, geometries, survey, max_rotation_error_deg, max_epipolar_px : see `poses.solve_poses`.
    stated : cameras whose intrinsics and poses are both known, by id.
    statistics : statistics of scenes that do not repeat, for the check of the site's loops.
    """
    exact = {}
    for name, camera in stated.items():
        if placements[name].sigma_m == 0 and placements[name].sigma_deg == 0:
            exact[name] = camera

    # 1. Build models from pairs that agree with exact cameras and with each other.
    graph = ViewGraph.of(views, _consistent(exact, geometries, max_epipolar_px))
    accepted, dropped = graph.consistent(max_rotation_error_deg, statistics)
    held = {view: exact[name] for view, name in enumerate(graph.names) if name in exact}
    models, removed = _refined(graph.models(accepted, held), accepted, max_epipolar_px)

    # 2. If matches strain a model, try again with those that third cameras confirm.
    strained = []
    for model in models:
        strain = inconsistency(model, accepted)
        if strain > MOST_INCONSISTENCY:
            strained.append((model, strain))
    if strained:
        confirmed_matches = consistent_matches(accepted, FEWEST)
        retried, retried_removed = _refined(graph.models(confirmed_matches, held), accepted, max_epipolar_px)
        if retried:
            models = retried
            removed = retried_removed
    if not models:
        return graph.why_nothing(accepted, dropped)

    # 3. Align them with the world; those in the site's frame come first.
    worlds = [to_world(graph, model, placements, survey) for model in models]
    worlds.sort(key=lambda world: not world.placed)
    main = worlds[0]
    if not main.placed and len(exact) >= 2:
        # No solved model is aligned with the known cameras, which are the main part by themselves.
        metric = all(placements[name].metric for name in exact)
        scale = "calibration" if metric else "calibration, not metric"
        main = replace(main, metric=metric, scale=scale, placed=True)
    if main.placed:
        cameras = _cameras_of(graph, worlds, exact, stated)
    else:
        cameras = _cameras_of(graph, worlds, {}, {})

    # 4. Judge every pair by the cameras.
    checks = {}
    for edge in graph.geometries:
        checks["--".join(graph.ids(edge))] = _check(graph, edge, cameras, dropped.get(edge), max_epipolar_px)
    unsupported = {graph.names[view] for view in removed}
    unsolved = {}
    for name in graph.names:
        if name not in cameras:
            unsolved[name] = _why_unsolved(graph, name, dropped, unsupported)
    sound = set(stated) & set(cameras)
    for world in worlds:
        sound -= set(world.suspects)
    source = "mixed" if sound else "solved"
    issues = _issues(graph, worlds, strained, checks, stated)
    poses = _poses_of(graph, worlds, main, cameras, unsolved, checks, source)
    return replace(poses, issues=issues, crs=survey.crs if main.placed else "")


def _poses_of(
    graph: ViewGraph,
    worlds: list[World],
    main: World,
    cameras: dict[str, Camera],
    unsolved: dict[str, str],
    checks: dict[str, PairCheck],
    source: str,
) -> Poses:
    """`Poses` without issues, from the models in their worlds and the checks of pairs."""
    names_of_component: dict[int, list[str]] = {}
    for name, camera in cameras.items():
        names_of_component.setdefault(camera.component, []).append(name)
    components = tuple(tuple(names_of_component.get(k, ())) for k in range(1 + max(names_of_component)))
    focals = []
    for view, name in enumerate(graph.names):
        if view in graph.lenses.solved and name in cameras:
            focals.append(name)
    errors = np.concatenate([world.model.error_px()[world.model.use] for world in worlds])
    points = 0
    for world in worlds:
        points += int(np.isfinite(world.model.X[:, 0]).sum())
    return Poses(
        cameras=cameras,
        unsolved=unsolved,
        dropped={pair: check.reason for pair, check in checks.items() if not check.kept},
        metric=main.metric,
        source=source,
        pair_checks=checks,
        focals=tuple(focals),
        components=components,
        joins=_joins(graph, components),
        scale=main.scale,
        notes=_notes(cameras),
        points=points,
        reprojection_px=float(np.median(errors)),
    )


def _refined(grown: Sequence[Model], accepted: Mapping[Edge, Geometry], max_epipolar_px: float) -> tuple[list[Model], list[int]]:
    """The models after adjustment, without unsupported views; and the views that were removed."""
    models = []
    removed = []
    for model in grown:
        adjusted = with_principal_points(refine(model, rounds=3))
        supported, removed_views = without_unsupported(adjusted, accepted, max_epipolar_px)
        removed += removed_views
        if supported.use.any():
            models.append(supported)
    return models, removed


def _consistent(exact: Mapping[str, Camera], geometries: Mapping[Pair, Geometry], max_epipolar_px: float) -> dict[Pair, Geometry]:
    """The geometries without pairs of exact cameras that contradict these; other such pairs, if probable, get the stated pose."""
    consistent = {}
    for pair, geometry in geometries.items():
        if not set(pair) <= set(exact):
            consistent[pair] = geometry
            continue
        if not epipolar_error_px(exact, pair, geometry) <= max_epipolar_px:  # "not": the error may be nan
            continue
        # Improbable pairs may match look-alikes along the epipolar lines, so agreement does not confirm them.
        if geometry.good_probability >= LEAST_PROBABILITY:
            R, t = relative_pose(exact[pair[0]], exact[pair[1]])
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
        component = 0
        if cameras and not world.placed:
            component = 1 + max(camera.component for camera in cameras.values())
        for view, camera in world.model.cameras.items():
            cameras.setdefault(graph.names[view], replace(camera, component=component))
    cameras = {**stated, **cameras}
    return {name: cameras[name] for name in graph.names if name in cameras}


def _issues(
    graph: ViewGraph, worlds: list[World], strained: list[tuple[Model, float]], checks: Mapping[str, PairCheck],
    stated: Mapping[str, Camera],
) -> tuple[PoseIssue, ...]:  # fmt: skip
    """The doubts about known poses, about lenses, and about solved cameras whose matches contradict each other."""
    # 1. Known poses that the models contradict.
    moved: dict[str, str] = {}
    unverified = []
    contradicted = []
    for world in worlds:
        moved |= world.suspects
        for name, reason in world.doubtful.items():
            unverified.append(PoseIssue("unverified", name, reason, True))
        for name, reason in world.contradicting.items():
            contradicted.append(PoseIssue("contradicted", name, reason, True))

    # 2. Lenses that the images do not determine.
    sigmas = {}
    solved = {}
    for world in worlds:
        for view, sigma in lens_sigmas(world.model).items():
            sigmas[graph.names[view]] = sigma
        for view, camera in world.model.cameras.items():
            solved[graph.names[view]] = camera
    undetermined = []
    for name in graph.names:
        lens = sigmas.get(name)
        if lens and not lens.border_px <= MOST_SIGMA_PX:  # "not": it may be nan
            undetermined.append(PoseIssue("lens-undetermined", name, focal=lens.focal, border_px=lens.border_px))

    # 3. Models that matches strain; those with two known cameras have their frame, which strains them, too.
    strains = {}
    for model, strain in strained:
        if len(model.held) < 2:
            for view in model.cameras:
                strains[graph.names[view]] = strain
    inconsistent = [PoseIssue("inconsistent", name, strain=strain) for name, strain in strains.items()]

    # 4. Solved cameras whose pairs fit poses of their own much better.
    for name, camera in solved.items():
        if name in stated or name in strains:
            continue
        excess_px = _excess_px(name, graph, checks)
        if excess_px > MOST_EXCESS * max(camera.width, camera.height):
            inconsistent.append(PoseIssue("inconsistent", name, excess_px=excess_px))
    suspected = [PoseIssue("moved", name, reason) for name, reason in moved.items()]
    return (*suspected, *unverified, *contradicted, *undetermined, *inconsistent)


def _excess_px(name: str, graph: ViewGraph, checks: Mapping[str, PairCheck]) -> float:
    """How much farther the matches of a camera's pairs are from the epipolar lines of the cameras than from those of their own F.

    The median of its pairs with stated lenses (F adapts to others), weighted by right inliers, in pixels; nan without pairs.
    """
    excesses: list[tuple[float, float]] = []
    for edge, geometry in graph.geometries.items():
        check = checks["--".join(graph.ids(edge))]
        has_lenses = not set(edge) & set(graph.lenses.solved)
        if name in graph.ids(edge) and has_lenses and check.adjusted_px is not None and check.estimated_px is not None:
            excesses.append((check.adjusted_px - check.estimated_px, geometry.inliers * geometry.good_probability))
    if not excesses:
        return float("nan")
    values, weights = np.array(sorted(excesses)).T
    # The weighted median: the first value up to which half of the weight lies.
    return float(values[np.searchsorted(weights.cumsum(), weights.sum() / 2)])


def _notes(cameras: Mapping[str, Camera]) -> tuple[str, ...]:
    """A note about solved lenses whose distortion remains in the frames; () if there are none."""
    distorted = {}
    for name, camera in cameras.items():
        px = residual_px(camera)
        if px > UNDISTORTED_PX:
            distorted[name] = px
    if not distorted:
        return ()
    message = f"the lenses of {', '.join(distorted)} bend straight lines (corners by up to {max(distorted.values()):.1f} px)"
    return (f"{message}: later stages are corrected for it; matching is, too, once these solved cameras are the calibration",)


def _check(
    graph: ViewGraph, edge: Edge, cameras: Mapping[str, Camera], rejection: Rejected | None, max_epipolar_px: float
) -> PairCheck:
    """Is a pair kept, given the solved cameras?  rejection: why it was dropped before they were solved, if it was."""
    geometry = graph.geometries[edge]
    pair = graph.ids(edge)
    own_px = float(np.median(symmetric_epipolar_distance(geometry.F, geometry.x1, geometry.x2)))
    left = cameras.get(pair[0])
    right = cameras.get(pair[1])
    if left is None or right is None:
        unplaced = rejection or Rejected(Reason.CAMERA_NOT_PLACED)
        return PairCheck(rejection is None, unplaced.reason, unplaced.code, own_px)
    if left.component != right.component:
        separate = rejection or Rejected(Reason.CAMERAS_APART)
        return PairCheck(False, separate.reason, separate.code, own_px)
    adjusted_px = epipolar_error_px(cameras, pair, geometry)
    undistorted_px = undistorted_error_px(left, right, geometry)
    rotation_deg = turned_deg(cameras, pair, geometry)
    if undistorted_px <= max_epipolar_px:
        # Cameras that were solved without this pair agree with it after all.
        return PairCheck(True, "", "", own_px, known_or_none(adjusted_px), known_or_none(rotation_deg), "solved")
    if rejection is None:
        rejection = Rejected(Reason.CONTRADICTS_CAMERAS, {"epipolar_px": undistorted_px})
    return PairCheck(
        kept=False,
        reason=rejection.reason,
        code=rejection.code,
        estimated_px=own_px,
        adjusted_px=known_or_none(adjusted_px),
        rotation_off_deg=known_or_none(rotation_deg),
        known="solved",
    )


def _why_unsolved(graph: ViewGraph, name: str, dropped: Mapping[Edge, Rejected], unsupported: set[str]) -> str:
    """Why a camera is in no model, in words."""
    view = graph.names.index(name)
    own_edges = [edge for edge in graph.geometries if view in edge]
    if view not in graph.lenses.K:
        return "no focal length: none is given, and none can be estimated from its pairs"
    if not own_edges:
        return "no pair with it has a geometry"
    if all(edge in dropped for edge in own_edges):
        none_is = f"none of its {len(own_edges)} pairs is"
        each = f"each of its {len(own_edges)} pairs"
        if len(own_edges) == 1:
            none_is = "its only pair is not"
            each = "its only pair"
        if all(_lacks_evidence(dropped[edge]) for edge in own_edges):
            return f"{none_is} reliable: too few distinctive matches, and no third camera confirms them"
        return f"{each} contradicts the others"
    if name in unsupported:
        return "the pose from its shared points contradicts the pairs with the most matches"
    return "too few points in common with the solved cameras"


def _lacks_evidence(rejection: Rejected) -> bool:
    """Was a pair dropped for lack of evidence?  Without triangles, nothing contradicts it."""
    return rejection.why in (Reason.UNCONFIRMED, Reason.NOT_BELIEVED) and not rejection.figures["triangles"]


def _joins(graph: ViewGraph, components: Sequence[Sequence[str]]) -> tuple[str, ...]:
    """For each further component, the pair that would join it best to the main one: of the cameras with most inliers in each."""

    def strength(name: str) -> tuple[int, str]:
        view = graph.names.index(name)
        inliers = 0
        for edge, geometry in graph.geometries.items():
            if view in edge:
                inliers += geometry.inliers
        return inliers, name

    first, *others = [max(component, key=strength) for component in components]
    joins = []
    for other in others:
        pair = sorted((first, other), key=graph.names.index)
        joins.append("--".join(pair))
    return tuple(joins)


def undistorted_error_px(left: Camera, right: Camera, geometry: Geometry) -> float:
    """Median distance of a pair's inliers, with radial distortion removed, to the epipolar lines of its cameras."""
    x1 = without_distortion(left, geometry.x1)
    x2 = without_distortion(right, geometry.x2)
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
        # Of each camera that may be removed: inliers of pairs that agree with it, minus those of pairs that contradict it.
        balance = dict.fromkeys((first[view] for view in model.cameras if view not in model.held), 0)
        for (i, j), geometry in geometries.items():
            if i not in model.cameras or j not in model.cameras:
                continue
            error_px = undistorted_error_px(model.cameras[i], model.cameras[j], geometry)
            inliers = geometry.inliers
            if not error_px <= max_epipolar_px:  # "not": it may be nan
                inliers = -inliers
            for view in balance.keys() & {first[i], first[j]}:
                balance[view] += inliers
        # The worst camera goes, and the rest is adjusted without it, before the next is judged.
        worst = min(balance, key=lambda view: (balance[view], view), default=None)
        if worst is None or balance[worst] >= 0:
            break
        worst_views = [view for view in model.cameras if first[view] == worst]
        removed += worst_views
        cameras = {view: camera for view, camera in model.cameras.items() if view not in worst_views}
        use = model.use & ~np.isin(model.tracks.view, worst_views)
        model = refine(replace(model, cameras=cameras, use=use), rounds=3)
    return model, removed
