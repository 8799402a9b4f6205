"""What tonight's run takes from the pinned reference: inputs, whole results, and each camera's state compared with it.

Results of the reference are reused as each stage's `Reuse` defines, depending on whether the cameras involved have moved; the
stage `health` finds that out for each camera.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from functools import cached_property
from itertools import islice
from typing import Literal

from wbflow_stages.contracts.camera_figures import ExaminedHealth, Health, ShiftHistory

from ..cache.layout import WorkFolder
from ..cache.receipt import Receipt
from ..pipeline.stages import CHANGES, FRAMES, HEALTH, STAGES, Adapt, Reuse, Source, Stage, ancestors, stage_named
from ..records.record import RunRecord
from ..records.reference import Reference
from ..records.run_folder import last_of_nights, newest_runs
from ..runner.night import Night
from ..runner.spec import Input, Joined, Stored, Value, stored_input
from ..runner.state import Cause, Impossible, State, Waiting, blocked_by, summary_of
from ..task import Subject, Task, camera_of
from .copies import restore_to_cache
from .previous import PreviousNight

USELESS = frozenset({"obscured", "stale", "wrong-scene"})
"""States of a camera that shows nothing of the site tonight."""
FEWEST = 2
"""The reference is reused only if the poses of at least this many cameras are known from it: a pair needs two."""

SHIFTS_TYPE = "wbflow_stages.types:ShiftHistory"
"""The type in which a stage gets the shifts of earlier nights; its fields are lists of one number per night, oldest first."""
USED_IDS_TYPE = "wbflow_stages.contracts.ground_figures:UsedIds"
"""The type in which a stage gets the ids that changes of earlier nights have."""
SHIFTS = tuple(shift.name for shift in fields(ShiftHistory))
"""Fields of `SHIFTS_TYPE`; the figures of a camera's health have the same names."""
MOST_NIGHTS = 14
"""Largest number of earlier nights whose shifts a camera's health is judged by."""
MOST_RUNS = 3 * MOST_NIGHTS
"""Largest number of run records to read: a night may have several runs."""


def shift_history(work: WorkFolder, night: str, reference: str) -> dict[str, dict[str, list[float]]]:
    """By camera and field: its shifts on the nights that were compared with the same reference and measured them, oldest first.

    night: only older nights count, so that a repeated run finds the same history.  reference: id of the reference's run.
    """
    runs = islice(newest_runs(work, after=reference), MOST_RUNS)
    comparable = ((folder, record) for folder, record in runs if record.date < night and record.reference == reference)
    history: dict[str, dict[str, list[float]]] = {}
    for record in last_of_nights(comparable, MOST_NIGHTS):
        for camera in record.cameras:
            figures = camera.health.figures if camera.health else {}
            if not all(name in figures for name in SHIFTS):
                continue  # nothing was measured: the camera was obscured, say
            shifts = history.setdefault(camera.id, {name: [] for name in SHIFTS})
            for name in SHIFTS:
                shifts[name].append(float(figures[name]))
    return history


