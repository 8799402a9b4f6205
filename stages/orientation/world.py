"""Align a solved model with the world: known positions, poses, control points and distances fix its arbitrary frame and scale.

All known data are compared with the solved model at once; data that contradict the rest are reported, and do not distort it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations, islice

import cv2
import numpy as np

from ..core.cameras import camera_id
from ..core.lenses import lens_rays
from ..core.residual_distortion import without_distortion
from ..core.rotations import Similarity, angle_between_deg, nearest_rotation, with_rotation
from ..sfm.incremental import Model, refine, replace_cameras
from ..sfm.rigs import camera_R, first_views
from ..sfm.tracks import Tracks
from ..sfm.triangulation import triangulate
from ..sfm.view_graph import ViewGraph
from ..types import Camera, Float64s, Placement, Survey, View

EXACT_SHARE = 1e-4
"""Smallest standard deviation of a known position in the adjustment, as a share of the scene's distance."""
LOOSE_SHARE = 0.005
"""If all positions are known less well than this share of the scene's distance, they only give frame and scale: the images
determine the shape better."""
TOLERANCE = 0.01
"""Tolerance of a known position: this share of the scene's distance, plus three standard deviations.  With more, positions that
are wrong bend the site; with less, right ones are left out."""
TOLERANCE_DEG = 1.5
"""Tolerance of a known rotation, degrees."""
UP_WEIGHT = 1e-7
"""Weight of the assumption that cameras are upright, against exact data: it decides only what nothing else determines."""
MOST_TRIALS = 3000
"""Largest number of pairs, and of triples, of landmarks that are tried as the minimal set of an alignment."""


@dataclass(frozen=True)
class World:
    """A model of one connected part of the site, in world coordinates or in a frame of its own."""

    model: Model
    placed: bool
    """Whether the frame is that of the site's known positions."""
    metric: bool
    scale: str
    """Source of the scale."""
    suspects: Mapping[str, str] = field(default_factory=dict)
    """Known poses and control points that the images contradict and that are left out, by name, with the reason."""
    doubtful: Mapping[str, str] = field(default_factory=dict)
    """Known poses that stay in use although the model of the others contradicts them, by id, with the reason."""
    contradicting: Mapping[str, str] = field(default_factory=dict)
    """Known poses that the model contradicts so much that it is not aligned with them, by id, with the reason."""


def to_world(graph: ViewGraph, model: Model, placements: Mapping[str, Placement], survey: Survey) -> World:
    """The model in the frame and scale of the known data; trusted poses then stay fixed.

    Parameters
    ----------
    graph, model : views and their names; cameras and points in a frame of their own.
    placements, survey : known poses by id; known distances and control points.
    """
    # 1. What is known about the cameras of the model.  Further views of a camera add no information.
    cameras = model.cameras
    first = first_views(cameras)
    first_cameras = {view: camera for view, camera in cameras.items() if first[view] == view}
    known = {}
    for view in first_cameras:
        name = graph.names[view]
        if name in placements:
            known[view] = placements[name]
    landmarks = _pose_landmarks(graph, cameras, known)
    landmarks += control_landmarks(cameras, graph.names, graph.views, survey)
    up = upward([replace(camera, R=camera_R(camera)) for camera in first_cameras.values()])
    depth = _median_depth(model)
    scale = _scale_of_distances(graph, cameras, survey)
    is_scaled = scale is not None
    scale_source = "none: the median baseline is set to 1, and the cloud is not metric"
    if is_scaled:
        scale_source = "known distances"

    # 2. Align it.  Two landmarks determine the scale, and then distances are only checked.
    alignment = None
    if len(landmarks) == 1:
        alignment = align(landmarks, up, depth, scale)
    elif landmarks:
        alignment = align(landmarks, up, depth)
    if alignment is None:
        # Without a scale, a model cannot be placed relative to several known positions.
        is_placed = bool(landmarks) and (is_scaled or _known_positions(graph, placements) == 1)
        model = _transformed(model, _own_frame(graph, cameras, landmarks, up, scale))
        return World(model, is_placed, is_scaled, scale_source)

    # 3. If too few exact poses agree with the model to place it, it stays in a frame of its own.
    exact_names = []
    for view, p in known.items():
        if p.R is not None and p.C is not None and max(p.sigma_m, p.sigma_deg) == 0:
            exact_names.append(graph.names[view])
    agreeing = {view: p for view, p in known.items() if graph.names[view] in alignment.trusted}
    held = []  # views of cameras whose exact pose agrees
    for view in cameras:
        placement = agreeing.get(first[view])
        if placement is not None and placement.R is not None and placement.sigma_m == 0:
            held.append(view)
    held_cameras = len({first[view] for view in held})
    if held_cameras < 2 <= len(exact_names):
        names = " and ".join(exact_names)
        reason = f"the model of {len(cameras)} cameras contradicts the known poses of {names}: it stays separate, unverified"
        model = _transformed(model, _own_frame(graph, cameras, [], up, scale))
        return World(model, False, is_scaled, scale_source, contradicting=dict.fromkeys(exact_names, reason))

    # 4. Refine it in the world.
    model = _transformed(model, alignment.similarity)
    if held_cameras >= 2:
        stated = {view: _at_stated_pose(model.cameras[view], placements[graph.names[view]]) for view in held}
        model = refine(replace_cameras(model, {**model.cameras, **stated}), held)
    else:
        model = _refined_to_positions(model, agreeing, depth * alignment.similarity.scale)
    metric = is_scaled or all(p.metric for p in known.values() if p.C is not None)
    source = "known distances"
    if len(landmarks) > 1:
        source = _source(alignment.trusted, len(landmarks))
    suspects, doubtful = _deviation_messages(alignment, exact_names)
    return World(model, True, metric, source, suspects, doubtful)


