"""What tonight takes from the pinned reference: inputs, whole results, and how each camera stands compared with it.

The reference answers for the results of a stage that says so (`Reuse`) as long as the cameras in question stand as they did; the
stage `health` says of each camera whether it does.
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
from ..runner.state import Cause, Impossible, Waiting, because, summary_of
from ..task import Subject, Task, camera_of
from .restore import put_back

if TYPE_CHECKING:
    from ..runner.planner import Plan

_STILL, _TURNED, _LOST = "still", "turned", "lost"
"""A camera's pose is that of the reference, is known from it, or is not known."""
USELESS = frozenset({"obscured", "stale", "wrong-scene"})
"""States of a camera that shows nothing of the site tonight."""
FEWEST = 2
"""So many cameras must stand where they did, for the reference to tell where the others are."""

SHIFTS_TYPE = "wbflow_stages.types:Usual"
"""The type that shifts are handed to a stage as; its fields are lists, one number for each night, oldest first..."""
SHIFTS = ("shift_x_px", "shift_y_px", "roll_deg")
"""...and their names, which are those of the figures of the camera's health."""
MOST_NIGHTS = 14
MOST_RUNS = 3 * MOST_NIGHTS
"""So many records are read at most: nights may be run several times."""


def shift_history(work: WorkFolder, night: str, reference: str) -> dict[str, dict[str, list[float]]]:
    """By camera, its shifts by name, one for each night that was compared with the same reference and has them, oldest first.

    night: only what is older counts, so that a night that is run again finds the same past.  reference: id of its run.
    """
    runs = islice(newest_runs(work, after=reference), MOST_RUNS)
    nights = last_of_nights((run for run in runs if run[1].date < night and run[1].reference == reference), MOST_NIGHTS)
    found: dict[str, dict[str, list[float]]] = {}
    for camera in (camera for record in nights for camera in record.cameras):
        figures = camera.health.figures if camera.health else {}
        for name in SHIFTS if all(name in figures for name in SHIFTS) else ():
            found.setdefault(camera.id, {}).setdefault(name, []).append(float(figures[name]))
    return found