@dataclass
class Resolver:
    """Decides what tonight's plan reuses of the reference."""

    night: Night
    states: Mapping[Task, State]
    """States of the tasks that have ended; the plan's own dictionary, which changes."""
    reference: Reference | None = field(init=False)
    """The reference, without the artifacts that were lost during the run."""
    _healths: dict[str, ExaminedHealth] = field(default_factory=dict, repr=False)
    """Health by view, for the views that were examined tonight."""
    _own_frames: set[str] = field(default_factory=set, repr=False)
    """Views whose frame tonight is the reference's own (same cache key)."""
    _poses_suffice: bool | None = field(default=None, repr=False)
    """Are the poses of at least `FEWEST` cameras known from the reference?  None until the health of all is known."""

    def __post_init__(self) -> None:
        self.reference = self.night.reference
        self.cameras = [view.id for view in self.night.site.views]
        """Ids of all views."""
        forced = {name.split(" ")[0] for name in self.night.force}
        self._forced = {name for name in forced if stage_named(name).reuse.shifted}
        """Stages with tasks that are forced to run again, and whose results the reference would provide otherwise."""

    def input(self, need: Source, task: Task) -> Input:
        """An input from the reference, or from the nights since: of kind "history", the shifts of the task's camera; of kind
        "previous", the changes of the night before, or the ids in use.

        It is absent or empty without a reference, or if tonight's frames are the reference's own.
        """
        # compared with itself, a night would find that nothing has changed: it is worked on as if there were no reference
        if self.reference is None or self._own_frames.issuperset(task.subject or self.cameras):
            return Joined({}) if need.joins else None
        if need.kind == "history":
            return Value(SHIFTS_TYPE, self._shift_history.get(camera_of(task.subject[0]), {}))
        if need.kind == "previous":
            if need.name == CHANGES:
                return Stored(Task(CHANGES)).resolved(self._previous_night.receipt())
            return Value(USED_IDS_TYPE, {"highest": self._previous_night.highest_id})
        if not need.joins:
            wanted = stored_input(need, task)
            return wanted.resolved(self._receipt(wanted.task))
        results: dict[Subject, Stored] = {}
        for upstream in self.reference.artifacts:
            if upstream.stage != need.name:
                continue
            stored = Stored(upstream, need.part).resolved(self._receipt(upstream))
            if stored:
                results[upstream.subject] = stored
        return Joined(results)

    @cached_property
    def _previous_night(self) -> PreviousNight:
        reference = self.night.reference
        return PreviousNight(self.night.cache, str(self.night.date), reference.run if reference else "")

    @property
    def previous_run(self) -> RunRecord | None:
        """The run whose changes tonight's go on from; None if there is none."""
        return self._previous_night.record() if self._compares else None

    @property
    def lost_nights(self) -> list[str]:
        """The earlier nights whose changes tonight's would go on from, if the cache still had them."""
        return self._previous_night.lost if self._compares else []

    @property
    def _compares(self) -> bool:
        """Does the night look for changes since a reference?"""
        return self.night.reference is not None and self.night.takes_part(CHANGES)

    @cached_property
    def _shift_history(self) -> dict[str, dict[str, list[float]]]:
        """The shifts of all cameras; read once, and only if a task needs them."""
        if self.reference is None:
            return {}
        return shift_history(self.night.cache.work, str(self.night.date), self.reference.run)

    def replacement(self, stage: Stage, task: Task) -> Receipt | Adapt | None:
        """What replaces the computation of a task: the reference's result, or another function; None for neither.

        Raises Waiting while the health of a camera is not known, Impossible if a camera shows nothing of the site.
        """
        if stage.reuse.shifted is None or self.reference is None or not self.night.takes_part(HEALTH):
            return None
        for camera in task.subject:
            if self.state_of(camera) in USELESS:
                raise self._unfit_error(camera)
        # what was forced to run again would have no effect if a later stage took the reference's result
        if not self._enough_poses_known() or self._forced & ancestors(stage.name):
            return None
        use = self._use(stage.reuse, task)
        if isinstance(use, Adapt):
            return use
        return self._receipt(task) if use == "reuse" else None

    def state_of(self, camera: str) -> str:
        """The state of a view: its own if it shows nothing of the site, else that of its camera.  Raises Waiting."""
        stale = self.night.stale.get(camera_of(camera))
        if stale:
            return stale.state
        own_state = self._own_state(camera)
        if own_state in USELESS:
            return own_state
        # what moved one view has moved all views of its camera; a view that shows nothing tells nothing of the others
        states = [own_state] + [self._own_state(view) for view in self._views[camera_of(camera)]]
        for state in states:
            if state != "ok" and state not in USELESS:
                return state
        return "ok"

    def _own_state(self, view: str) -> str:
        """The state of a view, without that of other views of its camera.  Raises Waiting."""
        task = Task(HEALTH, (view,))
        state = self.states.get(task)
        if state is None:
            raise Waiting(task)
        health = self._healths.get(view)
        if health:
            return health.state
        # not examined: either there is no frame, or one that could not be compared
        frame = self.states.get(Task(FRAMES, (view,)))
        return "ok" if frame and frame.usable else "obscured"

    def health(self, camera: str) -> Health | None:
        """The health of a camera, or of the camera of a view; None if it was not examined.

        Of several views, the first that shows the site and is not ok decides, else the first that shows it, else the first.
        """
        stale = self.night.stale.get(camera_of(camera))
        if stale:
            return stale
        healths = [self._healths[view] for view in self._views[camera_of(camera)] if view in self._healths]
        useful = [health for health in healths if health.state not in USELESS]
        for health in useful:
            if not health.ok:
                return health
        candidates = useful or healths
        return candidates[0] if candidates else None

    @cached_property
    def _views(self) -> dict[str, list[str]]:
        """The views by camera; most cameras have one."""
        views: dict[str, list[str]] = {}
        for view in self.cameras:
            views.setdefault(camera_of(view), []).append(view)
        return views

    def unfit(self, subject: Subject) -> Impossible | None:
        """Why a subject is of no use tonight: one of its cameras is known to show nothing of the site; None if none is."""
        if self.reference is None:
            return None
        for view in subject:
            health = self._known_health(view)
            if health and health.state in USELESS:
                return self._unfit_error(view)
        return None

    def _known_health(self, view: str) -> Health | None:
        """The health of a view: that of its camera if this is stale, else what was found tonight; None if nothing was."""
        return self.night.stale.get(camera_of(view)) or self._healths.get(view)

    def _unfit_error(self, view: str) -> Impossible:
        """Why a task is impossible: this view shows nothing of the site."""
        health = self._known_health(view)
        if health:
            return Impossible(f"camera {view} is {health.state}: {health.text}", Cause.UNFIT)
        frame = Task(FRAMES, (view,))
        return blocked_by(frame, self.states[frame])

    def task_ended(self, task: Task) -> None:
        """Record the health of a camera, if the task that has ended determined it."""
        state = self.states[task]
        if task.stage == HEALTH and state.usable:
            self._healths[task.subject[0]] = summary_of(state, ExaminedHealth)

    def note_frame(self, subject: Subject, key: str) -> None:
        """Record whether a camera's frame tonight, by its cache key, is the reference's own."""
        pinned = self.reference.artifacts.get(Task(FRAMES, subject)) if self.reference else None
        if pinned and pinned.key == key:
            self._own_frames.update(subject)
        else:
            self._own_frames.difference_update(subject)

    def artifact_lost(self, task: Task) -> None:
        """Handle a damaged artifact: if it is the reference's, restore it from its copy, or else drop it from the reference."""
        self._poses_suffice = None
        if task.stage == HEALTH:
            self._healths.pop(task.subject[0], None)
        if self.reference is None:
            return
        cache = self.night.cache
        pinned = self.reference.artifacts.get(task)
        if pinned is None or cache.by_key(task, pinned.key):
            return  # it was another night's
        if restore_to_cache(cache.work, pinned):
            return
        remaining = {other: result for other, result in self.reference.artifacts.items() if other != task}
        self.reference = dataclasses.replace(self.reference, artifacts=remaining)
        if task.stage == FRAMES:
            self._own_frames -= set(task.subject)

    def _use(self, reuse: Reuse, task: Task) -> Literal["reuse", "recompute"] | Adapt | None:
        """How tonight uses the reference's result of a task: the poses of its cameras, or of all useful ones, decide."""
        if len(self._own_frames) == len(self.cameras):  # tonight is the reference's own night
            return "reuse"
        # a camera that shows nothing tonight does not keep the others from being reused
        cameras = task.subject or [camera for camera in self.cameras if self.state_of(camera) not in USELESS]
        poses = {self._pose_state(camera) for camera in cameras}
        if "lost" in poses:
            none_moved = all(self.state_of(camera) == "ok" for camera in cameras)
            if none_moved and self._is_pooled(task):
                return "reuse"
            return reuse.moved
        if "turned" in poses:
            return reuse.shifted
        return "reuse"

    def _is_pooled(self, task: Task) -> bool:
        """Is the reference's result of a pair pooled from many nights, or derived from one that is?

        Such a result can be reused even if its cameras are not placed, as long as they have not moved.
        """
        receipt = self._receipt(task)
        if receipt is None or len(task.subject) != 2:
            return False
        for stage in STAGES:
            if not stage.reuse.aggregate:
                continue
            pooled = self._receipt(Task(stage.name, task.subject))
            if pooled and pooled.preimage.function == stage.reuse.aggregate:
                return pooled.digest in {receipt.digest, *receipt.preimage.inputs.values()}
        return False

    def _pose_state(self, camera: str) -> Literal["still", "turned", "lost"]:
        """Is a camera's pose that of the reference ("still"), derived from it, or unknown?  Raises Waiting."""
        if self.reference is None or camera_of(camera) not in self.reference.placed:
            return "lost"
        state = self.state_of(camera)
        # turned by a rotation that was measured: the pose is known as well as before
        for view in self._views[camera_of(camera)]:
            health = self._healths.get(view)
            if health and health.corrected:
                return "turned"
        return "still" if state == "ok" else "lost"

    def _enough_poses_known(self) -> bool:
        """Are the poses of enough cameras known from the reference?  Raises Waiting."""
        if self._poses_suffice is None:  # asked for each task, and the same for all of them
            known = {camera_of(view) for view in self.cameras if self._pose_state(view) != "lost"}
            self._poses_suffice = len(known) >= FEWEST
        return self._poses_suffice

    def _receipt(self, task: Task) -> Receipt | None:
        """The receipt of a task's result in the reference; None if there is none."""
        if self.reference is None:
            return None
        pinned = self.reference.artifacts.get(task)
        if pinned is None:
            return None
        return self.night.cache.by_key(task, pinned.key)