def _pose_landmarks(graph: ViewGraph, cameras: Mapping[int, Camera], known: Mapping[int, Placement]) -> list[Landmark]:
    """The cameras with known positions."""
    landmarks = []
    for view, placement in known.items():
        if placement.C is not None:
            camera = cameras[view]
            landmarks.append(Landmark(graph.names[view], camera.C, placement.C, camera.R, placement.R, placement.sigma_m))
    return landmarks


def _known_positions(graph: ViewGraph, placements: Mapping[str, Placement]) -> int:
    """Number of cameras of the site whose positions are known; all views of a camera count once."""
    first = first_views(dict(enumerate(graph.views)))
    further_views = {name for view, name in enumerate(graph.names) if first[view] != view}
    return sum(p.C is not None for name, p in placements.items() if name not in further_views)


def _refined_to_positions(model: Model, agreeing: Mapping[int, Placement], distance: float) -> Model:
    """The model refined to known positions, if at least three are known, one of them well; distance: of the scene, in metres."""
    positions = {}
    for view, placement in agreeing.items():
        if placement.C is not None:
            positions[view] = (placement.C, max(placement.sigma_m, EXACT_SHARE * distance))
    if len(positions) < 3 or min(sigma for _, sigma in positions.values()) >= LOOSE_SHARE * distance:
        return model
    return refine(model, positions=positions)


def _deviation_messages(alignment: Alignment, exact_names: list[str]) -> tuple[dict[str, str], dict[str, str]]:
    """What to say about known data that contradict the model, by name: those that are left out, and those that stay in use."""
    suspects = {}
    doubtful = {}
    for name, (length, degrees) in alignment.deviations.items():
        if name in exact_names:
            off = f"{length:.3g} m away from its known pose"
            doubtful[name] = f"the model of the others has it {off}. It stays in use: has it been moved?"
        else:
            suspects[name] = _suspect_message(name, length, degrees)
    return suspects, doubtful


def _source(trusted: tuple[str, ...], known_count: int) -> str:
    """Where the scale comes from, such as "4 known positions and 2 control points"."""
    if not trusted:
        return f"{known_count} known positions, which the images contradict"
    points = sum(name.startswith("control point") for name in trusted)
    positions = len(trusted) - points
    parts = []
    if positions:
        parts.append(f"{positions} known positions")
    if points:
        parts.append(f"{points} control points")
    return " and ".join(parts)


def _scale_of_distances(graph: ViewGraph, cameras: Mapping[int, Camera], survey: Survey) -> float | None:
    """Metres for each unit of the model, from the known distances; None without any."""
    ratios = []
    centre_of = {camera_id(graph.names[view], camera): camera.C for view, camera in cameras.items()}
    for i, j, metres in survey.distances:
        a = survey.cameras[i]
        b = survey.cameras[j]
        if a in centre_of and b in centre_of:
            ratios.append(metres / np.linalg.norm(centre_of[a] - centre_of[b]))
    if not ratios:
        return None
    return float(np.median(ratios))


