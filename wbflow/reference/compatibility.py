"""Does the reference still fit the site file as it is now, and if not, by how much have lenses and poses changed?"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import TYPE_CHECKING, Any

from ..cache.store import Receipt
from ..pipeline.binding import Binding
from ..pipeline.stages import FRAMES, Adapt, Stage
from ..records.reference_folder import Reference
from ..runner.spec import Files, Joined, Value, input_digests, site_input, site_inputs
from ..site.calibration.calibrated import Lens, product
from ..site.captures import file_of_stage
from ..site.models import Site
from ..task import camera_of

if TYPE_CHECKING:
    from ..runner.planner import Plan

_COMPARED = {"lens", "placement", "survey"}


def incompatibility(reference: Reference, plan: Plan) -> str:
    """Return why the reference can no longer be used after changes of the site file, as text; "" if it can.

    Code may change: a reference survives a new version.  The site file's entries for cameras, and for the stages whose results
    are reused from the reference, may not.  plan: the plan of the site as it is now.
    """
    site = plan.site
    ids = {camera.id for camera in site.cameras}
    if differing := sorted(ids ^ set(reference.cameras)):
        return f"cameras have come or gone since it was pinned: {', '.join(differing)}"
    for stage in plan.stages:
        if not (stage.reuse.shifted or stage.name == FRAMES):
            continue
        binding = plan.binding(stage)
        names = [name for name, need in binding.inputs.items() if need.kind == "file"]
        files = {name: plan.named_files.get(file_of_stage(stage.name, name)) for name in names}
        tasks = [task for task in reference.artifacts if task.stage == stage.name]
        for task in tasks if stage.scope == "camera" else tasks[:1]:
            receipt = plan.cache.by_key(task, reference.artifacts[task].key)
            if receipt and (change := _settings_change(receipt, stage, site, binding, plan.settings(stage, task))):
                return f"it was pinned with other settings: {change}"
            for name, file in files.items():
                if receipt and file and receipt.preimage.inputs.get(name) != Files((file,)).digest():
                    return f"it was pinned with another {name} in {stage.name}"
    return ""


def _settings_change(receipt: Receipt, stage: Stage, site: Site, binding: Binding, settings: Mapping[str, Any]) -> str:
    pinned, task = receipt.preimage, receipt.preimage.task
    if any(isinstance(rule, Adapt) and rule.function == pinned.function for rule in (stage.reuse.shifted, stage.reuse.moved)):
        return ""  # it was derived from the result of an earlier reference
    if pinned.function not in {binding.function.dotted, stage.reuse.aggregate}:
        return f"{stage.name}: function {pinned.function} → {binding.function.dotted}"
    current = {**binding.defaults(), **settings}
    for name, value in current.items():
        is_new = name not in pinned.parameters
        if (is_new and name in settings) or (not is_new and json.dumps(value) != json.dumps(pinned.parameters[name])):
            return f"parameter {stage.name}.{name} {pinned.parameters.get(name)} → {value}"
    for name, need in binding.inputs.items():
        if need.kind == "site" and need.name in _COMPARED:
            site_value: Value | Joined
            if need.of == "every" or need.name == "survey":
                site_value = site_inputs(site, need.name)
            elif view := next((view for view in site.views if view.id == task.subject[0]), None):
                site_value = site_input(view, need.name)
            else:
                return f"the views of camera {camera_of(task.subject[0])}"
            for entry, digest in input_digests({name: site_value}).items():
                if pinned.inputs.get(entry) != digest:
                    return f"what the site file says of {entry}"
    return ""


LEAST_FOCAL = 0.005
"""A focal length counts as changed if it differs by more than this share."""
LEAST_BORDER = 0.001
"""Distortion counts as changed if it moves the corner of the image by more than this share of the image width."""
LEAST_DEG, LEAST_DISTANCE = 0.5, 0.02
"""Poses count as changed if two cameras' relative rotation (degrees) or distance (share of the mean distance) changes by more."""


def calibration_change(pinned: Mapping[str, Mapping[str, Any]], site: Site) -> str:
    """Return which lenses and poses have changed, as text; "" if none have.  pinned: cameras by id, as in cameras.json.

    Relative poses are compared, so that the coordinate system and scale of the pinned world do not matter.  Poses that are stated
    with standard deviations were refined by the pinned run, and are not compared.
    """
    lenses = {c.id: (c.lens, pinned[c.id]) for c in site.cameras if c.lens.K is not None and pinned.get(c.id, {}).get("K")}
    focals = {name: share for name, (lens, old) in lenses.items() if abs(share := _focal_change(lens, old)) > LEAST_FOCAL}
    borders = {name: share for name, (lens, old) in lenses.items() if (share := _corner_shift(lens, old)) > LEAST_BORDER}
    texts = []
    if focals:
        least, most = 100 * min(focals.values()), 100 * max(focals.values())
        amount = f"{most:+.1f} %" if most - least < 0.1 else f"{least:+.1f} to {most:+.1f} %"
        texts.append(f"focal lengths of {_names_of(focals, site)} by {amount}")
    if borders:
        note = " (there is none any more)" if not any(any(lenses[name][0].distortion) for name in borders) else ""
        texts.append(f"distortion of {_names_of(borders, site)} by up to {100 * max(borders.values()):.1f} % of the width{note}")
    exact = {c.id: c.placement for c in site.cameras if max(c.placement.sigma_m, c.placement.sigma_deg) == 0}
    posed = {name: place for name, place in exact.items() if place.R and place.C and pinned.get(name, {}).get("R")}
    old_poses = {name: (pinned[name]["R"], pinned[name]["C"]) for name in posed}
    turn, shift = _pose_change(old_poses, {name: (place.R, place.C) for name, place in posed.items()})
    if turn > LEAST_DEG or shift > LEAST_DISTANCE:
        texts.append(f"poses by up to {turn:.1f} degrees and {100 * shift:.1f} % of the distance between cameras")
    return "; ".join(texts)


def _names_of(cameras: Mapping[str, float], site: Site) -> str:
    return "all cameras" if len(cameras) == len(site.cameras) else ", ".join(cameras)


def _focal_change(lens: Lens, old: Mapping[str, Any]) -> float:
    assert lens.K is not None
    width, old_width = lens.width or old["width"], old["width"]
    return float(lens.K[0][0]) / width / (float(old["K"][0][0]) / float(old_width)) - 1


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


def _pose_change(old_poses: Mapping[str, Any], new_poses: Mapping[str, Any]) -> tuple[float, float]:
    """Return the largest changes among pairs of cameras: of the relative rotation, degrees; of the distance over the mean one."""
    pairs = list(combinations(new_poses, 2))
    if not pairs:
        return 0.0, 0.0
    rotations = [[product(poses[b][0], [*zip(*poses[a][0], strict=True)]) for a, b in pairs] for poses in (old_poses, new_poses)]
    turn = max(map(_angle_between, *rotations))
    lengths = [[math.dist(poses[a][1], poses[b][1]) for a, b in pairs] for poses in (old_poses, new_poses)]
    means = [sum(distances) / len(distances) or 1.0 for distances in lengths]
    change = max(abs(new / means[1] - old / means[0]) for old, new in zip(*lengths, strict=True)) if len(pairs) > 1 else 0.0
    return turn, change


def _angle_between(first: list[list[float]], second: list[list[float]]) -> float:
    """Return the angle between two rotations, degrees."""
    trace = sum(x * y for row_a, row_b in zip(first, second, strict=True) for x, y in zip(row_a, row_b, strict=True))
    return math.degrees(math.acos(max(-1.0, min(1.0, (trace - 1) / 2))))