@dataclass
class Resolver:
    """The reference as tonight's plan sees it."""

    plan: Plan
    """Whose states and reference it goes by, as these change."""
    _healths: dict[str, HealthSummary] = field(default_factory=dict, repr=False)
    """By view, of those that have been looked at tonight."""
    _useless: set[str] = field(default_factory=set, repr=False)
    """Views that show nothing of the site, as far as is known."""
    _own_frames: set[str] = field(default_factory=set, repr=False)
    """Views whose frame is that of the reference itself."""
    _enough: bool | None = field(default=None, repr=False)
    """Do enough cameras stand where they did, once the health of all is known?"""

    def __post_init__(self) -> None:
        self.cameras = [view.id for view in self.plan.site.views]  # of a camera that has several, all
        self._forced = {name.split(" ")[0] for name in self.plan.force}
        """Stages that are to be done again."""
        self._useless |= {view for view in self.cameras if (h := self.plan.stale.get(camera_of(view))) and h.state in USELESS}

    def input(self, need: Source, task: Task) -> Input:
        """An input that the reference holds.  Raises Waiting."""
        everywhere = need.of == "every"
        if self.plan.reference is None or self._own_frames.issuperset(task.subject or self.cameras):
            return Joined({}) if everywhere else Absent()
        origin = stage_named(need.name)
        if everywhere and origin.scope != "site":
            tasks = [t for t in self.plan.reference.artifacts if t.stage == origin.name]
            found = {t.subject: self._stored(need, t, False) for t in tasks}
            return Joined({subject: item for subject, item in found.items() if isinstance(item, Stored)})
        whole = origin.scope != "site" or stage_named(task.stage).scope == "site"
        subject = subject_of(origin, need, task)
        return self._stored(need, Task(origin.name, subject), not whole, task.subject)

    def history_input(self, need: Source, task: Task) -> Input:
        """What earlier nights found of a camera.  Raises Waiting."""
        if self.plan.reference is None or self._own_frames.issuperset(task.subject):
            return Absent()
        return Value(SHIFTS_TYPE, self._past.get(camera_of(task.subject[0]), {}))

    @cached_property
    def _past(self) -> dict[str, dict[str, list[float]]]:
        reference = self.plan.reference
        return shift_history(self.plan.cache.work, self.plan.night, reference.run) if reference else {}

    def replacement(self, stage: Stage, task: Task) -> Receipt | Adapt | None:
        """What takes the place of working a task out: the reference's result, or another function.

        Raises Waiting while the health of a camera is not known, Impossible where one shows nothing of the site.
        """
        if stage.reuse.shifted is None or self.plan.reference is None or not any(s.name == HEALTH for s in self.plan.stages):
            return None
        for camera in task.subject:
            if self.state_of(camera) in USELESS:
                raise self.unfit((camera,))
        if not self._enough_stand() or any(stage_named(name).reuse.shifted for name in self._forced & ancestors(stage.name)):
            return None
        decision = self._decision(stage.reuse, task)
        if decision == "reuse":
            return self._receipt(task)
        return decision if isinstance(decision, Adapt) else None

    def state_of(self, camera: str) -> str:
        """How a camera is; a view that shows nothing is of no use, else it is as its camera is.  Raises Waiting."""
        if health := self.plan.stale.get(camera_of(camera)):
            return health.state
        own = self._own_state(camera)
        others = [self._own_state(view) for view in self._views_of(camera) if view != camera] if own not in USELESS else []
        return next((state for state in (own, *others) if state not in USELESS | {"ok"}), own)

    def _own_state(self, view: str) -> str:
        """How a view is, by itself.  Raises Waiting."""
        task = Task(HEALTH, (view,))
        state = self.plan.states.get(task)
        if state is None:
            raise Waiting(task)
        if health := self._healths.get(view):
            return health.state
        frame = self.plan.states.get(Task(FRAMES, (view,)))
        return "ok" if frame and frame.usable else "obscured"

    def health(self, camera: str) -> Health | None:
        """What is known of a camera's health, or of that of the camera of a view; None where nobody has looked.

        Of several views, that of the first that has turned; the camera shows nothing of the site where none of them does.
        """
        if known := self.plan.stale.get(camera_of(camera)):
            return known
        found = [self._healths[view] for view in self._views_of(camera) if view in self._healths]
        of_use = [health for health in found if health.state not in USELESS]
        return next((health for health in of_use if not health.ok), next(iter(of_use or found), None))

    def _views_of(self, camera: str) -> Sequence[str]:
        """A camera's views, or those of the camera of a view; most have one."""
        return self._views.get(camera_of(camera), [camera])

    @cached_property
    def _views(self) -> dict[str, list[str]]:
        found: dict[str, list[str]] = {}
        for view in self.cameras:
            found.setdefault(camera_of(view), []).append(view)
        return found

    def useless(self) -> Set[str]:
        """The cameras of which it is known that they show nothing of the site tonight."""
        return self._useless if self.plan.reference else frozenset()

    def unfit(self, subject: Subject) -> Impossible:
        """Why what one of these cameras shows is not used."""
        camera = next((c for c in subject if c in self.useless()), subject[0])
        if health := self.plan.stale.get(camera_of(camera)) or self._healths.get(camera):
            return Impossible(f"camera {camera} is {health.state}: {health.text}", Cause.UNFIT)
        frame = Task(FRAMES, (camera,))
        return because(frame, self.plan.states[frame])

    def task_ended(self, task: Task) -> None:
        """A task has ended: that may have been the health of a camera."""
        state = self.plan.states[task]
        if task.stage == HEALTH and state.usable:
            self._healths[task.subject[0]] = health = summary_of(state, HealthSummary)
            self._useless |= set(task.subject) if health.state in USELESS else set()

    def note_frame(self, subject: Subject, key: str) -> None:
        """The key of tonight's frame of a camera."""
        pinned = self.plan.reference.artifacts.get(Task(FRAMES, subject)) if self.plan.reference else None
        (self._own_frames.update if pinned and pinned.key == key else self._own_frames.difference_update)(subject)

    def artifact_lost(self, task: Task) -> None:
        """An artifact was found damaged: where it was the reference's, its copy is put back, or that has it no longer."""
        self._enough = None
        if task.stage == HEALTH:
            self._healths.pop(task.subject[0], None)
            if camera_of(task.subject[0]) not in self.plan.stale:
                self._useless.discard(task.subject[0])
        reference, cache = self.plan.reference, self.plan.cache
        if reference and (pinned := reference.artifacts.get(task)) and not cache.by_key(task, pinned.key):
            if put_back(cache.work, pinned):
                return
            left = {t: p for t, p in reference.artifacts.items() if t != task}
            self.plan.reference = dataclasses.replace(reference, artifacts=left)
            self._own_frames -= set(task.subject) if task.stage == FRAMES else set()

    def _decision(self, reuse: Reuse, task: Task) -> Any:
        if len(self._own_frames) == len(self.cameras):
            return "reuse"
        cameras = task.subject or [c for c in self.cameras if self.state_of(c) not in USELESS]
        standing = {self._standing(c) for c in cameras}
        if _LOST in standing:
            return "reuse" if self._of_many_nights(task) and {self.state_of(c) for c in cameras} == {"ok"} else reuse.moved
        return reuse.shifted if _TURNED in standing else "reuse"

    def _of_many_nights(self, task: Task) -> bool:
        """Is the reference's result of a pair pooled from many nights, or made from one that is?

        Its cameras need not be placed for that, only stand there still.
        """
        receipt = self._receipt(task)
        for stage in STAGES if receipt and len(task.subject) == 2 else ():
            pooled = self._receipt(Task(stage.name, task.subject)) if stage.reuse.aggregate and stage.scope == "pair" else None
            if pooled and receipt and pooled.preimage.function == stage.reuse.aggregate:
                return pooled.digest in {receipt.digest, *receipt.preimage.inputs.values()}
        return False

    def _standing(self, camera: str) -> str:
        """Is a camera's pose that of the reference, or known from it?  Raises Waiting."""
        if self.plan.reference is None or camera_of(camera) not in self.plan.reference.placed:
            return _LOST
        state = self.state_of(camera)
        if any(health.corrected for view in self._views_of(camera) if (health := self._healths.get(view))):
            return _TURNED
        return _STILL if state == "ok" else _LOST

    def _enough_stand(self) -> bool:
        """Do enough cameras stand where they did?  Raises Waiting."""
        if self._enough is None:
            self._enough = len({camera_of(c) for c in self.cameras if self._standing(c) != _LOST}) >= FEWEST
        return self._enough

    def _receipt(self, task: Task) -> Receipt | None:
        pinned = self.plan.reference.artifacts.get(task) if self.plan.reference else None
        return self.plan.cache.by_key(task, pinned.key) if pinned else None

    def _stored(self, need: Source, upstream: Task, entry: bool, subject: Subject = ()) -> Input:
        receipt = self._receipt(upstream)
        if receipt is None or receipt.outcome == "rejected":
            return Absent()
        part = Part(need.part, "--".join(subject) if entry else None) if need.part else None
        if part and str(part) not in receipt.parts:
            return Absent()
        return Stored(upstream, part).resolved(receipt)
