"""Fast stand-ins for the stages, with which the engine's tests plan, cache, kill and resume.

Each result has numbers that depend on all inputs of its stage, so that a wrongly reused result shows in the cloud.  Tests cause
faults by files in the folder TOY_FAULTS (an environment variable): `slow` has the seconds that every stage sleeps; `die` names
a stage that kills its worker, as long as the file is there; `once` does the same once, since the file is removed first.
"""

from __future__ import annotations

import dataclasses
import hashlib
import os
import signal
import time
from collections.abc import Mapping, Sequence
from dataclasses import MISSING
from pathlib import Path
from typing import Any, cast

import numpy as np

from wbflow_stages.contracts.camera_figures import HealthState
from wbflow_stages.contracts.ground_figures import UsedIds
from wbflow_stages.contracts.observation_figures import ObservedCamera
from wbflow_stages.contracts.reasons import Reason
from wbflow_stages.types import (
    Camera,
    CameraHealth,
    Capture,
    Change,
    Changes,
    Cloud,
    DepthMap,
    Disparity,
    Features,
    Frame,
    Geometry,
    GroundGrid,
    Lens,
    Matches,
    Observations,
    ObservedPoses,
    Overlap,
    Pair,
    PairCheck,
    Placement,
    Poses,
    Rectification,
    Rejected,
    ShiftHistory,
    Survey,
    ThingSurvey,
    View,
)


def clean_frame(captures: Sequence[Capture], lens: Lens, mask: Capture | None, *, resolution: int | None = None) -> Frame:
    """Captures are text: `broken` raises, other text becomes pixels; "ok/obscured/ok: a view" gives the states of three views.

    "ok: a view; van 5, stack -3" lists what differs from the reference (see `find_changes`)."""
    _trouble("frames")
    data = b"".join(capture.data.tobytes() for capture in captures)
    if data.startswith(b"broken"):
        raise ValueError(f"{captures[0].name} is not an image")
    pixels = np.frombuffer(hashlib.sha256(data).digest() * 6, dtype=np.uint8).reshape(8, 8, 3)
    state = data.split(b":")[0].decode() if b":" in data else "ok"
    if lens.turn is not None:  # the middle, left or right view
        state = state.split("/")[int(np.sign(np.round(lens.turn[2, 0], 6))) % 3 * 2 % 3] if "/" in state else state
    view = View(8, 8, np.eye(3), lens=lens if lens.camera else None)
    things = data.decode(errors="replace").partition(";")[2].strip()
    return Frame(pixels, np.ones((8, 8), bool), view, notes=("toy", state, things) if things else ("toy", state))


def examine(frame: Frame, pinned_frame: Frame | None, history: ShiftHistory | None, *, nudged_px: float = 1.5) -> CameraHealth:
    """The capture itself gives its state, as in "shifted: a view"; a figure counts the earlier nights."""
    _trouble("health")
    state = cast(HealthState, frame.notes[1] if pinned_frame else "ok")
    figures = {"shift_x_px": 0.5, "shift_y_px": 0.0, "roll_deg": 0.0, "nights": float(len(history.roll_deg)) if history else -1.0}
    measured = figures if pinned_frame else {}
    return CameraHealth(state, "as the capture says", measured, remedy="none", corrected=state == "shifted")


def detect(frame: Frame, *, offset: float = 0.0) -> Features:
    """One keypoint whose position depends on the pixels."""
    _trouble("features")
    xy = np.array([[frame.image.mean() + offset, float(frame.image[0, 0, 0])]])
    ones = np.ones(1, np.float32)
    view = dataclasses.replace(frame.view, width=300, height=300)  # which the keypoint lies in
    return Features(xy, np.eye(2)[None], np.ones((1, 4), np.float32), ones, np.zeros(1, np.uint8), view)


def solve_observations(
    observations: Observations,
    lenses: Mapping[str, Lens],
    placements: Mapping[str, Placement],
    thing_survey: ThingSurvey | None,
    *,
    least: int = 1,
) -> ObservedPoses | Rejected:
    """A camera's x is the sum of its observed pixels; one with fewer than `least` observations is not placed."""
    _trouble("observed")
    placed = {}
    figures = {}
    for number, name in enumerate(observations.cameras):
        rows = observations.camera == number
        count = int(rows.sum())
        if count < least:
            figures[name] = ObservedCamera(count, reason=f"{count} observations, {least} needed")
            continue
        C = np.array([observations.xy[rows].sum(), float(thing_survey.position.sum()) if thing_survey else 0.0, len(lenses)])
        placed[name] = Placement(np.eye(3), C, 0.02, 0.01)
        figures[name] = ObservedCamera(count, count, 0.5, sigma_m=0.02, sigma_deg=0.01)
    if len(placed) < 2:
        return Rejected("nobody saw it at once")
    unit = observations.time_unit
    return ObservedPoses(
        placed,
        track=np.zeros((1, 3)),
        cameras=figures,
        things=1,
        reprojection_px=0.5,
        metric=True,
        scale="survey",
        time_unit=unit,
    )


