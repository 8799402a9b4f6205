"""A site examined without running anything: what is wrong with it, its captures and this machine; what would run, and why."""

from __future__ import annotations

import datetime
import difflib
import importlib
import re
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

from ..cache.atomic import free_bytes
from ..cache.fingerprint import load
from ..cache.layout import WorkFolder
from ..cache.store import Preimage, Receipt
from ..cache.untrusted import read_outside
from ..errors import ExitCode, printable
from ..pipeline.stages import PAIRS, SITE_TYPES, stage_named
from ..records.run_folder import NoSuchRun, RunFolder
from ..runner.context import RunContext, plan_run
from ..runner.options import Options
from ..runner.planner import Plan
from ..runner.spec import TaskSpec
from ..site.captures import CaptureFile, expected
from ..site.models import Camera, Site
from ..task import Task

Severity = Literal["error", "warning"]

DEBIAN_PACKAGES = {
    "libusb-1.0.so.0": "libusb-1.0-0",
    "libGL.so.1": "libgl1",
    "libEGL.so.1": "libegl1",
    "libX11.so.6": "libx11-6",
    "libudev.so.1": "libudev1",
    "libgomp.so.1": "libgomp1",
}
"""Shared libraries that open3d needs and the Debian packages that hold them."""

BYTES_PER_PIXEL = 40
"""Disk that a night takes in the cache, for each pixel of each camera at working resolution (measured, generous)."""


@dataclass(frozen=True)
class Finding:
    """One thing found."""

    severity: Severity
    what: str
    """Where, and what."""
    remedy: str
    code: ExitCode
    """What a run would end with for it."""


def check(site: Site, date: datetime.date | None) -> list[Finding]:
    """Everything that would spoil a run, or part of one."""
    machine = check_machine()
    if any(finding.severity == "error" for finding in machine):
        return machine + _disk(site)
    return [*check_captures(site, plan_run(site, Options(date))), *machine, *_disk(site), *check_published(site.work_folder)]


def exit_code(findings: Iterable[Finding]) -> ExitCode:
    """What `wbflow check` ends with: the worst that a run would."""
    return min((finding.code for finding in findings if finding.severity == "error"), default=ExitCode.GOOD)


def check_captures(site: Site, context: RunContext) -> list[Finding]:
    """Is every capture there, whole, and of the size that its intrinsics are for?"""
    found = []
    if len(site.cameras) < 2:
        what = f"{site.file}: {len(site.cameras)} camera: a cloud needs two or more that see the same things"
        found.append(Finding("error", what, "list the others under cameras:", ExitCode.FAILED))
    for camera in site.cameras:
        place = site.document.problem(camera.location, "")
        where = f"{site.file}:{place.line}:{place.column}: camera {camera.id}"
        files = context.plan.captures[camera.id]
        if not files:
            what = f"{where}: there is no capture {expected(site, camera, context.date)}"
            found.append(Finding("error", what, _remedy_of_missing(site, camera), ExitCode.DEGRADED))
        for file in files:
            size, problem = _look_at(file)
            stated = (camera.lens.width, camera.lens.height)
            if problem:
                found.append(Finding("error", f"{where}: {problem}", "the other cameras go on without it", ExitCode.DEGRADED))
            elif stated[0] and size != stated:
                what = f"{where}: {file.name} is {size[0]}x{size[1]}, its intrinsics are for {stated[0]}x{stated[1]}"
                found.append(Finding("error", what, "calibrate for this size, or correct width and height", ExitCode.DEGRADED))
    return found


def _remedy_of_missing(site: Site, camera: Camera) -> str:
    """What to do about a camera without captures: its name may be written otherwise than the files'."""
    there = site.captures.cameras() - {other.id for other in site.cameras} if camera.images is None else set()
    close = difflib.get_close_matches(camera.id, there, 1)
    if close:
        return f"did you mean {printable(close[0])!r}? There are captures of it"
    return "check captures.root and pattern, or the camera itself"


def _look_at(file: CaptureFile) -> tuple[tuple[int, int], str | None]:
    """(width, height) of a capture as it would be used, or what is wrong with it."""
    import numpy as np

    if not file.digest:
        return (0, 0), f"{file.name} {file.fault}"
    try:
        capture = load(SITE_TYPES["captures"])(file.name, np.frombuffer(read_outside(file.path), dtype=np.uint8))
        image = load("wbflow_stages.capture.video:one_picture")(capture)
    except (ValueError, OSError) as error:
        return (0, 0), str(error)
    return (image.shape[1], image.shape[0]), None


def check_machine() -> list[Finding]:
    """Can every library be imported?"""
    found = []
    for name in ("numpy", "cv2", "scipy", "numba", "networkx", "poselib", "open3d"):
        try:
            importlib.import_module(name)
        except (ImportError, OSError) as error:
            found.append(Finding("error", f"{name} cannot be imported: {error}", _remedy(str(error)), ExitCode.FAILED))
    return found


def _remedy(message: str) -> str:
    library = re.search(r"lib[\w.+-]+\.so[.\d]*", message)
    package = DEBIAN_PACKAGES.get(library.group(0)) if library else None
    return (
        f"as root: apt-get install {package}" if package else "reinstall wbflow: python -m pip install --force-reinstall wbflow"
    )