def _own_frame(
    graph: ViewGraph, cameras: Mapping[int, Camera], landmarks: list[Landmark], up: Float64s, scale: float | None
) -> Similarity:
    """Frame with z up and x to the right of the first camera, which is at the origin (or at its known position).

    Without a scale, the median baseline of the matched pairs becomes 1.
    """
    if scale is None:
        baselines = []
        for i, j in graph.geometries:
            if i in cameras and j in cameras:
                baselines.append(np.linalg.norm(cameras[i].C - cameras[j].C))
        scale = 1 / float(np.median(baselines))
    # The camera's x axis, made horizontal.
    first_camera = cameras[min(cameras)]
    right = camera_R(first_camera)[0] - (camera_R(first_camera)[0] @ up) * up
    right /= np.linalg.norm(right)
    R = np.array([right, np.cross(up, right), up])
    origin = first_camera.C
    target = np.zeros(3)
    if landmarks:
        origin = landmarks[0].model_X
        target = landmarks[0].world_X
        if landmarks[0].world_R is not None and landmarks[0].model_R is not None:
            R = landmarks[0].world_R.T @ landmarks[0].model_R
    return Similarity(scale, R, target - scale * R @ origin)


def _at_stated_pose(camera: Camera, placement: Placement) -> Camera:
    """The camera with the lens of the model, at a pose that is completely stated."""
    assert placement.R is not None and placement.C is not None
    return replace(camera, R=placement.R, C=placement.C)


def _transformed(model: Model, similarity: Similarity) -> Model:
    """The model, with cameras and points in another frame."""
    cameras = {view: similarity.camera(camera) for view, camera in model.cameras.items()}
    return replace(model, cameras=cameras, X=similarity.points(model.X))


def _median_depth(model: Model) -> float:
    """Median depth of the points over all observations in use, in units of the model."""
    depths = []
    for view, camera in model.cameras.items():
        rows = model.use & (model.tracks.view == view)
        depths.append((model.X[model.tracks.track[rows]] - camera.C) @ camera.R[2])
    return float(np.median(np.concatenate(depths)))


def _suspect_message(name: str, length: float, degrees: float) -> str:
    """What to say about a known position that is left out; degrees: nan if no rotation is known."""
    rotation = "" if np.isnan(degrees) else f" and {degrees:.1f} degrees"
    subject = name if name.startswith("control point") else f"the known pose of {name}"
    return f"{subject} contradicts the images: it seems off by {length:.3g} m{rotation}; left out"


@dataclass(frozen=True)
class Landmark:
    """A position that is known both in the model and in the world: of a camera, or of a control point."""

    name: str
    model_X: Float64s
    world_X: Float64s
    """(3,)."""
    model_R: Float64s | None = None
    world_R: Float64s | None = None
    """(3, 3) world to camera axes, for a camera whose rotation is known too."""
    sigma: float = 0.0
    """Standard deviation of world_X, 0 if it is exact."""


@dataclass(frozen=True)
class Alignment:
    """Similarity from a model to the world, and the landmarks that support it."""

    similarity: Similarity
    """Model to world."""
    trusted: tuple[str, ...]
    """Names of the landmarks that agree with it."""
    deviations: dict[str, tuple[float, float]]
    """Deviations of the other landmarks, by name: length in the world, degrees (nan if no rotation is known)."""


