"""Does the reference still fit the site file as it is now, and if not, by how much have lenses and poses changed?"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from typing import Any

from ..cache.receipt import Receipt
from ..pipeline.stages import FRAMES, Adapt, Stage
from ..records.reference import Reference
from ..runner.night import Night
from ..runner.spec import Files, input_digests, site_input
from ..site.calibration.calibrated import Lens
from ..site.captures import file_of_stage
from ..site.models import Site
from ..task import camera_of

_COMPARED = {"lens", "placement", "survey"}


def incompatibility(reference: Reference, night: Night) -> str:
    """Return why the reference can no longer be used after changes of the site file, as text; "" if it can.

    Code may change: a reference survives a new version.  The site file's entries for cameras, and for the stages whose results
    are reused from the reference, may not.  night: one of the site as it is now.
    """
    ids = {camera.id for camera in night.site.cameras}
    if differing := sorted(ids ^ set(reference.cameras)):
        return f"cameras have come or gone since it was pinned: {', '.join(differing)}"
    for stage in night.stages:
        if not (stage.reuse.shifted or stage.name == FRAMES):
            continue
        tasks = [task for task in reference.artifacts if task.stage == stage.name]
        for task in tasks if stage.scope == "camera" else tasks[:1]:
            receipt = night.cache.by_key(task, reference.artifacts[task].key)
            if receipt and (change := _change_since(receipt, stage, night)):
                return f"it was pinned with {change}"
    return ""


def _change_since(receipt: Receipt, stage: Stage, night: Night) -> str:
    """What a result of the reference was made with, if the site file has changed that: a function, parameter or input."""
    pinned = receipt.preimage
    binding = night.bindings.of(stage)
    if any(isinstance(rule, Adapt) and rule.function == pinned.function for rule in (stage.reuse.shifted, stage.reuse.moved)):
        return ""  # it was derived from the result of an earlier reference
    if pinned.function not in {binding.function.dotted, stage.reuse.aggregate}:
        return f"other settings: {stage.name}: function {pinned.function} → {binding.function.dotted}"
    stated = night.bindings.stated(stage)
    for name, value in {**binding.defaults(), **stated}.items():
        is_new = name not in pinned.parameters
        # a new parameter with its default changes nothing
        if (is_new and name in stated) or (not is_new and json.dumps(value) != json.dumps(pinned.parameters[name])):
            return f"other settings: parameter {stage.name}.{name} {pinned.parameters.get(name)} → {value}"
    for name, need in binding.inputs.items():
        if need.kind == "file":
            file = night.files.named.get(file_of_stage(stage.name, name))
            if file and pinned.inputs.get(name) != Files((file,)).digest:
                return f"another {name} in {stage.name}"
        elif need.kind == "site" and need.name in _COMPARED:
            value = site_input(night.site, need, pinned.task)
            if value is None:
                return f"other settings: the views of camera {camera_of(pinned.subject[0])}"
            for entry, digest in input_digests({name: value}).items():
                if pinned.inputs.get(entry) != digest:
                    return f"other settings: what the site file says of {entry}"
    return ""


LEAST_FOCAL = 0.005
"""A focal length counts as changed if it differs by more than this share."""
LEAST_BORDER = 0.001
"""Distortion counts as changed if it moves the corner of the image by more than this share of the image width."""
LEAST_DEG, LEAST_DISTANCE = 0.5, 0.02
"""Poses count as changed if two cameras' relative rotation (degrees) or distance (share of the mean distance) changes by more."""


Lenses = Mapping[str, tuple[Lens, Mapping[str, Any]]]
"""By camera: its lens in the site file, and the pinned camera as in cameras.json."""