def estimate_overlap(
    views: Mapping[str, View], placements: Mapping[str, Placement], features: Mapping[str, Features], *, chain: bool = False
) -> Overlap:
    """Every camera shares something with every other; with `chain`, only with the next one."""
    _trouble("overlap")
    names = tuple(views)
    pairs = np.array([(i, j) for i in range(len(names)) for j in range(i + 1, len(names))], np.int32).reshape(-1, 2)
    shared = (np.diff(pairs, axis=1)[:, 0] == 1).astype(float) if chain else np.ones(len(pairs))
    return Overlap(names, pairs, np.full(len(pairs), np.nan), shared, "appearance")


def share(poses: Poses, *, reject: bool = False) -> Overlap | Rejected:
    """Every placed camera sees the same as every other."""
    _trouble("shared")
    if reject:
        return Rejected("nobody knows")
    names = tuple(poses.cameras)
    pairs = np.array([(i, j) for i in range(len(names)) for j in range(i + 1, len(names))], np.int32).reshape(-1, 2)
    return Overlap(names, pairs, np.full(len(pairs), 20.0), np.ones(len(pairs)), "poses")


def match(left: Features, right: Features, *, shift: float = 1.0, reject: str = "") -> Matches | Rejected:
    """A match between the two keypoints; rejected if `reject` is the integer part of the left one's y."""
    _trouble("matches")
    if reject and str(int(left.xy[0, 1])) == reject:
        return Rejected(Reason.TOO_FEW_MATCHES, {"matches": 0.0, "needed": 1.0})
    rows = np.zeros(1, np.int32)
    return Matches(left.xy + shift, right.xy, rows, rows, np.ones(1, np.float32), np.eye(2)[None], left.view, right.view)


def estimate_geometry(matches: Matches, left: Features, right: Features, *, needed: int = 1) -> Geometry | Rejected:
    """F depends on the matches; rejected if there are fewer than `needed`."""
    _trouble("geometry")
    if len(matches.x1) < needed:
        return Rejected(Reason.TOO_FEW_INLIERS, {"inliers": 0.0, "matches": float(len(matches.x1)), "needed": float(needed)})
    F = np.diag([matches.x1.sum(), matches.x2.sum(), 1.0])
    shared = {name: getattr(matches, name) for name in ("x1", "x2", "i1", "i2", "probability", "view1", "view2")}
    geometry: Geometry = _filled(Geometry, F=F, cam2_R_cam1=None, cam2_t_cam1=None, matches=1, warnings=(), **shared)
    return geometry


def solve_poses(
    views: Mapping[str, View],
    placements: Mapping[str, Placement],
    geometries: Mapping[Pair, Geometry],
    survey: Survey,
    observed: ObservedPoses | None,
    *,
    worlds: int = 1,
    leave_out: str = "",
    metric: bool = True,
) -> Poses | Rejected:
    """Cameras in a row, distributed among `worlds` components; `leave_out` stays unsolved."""
    _trouble("poses")
    unsolved = {name: "is left out" for name in views if name == leave_out}
    names = [name for name in views if name not in unsolved]
    groups = tuple(tuple(names[k::worlds]) for k in range(worlds))
    cameras = {
        n: Camera(np.eye(3), np.eye(3), np.array([i, 0.0, 0.0]), 8, 8, component=i % worlds, lens=views[n].lens)
        for i, n in enumerate(names)
    }
    sources = {}
    for name, placement in (observed.placements if observed else {}).items():
        if name in cameras and placement.C is not None:
            cameras[name] = dataclasses.replace(cameras[name], C=placement.C)
            sources[name] = "observed"
    return Poses(
        cameras, unsolved=unsolved, metric=metric, source="calibration", components=groups, crs=survey.crs, sources=sources
    )


def rectify(
    geometry: Geometry,
    left: Camera | None,
    right: Camera | None,
    check: PairCheck | None,
    *,
    margin: float = 0.0,
    reject: bool = False,
) -> Rectification | Rejected:
    """H1 and H2 depend on F and the cameras."""
    _trouble("rectify")
    if reject:
        return Rejected("almost no baseline")
    assert left is not None
    assert right is not None
    H = geometry.F + left.C + right.C + margin
    rectification: Rectification = _filled(Rectification, method="hartley", reason="toy", H1=H, H2=H, size1=(8, 8), size2=(8, 8))
    return rectification


def rectify_known(left: Camera, right: Camera, check: PairCheck | None, geometry: Geometry | None = None) -> Rectification:
    """Rectification from known cameras; matches are ignored."""
    H = np.eye(3) + left.C + right.C
    rectification: Rectification = _filled(Rectification, method="hartley", reason="toy", H1=H, H2=H, size1=(8, 8), size2=(8, 8))
    return rectification


