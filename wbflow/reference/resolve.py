"""What tonight's run takes from the pinned reference: inputs, whole results, and each camera's state compared with it.

Results of the reference are reused as each stage's `Reuse` defines, depending on whether the cameras involved have moved; the
stage `health` finds that out for each camera.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence, Set
from dataclasses import dataclass, field
from functools import cached_property
from itertools import islice
from typing import TYPE_CHECKING, Any

from ..cache.layout import WorkFolder
from ..cache.store import Receipt
from ..pipeline.stages import FRAMES, HEALTH, STAGES, Adapt, Reuse, Source, Stage, ancestors, stage_named
from ..pipeline.summaries import HealthSummary
from ..records.findings import Health
from ..records.run_folder import last_of_nights, newest_runs
from ..runner.spec import Absent, Input, Joined, Part, Stored, Value, subject_of
from ..runner.state import Cause, Impossible, Waiting, blocked_by, summary_of
from ..task import Subject, Task, camera_of
from .restore import restore_to_cache

if TYPE_CHECKING:
    from ..runner.planner import Plan

_STILL, _TURNED, _LOST = "still", "turned", "lost"
"""A camera's pose is that of the reference, is derived from it, or is unknown."""
USELESS = frozenset({"obscured", "stale", "wrong-scene"})
"""States of a camera that shows nothing of the site tonight."""
FEWEST = 2
"""The reference is reused only if the poses of at least this many cameras are known from it."""

SHIFTS_TYPE = "wbflow_stages.types:Usual"
"""The type in which a stage gets the shifts of earlier nights; its fields are lists of one number per night, oldest first."""
SHIFTS = ("shift_x_px", "shift_y_px", "roll_deg")
"""Fields of `SHIFTS_TYPE`; the figures of a camera's health have the same names."""
MOST_NIGHTS = 14
MOST_RUNS = 3 * MOST_NIGHTS
"""Largest number of run records to read: a night may have several runs."""


def shift_history(work: WorkFolder, night: str, reference: str) -> dict[str, dict[str, list[float]]]:
    """By camera and field: its shifts on the nights that were compared with the same reference and measured them, oldest first.

    night: only older nights count, so that a repeated run finds the same history.  reference: id of the reference's run.
    """
    runs = islice(newest_runs(work, after=reference), MOST_RUNS)
    nights = last_of_nights((run for run in runs if run[1].date < night and run[1].reference == reference), MOST_NIGHTS)
    history: dict[str, dict[str, list[float]]] = {}
    for camera in (camera for record in nights for camera in record.cameras):
        figures = camera.health.figures if camera.health else {}
        for name in SHIFTS if all(name in figures for name in SHIFTS) else ():
            history.setdefault(camera.id, {}).setdefault(name, []).append(float(figures[name]))
    return history