def calibration_change(pinned: Mapping[str, Mapping[str, Any]], site: Site) -> str:
    """Return which lenses and poses have changed, as text; "" if none have.  pinned: cameras by id, as in cameras.json.

    Relative poses are compared, so that the coordinate system and scale of the pinned world do not matter.  Poses that are stated
    with standard deviations were refined by the pinned run, and are not compared.
    """
    lenses = {c.id: (c.lens, pinned[c.id]) for c in site.cameras if c.lens.K is not None and pinned.get(c.id, {}).get("K")}
    exact = {c.id: c.placement for c in site.cameras if max(c.placement.sigma_m, c.placement.sigma_deg) == 0}
    posed = {name: place for name, place in exact.items() if place.R and place.C and pinned.get(name, {}).get("R")}
    old_poses = [(pinned[name]["R"], pinned[name]["C"]) for name in posed]
    new_poses = [(place.R, place.C) for place in posed.values()]
    texts = [_focal_changes(lenses, site), _distortion_changes(lenses, site), _pose_changes(old_poses, new_poses)]
    return "; ".join(filter(None, texts))


def _names_of(cameras: Mapping[str, float], site: Site) -> str:
    return "all cameras" if len(cameras) == len(site.cameras) else ", ".join(cameras)


def _focal_changes(lenses: Lenses, site: Site) -> str:
    percents: dict[str, float] = {}
    for name, (lens, old) in lenses.items():
        assert lens.K is not None
        width, old_width = lens.width or old["width"], old["width"]
        change = float(lens.K[0][0]) / width / (float(old["K"][0][0]) / float(old_width)) - 1
        if abs(change) > LEAST_FOCAL:
            percents[name] = 100 * change
    if not percents:
        return ""
    least, most = min(percents.values()), max(percents.values())
    amount = f"{most:+.1f} %" if most - least < 0.1 else f"{least:+.1f} to {most:+.1f} %"
    return f"focal lengths of {_names_of(percents, site)} by {amount}"


def _distortion_changes(lenses: Lenses, site: Site) -> str:
    shifts = {name: _corner_shift(lens, old) for name, (lens, old) in lenses.items()}
    changes = {name: shift for name, shift in shifts.items() if shift > LEAST_BORDER}
    if not changes:
        return ""
    note = "" if any(any(lenses[name][0].distortion) for name in changes) else " (there is none any more)"
    return f"distortion of {_names_of(changes, site)} by up to {100 * max(changes.values()):.1f} % of the width{note}"


def _corner_shift(lens: Lens, old: Mapping[str, Any]) -> float:
    """Return how far the image corner moves, as a share of the width; 1 if the model or a non-Brown coefficient differs."""
    K, width, height = old["K"], float(old["width"]), float(old["height"])
    if lens.model != str(old.get("model") or "brown"):
        return 1.0
    if lens.model != "brown":
        return float(list(lens.distortion) != list(old.get("distortion") or lens.distortion))
    radius = math.hypot(width, height) / 2 / float(K[0][0])
    shift = _radial_shift(lens.distortion, radius) - _radial_shift(old.get("distortion") or (), radius)
    return abs(shift) * float(K[0][0]) / width


def _radial_shift(distortion: Sequence[float], radius: float) -> float:
    """Return the shift of a ray at a radius by the radial terms of k1 k2 p1 p2 k3, in units of the focal length."""
    k1, k2, _, _, k3 = [*distortion, 0.0, 0.0, 0.0, 0.0, 0.0][:5]
    return radius**3 * (k1 + radius**2 * (k2 + radius**2 * k3))


def _pose_changes(old_poses: list[Any], new_poses: list[Any]) -> str:
    """The largest changes among all pairs of cameras, as text.  Poses: (R, C) of each camera."""
    import numpy as np

    if len(new_poses) < 2:
        return ""
    first, second = np.triu_indices(len(new_poses), 1)
    rotations, distances = [], []
    for poses in (old_poses, new_poses):
        R, C = (np.array(values, dtype=float) for values in zip(*poses, strict=True))
        rotations.append(R[second] @ R[first].transpose(0, 2, 1))
        lengths = np.linalg.norm(C[second] - C[first], axis=1)
        distances.append(lengths / (lengths.mean() or 1.0))
    cosines = (np.sum(rotations[0] * rotations[1], axis=(1, 2)) - 1) / 2
    turn = np.degrees(np.arccos(np.clip(cosines, -1, 1))).max()
    shift = abs(distances[1] - distances[0]).max() if len(first) > 1 else 0.0
    if turn <= LEAST_DEG and shift <= LEAST_DISTANCE:
        return ""
    return f"poses by up to {turn:.1f} degrees and {100 * shift:.1f} % of the distance between cameras"