def match_dense(left: Frame, right: Frame, rectification: Rectification, *, tolerance: float = 1.0) -> Disparity:
    """Disparities depend on the frames and the rectification."""
    _trouble("disparity")
    assert rectification.H1 is not None
    number = int(abs(rectification.H1).sum() * 7 + left.image.sum() + right.image.sum() * 3 + tolerance * 1000) % 30000
    values = np.full((8, 8), number, np.int16)
    confidence = np.full((8, 8), 255, np.uint8)
    return Disparity(values, values, confidence, confidence, 0, 1.0)


def view_depth(
    camera: Camera,
    cameras: Mapping[str, Camera],
    rectifications: Mapping[Pair, Rectification],
    disparities: Mapping[Pair, Disparity],
) -> DepthMap | Rejected:
    """A depth map of one row, with one pixel for each pair."""
    _trouble("depth")
    assert len(cameras) >= len(disparities) == len(rectifications)
    row = np.array([[float(d.left[0, 0]) for d in disparities.values()]], np.float32)
    return DepthMap(row, row, row, row, row.astype(np.uint32), tuple(cameras), row > 0)


def fuse(
    frames: Mapping[str, Frame],
    cameras: Mapping[str, Camera],
    depths: Mapping[str, DepthMap],
    refined: Mapping[str, DepthMap],
    *,
    component: int = 0,
    voxel_m: float | None = None,
) -> Cloud | Rejected:
    """A point for each pair and each of its two cameras."""
    _trouble("fuse")
    numbers = np.concatenate([d.depth[0] for d in depths.values()])
    points = np.array([[number, float(i), len(frames)] for i, number in enumerate(numbers)], np.float64)
    n = len(points)
    colors = np.full((n, 3), 128, np.uint8)
    ones = np.ones(n, np.float32)
    return Cloud(points, np.tile(np.array([0, 0, 1], np.float32), (n, 1)), colors, ones, np.full(n, 2, np.uint16), ones)


def find_changes(
    poses: Poses,
    cloud: Cloud,
    frames: Mapping[str, Frame],
    reference_cloud: Cloud | None,
    previous: Changes | None,
    used_ids: UsedIds | None,
) -> Changes:
    """The things that a capture lists, such as "van 5, stack -3": a name, which is its zone, and a volume, negative if it has
    vanished.  A thing keeps the id that it has in `previous`; "van ?" is carried on without being seen."""
    _trouble("changes")
    number = max(previous.highest_id if previous else 0, used_ids.highest if used_ids else 0)
    known = {change.zone: change for change in previous.changes.values()} if previous else {}
    listed = ",".join(frame.notes[2] for frame in frames.values() if len(frame.notes) > 2)
    changes: dict[str, Change] = {}
    for name, text in (thing.split() for thing in listed.split(",") if thing):
        if text == "?":
            changes[known[name].id] = dataclasses.replace(known[name], seen=False)
            continue
        if name not in known:
            number += 1
        volume = float(text)
        change = Change(
            "new" if volume > 0 else "vanished",
            x=float(len(name)),
            y=15.3,
            z=1.3,
            length=2.0,
            width=1.4,
            height=2.6,
            volume=abs(volume),
            volume_least=abs(volume) - 1,
            volume_most=abs(volume) + 1,
            zone=name,
            id=known[name].id if name in known else f"C{number}",
            nights=known[name].nights + 1 if name in known else 1,
        )
        changes[change.id] = change
    nothing = np.zeros(0, np.float32)
    return Changes(
        reference_cloud is not None,
        changes if reference_cloud is not None else {},
        points=np.zeros((0, 3)),
        colors=np.zeros((0, 3), np.uint8),
        distance=nothing,
        sigma=nothing,
        significance=nothing,
        label=np.zeros(0, np.uint8),
        blob=np.zeros(0, np.uint16),
        grid=GroundGrid(np.eye(3), 0.0, 0.0, 1.0, 0, 0),
        difference=np.zeros((0, 0), np.float32),
        before={name: np.full((8, 16, 3), 99, np.uint8) for name in changes},
        after={name: np.full((8, 16, 3), 199, np.uint8) for name in changes},
        count=len(changes),
        highest_id=number,
    )


def _filled(kind: Any, **fields: Any) -> Any:
    """A dataclass with 0, or what is like it, in every field that is neither given nor has a default."""
    nothing = {"int": 0, "float": 0.0, "bool": False, "str": "", "Float32s": np.zeros(0, np.float32)}
    missing = [f for f in dataclasses.fields(kind) if f.default is MISSING and f.default_factory is MISSING]
    return kind(**{f.name: nothing[str(f.type)] for f in missing if f.name not in fields}, **fields)


def _trouble(stage: str) -> None:
    if "TOY_FAULTS" not in os.environ:
        return
    faults = Path(os.environ["TOY_FAULTS"])
    if (slow := faults / "slow").exists():
        (faults / f"slow-{os.getpid()}").touch()
        time.sleep(float(slow.read_text()))
    for name in ("die", "once"):
        file = faults / name
        try:
            if file.read_text() != stage:
                continue
            if name == "once":
                file.unlink()
        except FileNotFoundError:  # there is none, or another worker has removed it
            continue
        os.kill(os.getpid(), signal.SIGKILL)
