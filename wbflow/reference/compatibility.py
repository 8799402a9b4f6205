"""Does the reference still fit the site file as it is now, and if not, by how much have lenses and poses changed?"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from typing import Any

from ..cache.receipt import Preimage, Receipt
from ..pipeline.stages import FRAMES, OBSERVED, Adapt, Stage
from ..records.reference import Reference
from ..runner.night import Night
from ..runner.spec import Files, input_digests, site_input
from ..site.calibration.calibrated import Lens
from ..site.captures import file_of_stage
from ..site.models import Site
from ..task import camera_of

_COMPARED = {"lens", "placement", "survey", "observations", "thing_survey"}
"""The site file's entries for a camera that its results rest on."""


def incompatibility(reference: Reference, night: Night) -> str:
    """Return why the reference can no longer be used after changes of the site file, as text; "" if it can.

    Code may change: a reference survives a new version.  The site file's entries for cameras, and for the stages whose results
    are reused from the reference, may not.  night: one of the site as it is now.
    """
    ids = {camera.id for camera in night.site.cameras}
    differing = sorted(ids ^ set(reference.cameras))
    if differing:
        return f"cameras have come or gone since it was pinned: {', '.join(differing)}"
    for stage in night.stages:
        # these have no rule of reuse, but all else rests on the lenses of frames, and on the poses of observed cameras
        if stage.name not in {FRAMES, OBSERVED} and not stage.reuse.shifted:
            continue
        tasks = [task for task in reference.artifacts if task.stage == stage.name]
        # settings are the same for all pairs; cameras have entries of their own in the site file
        if stage.scope != "camera":
            tasks = tasks[:1]
        for task in tasks:
            receipt = night.cache.by_key(task, reference.artifacts[task].key)
            change = _change_since(receipt, stage, night) if receipt else ""
            if change:
                return f"it was pinned with {change}"
    return ""


def _change_since(receipt: Receipt, stage: Stage, night: Night) -> str:
    """What a result of the reference was made with, if the site file has changed that: a function, parameter or input."""
    pinned = receipt.preimage
    for rule in (stage.reuse.shifted, stage.reuse.moved):
        if isinstance(rule, Adapt) and rule.function == pinned.function:
            return ""  # it was derived from the result of an earlier reference
    function = night.site.bindings.of(stage).function.dotted
    if pinned.function not in {function, stage.reuse.aggregate}:
        return f"other settings: {stage.name}: function {pinned.function} → {function}"
    return _parameter_change(pinned, stage, night) or _input_change(pinned, stage, night)


def _parameter_change(pinned: Preimage, stage: Stage, night: Night) -> str:
    """The first parameter whose value has changed, as text; "" if none has."""
    stated = night.site.stated(stage)
    for name, value in {**night.site.bindings.of(stage).defaults(), **stated}.items():
        if name in pinned.parameters:
            # as JSON: a receipt has lists where the site file has tuples
            changed = json.dumps(value) != json.dumps(pinned.parameters[name])
        else:
            # a parameter that a later version brought changes nothing until it is stated
            changed = name in stated
        if changed:
            return f"other settings: parameter {stage.name}.{name} {pinned.parameters.get(name)} → {value}"
    return ""


def _input_change(pinned: Preimage, stage: Stage, night: Night) -> str:
    """The first input whose content has changed, as text; "" if none has.  Only files and entries for cameras are compared."""
    for name, need in night.site.bindings.of(stage).inputs.items():
        if need.kind == "file":
            file = night.files.named.get(file_of_stage(stage.name, name))
            if file and pinned.inputs.get(name) != Files((file,)).digest:
                return f"another {name} in {stage.name}"
        elif need.kind == "site" and need.name in _COMPARED:
            value = site_input(night.site, need, pinned.task)
            if value is None and pinned.task.subject:
                return f"other settings: the views of camera {camera_of(pinned.subject[0])}"
            for entry, digest in input_digests({name: value}).items():
                if pinned.inputs.get(entry) != digest:
                    return f"other settings: what the site file says of {entry}"
    return ""


LEAST_FOCAL = 0.005
"""A focal length counts as changed if it differs by more than this share."""
LEAST_BORDER = 0.001
"""Distortion counts as changed if it moves the corner of the image by more than this share of the image width."""
LEAST_TURN = 0.5
"""Poses count as changed if the relative rotation of two cameras changes by more than this, in degrees."""
LEAST_SHIFT = 0.02
"""Poses count as changed if the distance of two cameras changes by more than this share of the mean distance."""


Lenses = Mapping[str, tuple[Lens, Mapping[str, Any]]]
"""By camera: its lens in the site file, and the pinned camera as in cameras.json."""