def align(landmarks: Sequence[Landmark], up: Float64s, depth: float, scale: float | None = None) -> Alignment | None:
    """The similarity that most landmarks agree on.

    Parameters
    ----------
    landmarks : at least two; one is enough if `scale` is known.
    up : (3,) the direction in the model that is +z in the world unless the landmarks determine another.
    depth : median distance of the scene from its cameras, in the model.
    scale : if known from elsewhere; None is returned if neither this nor the landmarks determine it.
    """

    def agreement(similarity: Similarity) -> tuple[int, float]:
        """Number of landmarks within their tolerance; of equal ones, the smallest sum of truncated errors wins."""
        errors = np.array([_relative_deviation(similarity, landmark, depth) for landmark in landmarks])
        return int((errors <= 1).sum()), -float(np.sum(np.minimum(errors, 1)))

    def agreeing(similarity: Similarity) -> list[Landmark]:
        return [landmark for landmark in landmarks if _relative_deviation(similarity, landmark, depth) <= 1]

    # 1. The best of the similarities that minimal sets of landmarks determine; the first of equal ones.
    candidates = []
    for subset in _subsets(landmarks, scale):
        candidate = fit_similarity(subset, up, scale)
        if candidate is not None:
            candidates.append(candidate)
    if not candidates:
        return None
    similarity = max(candidates, key=agreement)

    # 2. Fit it to all that agree with it, which may change who agrees.
    for _ in range(3):
        trusted = agreeing(similarity)
        refitted = fit_similarity(trusted, up, scale) if trusted else None
        if refitted is None:
            break
        similarity = refitted
    names = tuple(landmark.name for landmark in agreeing(similarity))
    deviations = {}
    for landmark in landmarks:
        if landmark.name not in names:
            deviations[landmark.name] = _deviation(similarity, landmark)
    return Alignment(similarity, names, deviations)


def fit_similarity(landmarks: Sequence[Landmark], up: Float64s, scale: float | None = None) -> Similarity | None:
    """Least squares over landmarks (Wahba's problem over baselines and known rotations, solved by SVD); None without a scale.

    Parameters
    ----------
    landmarks : at least one.
    up, scale : see `align`.

    References
    ----------
    Wahba, A least squares estimate of satellite attitude, SIAM Review 7, 1965.
    """
    # 1. Weights: exact landmarks count as if they had a tenth of the smallest sigma.
    sigmas = np.array([landmark.sigma for landmark in landmarks])
    known_sigmas = sigmas[sigmas > 0]
    exact_sigma = 1.0
    if len(known_sigmas):
        exact_sigma = 0.1 * known_sigmas.min()
    weight = 1 / np.where(sigmas > 0, sigmas, exact_sigma) ** 2
    weight /= weight.sum()

    # 2. Is the scale determined: are the landmarks apart, by more than rounding errors, in both frames?
    source = np.array([landmark.model_X for landmark in landmarks])
    target = np.array([landmark.world_X for landmark in landmarks])
    source_mean = weight @ source
    target_mean = weight @ target
    centred_source = source - source_mean
    centred_target = target - target_mean
    source_spread = np.sqrt(weight @ (centred_source**2).sum(1))
    target_spread = np.sqrt(weight @ (centred_target**2).sum(1))
    size = np.abs(target_mean).max() + np.abs(source_mean).max() + 1e-300
    has_extent = source_spread > 1e-12 * size and target_spread > 1e-12 * size
    if not has_extent and scale is None:
        return None
    # 3. The rotation closest to all evidence: M sums outer products of directions in the world and in the model.  The less the
    # positions determine it, the more the assumed direction up counts.
    noise = 0.0
    if has_extent:
        noise = np.mean([landmark.sigma**2 for landmark in landmarks]) / target_spread**2
    M = (UP_WEIGHT + noise) * np.outer([0.0, 0.0, 1.0], up)
    if has_extent:
        M += np.einsum("n,ni,nj->ij", weight, centred_target, centred_source) / (source_spread * target_spread)
    rotations = []
    for landmark in landmarks:
        if landmark.world_R is not None and landmark.model_R is not None:
            rotations.append(landmark.world_R.T @ landmark.model_R)
    if rotations:
        M += np.mean(rotations, axis=0)
    return with_rotation(nearest_rotation(M), source, target, weight, scale)


def upward(cameras: Sequence[Camera]) -> Float64s:
    """(3,) the most likely upward direction: cameras are mounted level, so x axes are horizontal and y axes point down."""
    x = np.array([camera.R[0] for camera in cameras])
    down = np.mean([camera.R[1] for camera in cameras], axis=0)
    down /= np.linalg.norm(down) + 1e-300
    # The direction most nearly at right angles to all x axes; the second term decides if these are parallel.
    _, vectors = np.linalg.eigh(x.T @ x / len(x) - 0.1 * np.outer(down, down))
    up = vectors[:, 0]
    if up @ down > 0:
        up = -up
    return np.asarray(up, dtype=np.float64)


