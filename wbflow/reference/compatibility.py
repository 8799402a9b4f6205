"""Is the reference one of the site as its file describes it now?"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from ..cache.store import Receipt
from ..pipeline.binding import Binding
from ..pipeline.stages import FRAMES, Adapt, Stage
from ..records.reference_folder import Reference
from ..runner.spec import Files, Joined, Value, input_digests, stated, stated_of_site
from ..site.captures import file_of_stage
from ..site.models import Site
from ..task import camera_of

if TYPE_CHECKING:
    from ..runner.planner import Plan

_COMPARED = {"lens", "placement", "survey"}


def misfit(reference: Reference, plan: Plan) -> str:
    """What has changed since the reference was pinned that takes it out of use, in words; "" where nothing has.

    Code may change: a reference outlives a new version.  What the site file says of cameras, and of the stages whose results the
    reference answers for, may not.  plan: of the site as it is now.
    """
    site = plan.site
    ids = {camera.id for camera in site.cameras}
    if other := sorted(ids ^ set(reference.cameras)):
        return f"cameras have come or gone since it was pinned: {', '.join(other)}"
    for stage in plan.stages():
        if not (stage.reuse.shifted or stage.name == FRAMES):
            continue
        bound = plan.bound(stage)
        files = {
            name: plan.named.get(file_of_stage(stage.name, name)) for name, need in bound.inputs.items() if need.kind == "file"
        }
        tasks = [task for task in reference.artifacts if task.stage == stage.name]
        for task in tasks if stage.scope == "camera" else tasks[:1]:
            receipt = plan.cache.by_key(task, reference.artifacts[task].key)
            if receipt and (why := _changed(receipt, stage, site, bound, plan.settings(stage, task))):
                return f"it was pinned with other settings: {why}"
            for name, file in files.items():
                if receipt and file and receipt.preimage.inputs.get(name) != Files("", (file,)).digest():
                    return f"it was pinned with another {name} in {stage.name}"
    return ""


def _changed(receipt: Receipt, stage: Stage, site: Site, bound: Binding, settings: Mapping[str, Any]) -> str:
    then, task = receipt.preimage, receipt.preimage.task
    if any(isinstance(how, Adapt) and how.function == then.function for how in (stage.reuse.shifted, stage.reuse.moved)):
        return ""  # it was made from the result of an earlier reference
    if then.function not in {bound.function.dotted, stage.reuse.aggregate}:
        return f"{stage.name}: function {then.function} → {bound.function.dotted}"
    now = {**bound.defaults(), **settings}
    for name, value in now.items():
        new = name not in then.parameters
        if (new and name in settings) or (not new and json.dumps(value) != json.dumps(then.parameters[name])):
            return f"parameter {stage.name}.{name} {then.parameters.get(name)} → {value}"
    for name, need in bound.inputs.items():
        if need.kind == "site" and need.name in _COMPARED:
            said: Value | Joined
            if need.of == "every" or need.name == "survey":
                said = stated_of_site(site, need.name)
            elif view := next((view for view in site.views if view.id == task.subject[0]), None):
                said = stated(view, need.name)
            else:
                return f"the views of camera {camera_of(task.subject[0])}"
            for entry, digest in input_digests({name: said}).items():
                if then.inputs.get(entry) != digest:
                    return f"what the site file says of {entry}"
    return ""