def calibration_change(pinned: Mapping[str, Mapping[str, Any]], site: Site) -> str:
    """Return which lenses and poses have changed, as text; "" if none have.  pinned: cameras by id, as in cameras.json.

    Relative poses are compared, so that the coordinate system and scale of the pinned world do not matter.  Poses that are stated
    with standard deviations were refined by the pinned run, and are not compared.
    """
    lenses: dict[str, tuple[Lens, Mapping[str, Any]]] = {}
    old_poses = []
    new_poses = []
    for camera in site.cameras:
        old = pinned.get(camera.id, {})
        if camera.lens.K is not None and old.get("K"):
            lenses[camera.id] = (camera.lens, old)
        place = camera.placement
        is_exact = max(place.sigma_m, place.sigma_deg) == 0
        if is_exact and place.R and place.C and old.get("R"):
            old_poses.append((old["R"], old["C"]))
            new_poses.append((place.R, place.C))
    texts = [_focal_changes(lenses, site), _distortion_changes(lenses, site), _pose_changes(old_poses, new_poses)]
    return "; ".join(filter(None, texts))


def _focal_changes(lenses: Lenses, site: Site) -> str:
    """The focal lengths that have changed, as text; "" if none has.  They are compared in image widths."""
    percents: dict[str, float] = {}
    for name, (lens, old) in lenses.items():
        assert lens.K is not None
        old_width = old["width"]
        width = lens.width or old_width
        change = float(lens.K[0][0]) / width / (float(old["K"][0][0]) / float(old_width)) - 1
        if abs(change) > LEAST_FOCAL:
            percents[name] = 100 * change
    if not percents:
        return ""
    least = min(percents.values())
    most = max(percents.values())
    if most - least < 0.1:  # the same once rounded
        amount = f"{most:+.1f} %"
    else:
        amount = f"{least:+.1f} to {most:+.1f} %"
    return f"focal lengths of {_names_of(percents, site)} by {amount}"


def _distortion_changes(lenses: Lenses, site: Site) -> str:
    """The lenses whose distortion has changed, as text; "" if none has."""
    shifts: dict[str, float] = {}
    is_stated = False
    for name, (lens, old) in lenses.items():
        shift = _corner_shift(lens, old)
        if shift > LEAST_BORDER:
            shifts[name] = shift
            is_stated = is_stated or any(lens.distortion)
    if not shifts:
        return ""
    note = "" if is_stated else " (there is none any more)"
    return f"distortion of {_names_of(shifts, site)} by up to {100 * max(shifts.values()):.1f} % of the width{note}"


def _names_of(cameras: Mapping[str, float], site: Site) -> str:
    return "all cameras" if len(cameras) == len(site.cameras) else ", ".join(cameras)


def _corner_shift(lens: Lens, old: Mapping[str, Any]) -> float:
    """Return how far the image corner moves, as a share of the width; 1 if the model or a non-Brown coefficient differs."""
    if lens.model != str(old.get("model") or "brown"):
        return 1.0
    if lens.model != "brown":
        return float(list(lens.distortion) != list(old.get("distortion") or lens.distortion))
    focal = float(old["K"][0][0])
    width = float(old["width"])
    radius = math.hypot(width, float(old["height"])) / 2 / focal
    shift = _radial_shift(lens.distortion, radius) - _radial_shift(old.get("distortion") or (), radius)
    return abs(shift) * focal / width


def _radial_shift(distortion: Sequence[float], radius: float) -> float:
    """Return the shift of a ray at a radius by the radial terms of k1 k2 p1 p2 k3, in units of the focal length."""
    k1, k2, _, _, k3 = [*distortion, 0.0, 0.0, 0.0, 0.0, 0.0][:5]
    return radius**3 * (k1 + radius**2 * (k2 + radius**2 * k3))


def _pose_changes(old_poses: list[Any], new_poses: list[Any]) -> str:
    """The largest changes among all pairs of cameras, as text.  Poses: (R, C) of each camera."""
    import numpy as np

    if len(new_poses) < 2:
        return ""
    first, second = np.triu_indices(len(new_poses), 1)  # every pair of cameras once: (P,), (P,)
    rotations = []
    distances = []
    for poses in (old_poses, new_poses):
        R = np.array([R for R, _ in poses], dtype=float)
        C = np.array([C for _, C in poses], dtype=float)
        rotations.append(R[second] @ R[first].transpose(0, 2, 1))  # (P, 3, 3)
        lengths = np.linalg.norm(C[second] - C[first], axis=1)
        distances.append(lengths / (lengths.mean() or 1.0))  # (P,)
    # the angle of a rotation from its trace: tr(A^T B) = 1 + 2 cos
    cosines = (np.sum(rotations[0] * rotations[1], axis=(1, 2)) - 1) / 2
    turn = np.degrees(np.arccos(np.clip(cosines, -1, 1))).max()
    shift = 0.0  # a single distance is its own unit
    if len(first) > 1:
        shift = abs(distances[1] - distances[0]).max()
    if turn <= LEAST_TURN and shift <= LEAST_SHIFT:
        return ""
    return f"poses by up to {turn:.1f} degrees and {100 * shift:.1f} % of the distance between cameras"