def _subsets(landmarks: Sequence[Landmark], scale: float | None) -> list[Sequence[Landmark]]:
    """The minimal sets that fix a similarity, after the set of all landmarks, which thus wins if nothing contradicts it."""
    oriented = [landmark for landmark in landmarks if landmark.world_R is not None]
    subsets: list[Sequence[Landmark]] = [landmarks]
    if scale is not None:
        subsets += [[landmark] for landmark in oriented]
    # Two positions leave a rotation about the line through them, which a known rotation determines.
    pairs = ((a, b) for a, b in combinations(landmarks, 2) if a.world_R is not None or b.world_R is not None)
    subsets += islice(pairs, MOST_TRIALS)
    subsets += islice(combinations(landmarks, 3), MOST_TRIALS)
    return [subset for subset in subsets if subset]


def _relative_deviation(similarity: Similarity, landmark: Landmark, depth: float) -> float:
    """Deviation of a landmark, as a share of the tolerance."""
    length, degrees = _deviation(similarity, landmark)
    tolerated = 3 * landmark.sigma + TOLERANCE * depth * similarity.scale
    if np.isnan(degrees):
        return max(length / tolerated, 0.0)
    return max(length / tolerated, degrees / TOLERANCE_DEG)


def _deviation(similarity: Similarity, landmark: Landmark) -> tuple[float, float]:
    """Deviation of a landmark from the model: length, degrees (nan if its rotation is unknown)."""
    length = float(np.linalg.norm(similarity.points(landmark.model_X[None])[0] - landmark.world_X))
    if landmark.model_R is None or landmark.world_R is None:
        return length, float("nan")
    return length, angle_between_deg(landmark.model_R @ similarity.R.T, landmark.world_R)


def control_landmarks(
    cameras: Mapping[int, Camera], names: Sequence[str], views: Sequence[View], survey: Survey
) -> list[Landmark]:
    """The control points that at least two of the cameras see.

    Parameters
    ----------
    cameras : solved cameras by number.
    names, views : of all cameras, by number.
    survey : positions of the points, and the pixels at which cameras see them.
    """
    ids = {view: camera_id(names[view], views[view]) for view in sorted(cameras)}
    rows = []  # point, view, x, y
    for point, camera, x, y in survey.observations:
        # A camera with several views sees the point in the first one whose frame contains it.
        camera_views = [view for view, name in ids.items() if name == survey.cameras[camera]]
        for view in camera_views:
            u, v = _in_frame(np.array([[x, y]]), views[view], cameras[view])[0]
            is_only_view = len(camera_views) == 1 and np.isfinite(u)
            if is_only_view or (0 <= u < views[view].width and 0 <= v < views[view].height):
                rows.append((point, view, u, v))
                break
    rows.sort(key=lambda row: row[:2])
    if not rows:
        return []
    tracks = Tracks(
        track=np.array([row[0] for row in rows], np.int32),
        view=np.array([row[1] for row in rows], np.int32),
        xy=np.array([row[2:] for row in rows], np.float64),
        count=len(survey.points),
    )
    X = triangulate(cameras, tracks, np.ones(len(rows), bool), 1.0)
    triangulated = np.flatnonzero(np.isfinite(X[:, 0]))
    landmarks = []
    for k in triangulated.tolist():
        landmarks.append(Landmark(f"control point {k + 1}", X[k], np.array(survey.points[k])))
    return landmarks


def _in_frame(x: Float64s, view: View, camera: Camera) -> Float64s:
    """(n, 2) pixels of the capture, mapped to the undistorted frame; nan behind the view."""
    if view.lens is not None:
        # A wide lens: along the rays of the capture, turned into the view, through its pinhole.
        directions = lens_rays(view.lens, x)
        if view.lens.turn is not None:
            directions = directions @ view.lens.turn.T
        projected = directions @ camera.K.T
        z = np.where(projected[:, 2:] > 0, projected[:, 2:], np.nan)
        return np.asarray(projected[:, :2] / z, dtype=np.float64)
    # The working resolution: centres of pixels have integer coordinates, hence the halves.
    scale_x = view.width / (view.captured_width or view.width)
    scale_y = view.height / (view.captured_height or view.height)
    x = (x + 0.5) * np.array([scale_x, scale_y]) - 0.5
    if np.any(view.distortion):
        x = np.asarray(cv2.undistortPoints(x[:, None], camera.K, view.distortion, P=camera.K)[:, 0], dtype=np.float64)
    return without_distortion(camera, x)