@dataclass
class Resolver:
    """Decides what tonight's plan reuses of the reference."""

    plan: Plan
    """Tonight's plan; its states and its reference change during the run."""
    _healths: dict[str, HealthSummary] = field(default_factory=dict, repr=False)
    """Health by view, for the views that were examined tonight."""
    _useless: set[str] = field(default_factory=set, repr=False)
    """Views that are known to show nothing of the site tonight."""
    _own_frames: set[str] = field(default_factory=set, repr=False)
    """Views whose frame tonight is the reference's own (same cache key)."""
    _poses_suffice: bool | None = field(default=None, repr=False)
    """Are the poses of at least `FEWEST` cameras known from the reference?  None until the health of all is known."""

    def __post_init__(self) -> None:
        self.cameras = [view.id for view in self.plan.site.views]  # ids of all views
        self._forced = {name.split(" ")[0] for name in self.plan.force}
        """Stages with tasks that are forced to run again."""
        self._useless |= {view for view in self.cameras if (h := self.plan.stale.get(camera_of(view))) and h.state in USELESS}

    def input(self, need: Source, task: Task) -> Input:
        """An input from the reference; absent or empty without one, or if tonight's frames are the reference's own."""
        of_every = need.of == "every"
        if self.plan.reference is None or self._own_frames.issuperset(task.subject or self.cameras):
            return Joined({}) if of_every else Absent()
        origin = stage_named(need.name)
        if of_every and origin.scope != "site":
            tasks = [t for t in self.plan.reference.artifacts if t.stage == origin.name]
            stored = {t.subject: self._stored(need, t, False) for t in tasks}
            return Joined({subject: item for subject, item in stored.items() if isinstance(item, Stored)})
        whole_artifact = origin.scope != "site" or stage_named(task.stage).scope == "site"
        subject = subject_of(origin, need, task)
        return self._stored(need, Task(origin.name, subject), not whole_artifact, task.subject)

    def history_input(self, need: Source, task: Task) -> Input:
        """The shifts of a camera on earlier nights; absent without a reference, or if its frame is the reference's own."""
        if self.plan.reference is None or self._own_frames.issuperset(task.subject):
            return Absent()
        return Value(SHIFTS_TYPE, self._shift_history.get(camera_of(task.subject[0]), {}))

    @cached_property
    def _shift_history(self) -> dict[str, dict[str, list[float]]]:
        reference = self.plan.reference
        return shift_history(self.plan.cache.work, self.plan.night, reference.run) if reference else {}

    def replacement(self, stage: Stage, task: Task) -> Receipt | Adapt | None:
        """What replaces the computation of a task: the reference's result, or another function; None for neither.

        Raises Waiting while the health of a camera is not known, Impossible if a camera shows nothing of the site.
        """
        if stage.reuse.shifted is None or self.plan.reference is None or not any(s.name == HEALTH for s in self.plan.stages):
            return None
        for camera in task.subject:
            if self.state_of(camera) in USELESS:
                raise self.unfit_error((camera,))
        if not self._enough_poses_known() or any(
            stage_named(name).reuse.shifted for name in self._forced & ancestors(stage.name)
        ):
            return None
        decision = self._decision(stage.reuse, task)
        if decision == "reuse":
            return self._receipt(task)
        return decision if isinstance(decision, Adapt) else None

    def state_of(self, camera: str) -> str:
        """The state of a view: its own if it shows nothing of the site, else that of its camera.  Raises Waiting."""
        if health := self.plan.stale.get(camera_of(camera)):
            return health.state
        own_state = self._own_state(camera)
        others = [self._own_state(view) for view in self._views_of(camera) if view != camera] if own_state not in USELESS else []
        return next((state for state in (own_state, *others) if state not in USELESS | {"ok"}), own_state)

    def _own_state(self, view: str) -> str:
        """The state of a view, without that of other views of its camera.  Raises Waiting."""
        task = Task(HEALTH, (view,))
        state = self.plan.states.get(task)
        if state is None:
            raise Waiting(task)
        if health := self._healths.get(view):
            return health.state
        frame = self.plan.states.get(Task(FRAMES, (view,)))
        return "ok" if frame and frame.usable else "obscured"

    def health(self, camera: str) -> Health | None:
        """The health of a camera, or of the camera of a view; None if it was not examined.

        Of several views, the first that shows the site and is not ok decides, else the first that shows it, else the first.
        """
        if stale := self.plan.stale.get(camera_of(camera)):
            return stale
        healths = [self._healths[view] for view in self._views_of(camera) if view in self._healths]
        useful = [health for health in healths if health.state not in USELESS]
        return next((health for health in useful if not health.ok), next(iter(useful or healths), None))

    def _views_of(self, camera: str) -> Sequence[str]:
        """The views of a camera, or of the camera of a view; most cameras have one."""
        return self._views.get(camera_of(camera), [camera])

    @cached_property
    def _views(self) -> dict[str, list[str]]:
        views: dict[str, list[str]] = {}
        for view in self.cameras:
            views.setdefault(camera_of(view), []).append(view)
        return views

    def useless(self) -> Set[str]:
        """The views that are known to show nothing of the site tonight."""
        return self._useless if self.plan.reference else frozenset()

    def unfit_error(self, subject: Subject) -> Impossible:
        """Why a task is impossible: a camera of its subject shows nothing of the site."""
        camera = next((c for c in subject if c in self.useless()), subject[0])
        if health := self.plan.stale.get(camera_of(camera)) or self._healths.get(camera):
            return Impossible(f"camera {camera} is {health.state}: {health.text}", Cause.UNFIT)
        frame = Task(FRAMES, (camera,))
        return blocked_by(frame, self.plan.states[frame])

    def task_ended(self, task: Task) -> None:
        """Record the health of a camera, if the task that has ended determined it."""
        state = self.plan.states[task]
        if task.stage == HEALTH and state.usable:
            self._healths[task.subject[0]] = health = summary_of(state, HealthSummary)
            self._useless |= set(task.subject) if health.state in USELESS else set()

    def note_frame(self, subject: Subject, key: str) -> None:
        """Record whether a camera's frame tonight, by its cache key, is the reference's own."""
        pinned = self.plan.reference.artifacts.get(Task(FRAMES, subject)) if self.plan.reference else None
        (self._own_frames.update if pinned and pinned.key == key else self._own_frames.difference_update)(subject)

    def artifact_lost(self, task: Task) -> None:
        """Handle a damaged artifact: if it is the reference's, restore it from its copy, or else drop it from the reference."""
        self._poses_suffice = None
        if task.stage == HEALTH:
            self._healths.pop(task.subject[0], None)
            if camera_of(task.subject[0]) not in self.plan.stale:
                self._useless.discard(task.subject[0])
        reference, cache = self.plan.reference, self.plan.cache
        if reference and (pinned := reference.artifacts.get(task)) and not cache.by_key(task, pinned.key):
            if restore_to_cache(cache.work, pinned):
                return
            remaining = {t: p for t, p in reference.artifacts.items() if t != task}
            self.plan.reference = dataclasses.replace(reference, artifacts=remaining)
            self._own_frames -= set(task.subject) if task.stage == FRAMES else set()

    def _decision(self, reuse: Reuse, task: Task) -> Any:
        if len(self._own_frames) == len(self.cameras):
            return "reuse"
        cameras = task.subject or [c for c in self.cameras if self.state_of(c) not in USELESS]
        pose_states = {self._pose_state(c) for c in cameras}
        if _LOST in pose_states:
            return "reuse" if self._is_pooled(task) and {self.state_of(c) for c in cameras} == {"ok"} else reuse.moved
        return reuse.shifted if _TURNED in pose_states else "reuse"

    def _is_pooled(self, task: Task) -> bool:
        """Is the reference's result of a pair pooled from many nights, or derived from one that is?

        Such a result can be reused even if its cameras are not placed, as long as they have not moved.
        """
        receipt = self._receipt(task)
        for stage in STAGES if receipt and len(task.subject) == 2 else ():
            pooled = self._receipt(Task(stage.name, task.subject)) if stage.reuse.aggregate and stage.scope == "pair" else None
            if pooled and receipt and pooled.preimage.function == stage.reuse.aggregate:
                return pooled.digest in {receipt.digest, *receipt.preimage.inputs.values()}
        return False

    def _pose_state(self, camera: str) -> str:
        """Is a camera's pose that of the reference, derived from it, or unknown?  Raises Waiting."""
        if self.plan.reference is None or camera_of(camera) not in self.plan.reference.placed:
            return _LOST
        state = self.state_of(camera)
        if any(health.corrected for view in self._views_of(camera) if (health := self._healths.get(view))):
            return _TURNED
        return _STILL if state == "ok" else _LOST

    def _enough_poses_known(self) -> bool:
        """Are the poses of enough cameras known from the reference?  Raises Waiting."""
        if self._poses_suffice is None:
            self._poses_suffice = len({camera_of(c) for c in self.cameras if self._pose_state(c) != _LOST}) >= FEWEST
        return self._poses_suffice

    def _receipt(self, task: Task) -> Receipt | None:
        pinned = self.plan.reference.artifacts.get(task) if self.plan.reference else None
        return self.plan.cache.by_key(task, pinned.key) if pinned else None

    def _stored(self, need: Source, upstream: Task, one_entry: bool, subject: Subject = ()) -> Input:
        receipt = self._receipt(upstream)
        if receipt is None or receipt.outcome == "rejected":
            return Absent()
        part = Part(need.part, "--".join(subject) if one_entry else None) if need.part else None
        if part and str(part) not in receipt.parts:
            return Absent()
        return Stored(upstream, part).resolved(receipt)