def check_published(work: WorkFolder) -> list[Finding]:
    """Are the files of every run as they were published?  Those of runs that links show must be there, too."""
    shown = {work.led_to(link) for link in work.links()}
    found = []
    for name in work.run_ids():
        remedy = f"the next  wbflow run  publishes intact ones; do not use those of {name}"
        try:
            for path in RunFolder.of(work, name).damaged(missing=name in shown):
                what = "is damaged" if path.exists() else "is gone"
                found.append(Finding("error", f"{path} {what}", remedy, ExitCode.DEGRADED))
        except NoSuchRun as error:
            found.append(Finding("error", error.what, remedy, ExitCode.DEGRADED))
    return found


def _disk(site: Site) -> list[Finding]:
    free = free_bytes(site.work_folder.root)
    width = site.settings.resolution or 4000
    need = len(site.cameras) * width * width * 2 // 3 * BYTES_PER_PIXEL
    if free > need:
        return []
    what = f"{site.work_folder.root} has {free / 1e9:.1f} GB free; a night of this site takes about {need / 1e9:.1f} GB"
    return [Finding("warning", what, "free some space: wbflow clean SITE.yaml --keep 3", ExitCode.FAILED)]


_MOST_NAMED = 3
"""So many of the inputs that have changed are named."""


@dataclass(frozen=True)
class Line:
    """A task in the status of a site."""

    task: str
    state: str
    """Cached, rejected, failed, skipped, would run, or waits."""
    why: str
    seconds: float | None = None
    """CPU time that it will take, by its last run or by the others of its stage; None where it won't run, or nobody knows."""


@dataclass(frozen=True)
class Status:
    """What is cached and what would run."""

    site: str
    night: str
    tasks: tuple[Line, ...]
    """A line for every task that is known of, in the order of the pipeline."""
    totals: dict[str, int]
    """How many tasks are in each state."""
    cpu_seconds: float | None
    """CPU time of all that would run, as far as is known; None where nothing is."""
    pairs_to_come: bool
    """Pairs will be matched that are not listed yet, because the pair graph is not there."""


def explain(plan: Plan) -> Status:
    """Return what would become of each task of a plan, and why."""
    lines = {task: Line(str(task), state.outcome, state.reason or "") for task, state in plan.states.items()}
    costs: dict[str, list[float]] = {}
    for task, state in plan.states.items():
        if state.receipt:
            costs.setdefault(task.stage, []).append(state.receipt.cpu)
    whys = {task: _why(plan, spec) for task, spec in plan.ready.items()} | {task: _pending(plan, task) for task in plan.waiting}
    for task, why in whys.items():
        last, others = plan.cache.newest(task), costs.get(task.stage)
        seconds = last.cpu if last else sum(others) / len(others) if others else None
        lines[task] = Line(str(task), "would run", why, seconds)
    order = {stage.name: i for i, stage in enumerate(plan.stages)}
    ordered = tuple(lines[task] for task in sorted(lines, key=lambda t: order[t.stage]))
    known = [line.seconds for line in ordered if line.seconds is not None]
    pairs_to_come = not plan.pairs_known() and stage_named(PAIRS) in plan.stages
    totals = dict(Counter(line.state for line in ordered))
    return Status(plan.site.name, plan.night, ordered, totals, sum(known) if known else None, pairs_to_come)


def _why(plan: Plan, spec: TaskSpec) -> str:
    if spec.force:
        return "forced"
    last = plan.cache.newest(spec.task)
    if last is None:
        return "never run"
    return difference(last, spec.preimage()) or "its artifact is gone"


def _pending(plan: Plan, task: Task) -> str:
    """How much of a waiting task's input is to be made anew (the same bytes may come out of it: then the task is not run)."""
    if plan.cache.newest(task) is None:
        return "never run"
    upstreams = plan.upstreams(task)
    pending = sum(upstream not in plan.states for upstream in upstreams)
    if not pending:
        return "once the pair graph is known"
    return f"{pending} of {len(upstreams)} inputs will change" if pending > 1 else "an input may change"


def difference(last: Receipt, now: Preimage) -> str:
    """What changed since a receipt, in words."""
    before = last.preimage
    found = []
    if before.code != now.code:
        renamed = before.function != now.function
        found.append(f"function {before.function} → {now.function}" if renamed else "its code, or a library's version, changed")
    for name in sorted(before.parameters.keys() | now.parameters.keys()):
        old, new = before.parameters.get(name), now.parameters.get(name)
        if old != new:
            found.append(f"parameter {now.stage}.{name} {old} → {new}")
    changed = [
        name for name in sorted(before.inputs.keys() | now.inputs.keys()) if before.inputs.get(name) != now.inputs.get(name)
    ]
    if len(changed) == 1:
        found.append(f"input {changed[0]} changed")
    elif changed:
        named = ", ".join(changed[:_MOST_NAMED])
        more = ", ..." if len(changed) > _MOST_NAMED else ""
        found.append(f"{len(changed)} of {len(now.inputs)} inputs changed: {named}{more}")
    return "; ".join(found)
