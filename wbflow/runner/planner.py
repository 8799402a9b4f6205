"""The plan: every task of a site with its state, derived again and again from the table of stages, the captures and the cache.

A task is settled (cached, ran, rejected, failed, skipped), ready, or waiting for others.  Nothing is stored: a plan made after
a crash finds in the cache exactly what was finished.
"""

from __future__ import annotations

import dataclasses
import functools
import heapq
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from operator import attrgetter
from typing import Any

from ..cache.store import Cache, Receipt
from ..pipeline.binding import Binding, bind
from ..pipeline.stages import (
    ANY_SECONDS,
    COMPONENT,
    DENSE_PAIRS,
    FRAMES,
    FUSE,
    PAIRS,
    POSES,
    ROUGH_SECONDS,
    STAGES,
    Adapt,
    Stage,
    ancestors,
    stage_named,
)
from ..records.costs import TaskCosts
from ..records.events import StageOutlook
from ..records.record import Health
from ..records.reference_folder import Reference
from ..reference.compatibility import misfit
from ..reference.health_history import ShiftHistory
from ..reference.resolve import Pinned
from ..site.models import Site
from ..task import Task, component_name, names_of
from .captures import CaptureFile
from .inputs import Inputs
from .spec import Absent, Drawing, Input, TaskSpec
from .state import Impossible, State, Waiting, cached_state
from .subjects import Subjects

_DECIDE = frozenset(Task(name) for name in (PAIRS, POSES, DENSE_PAIRS))
"""What these come to decides which tasks there are."""


@dataclass
class Agenda:
    """The tasks that are to be looked at, in the order of the table of stages."""

    all_anew: bool = True
    """Every task is to be listed again."""
    _places: dict[Task, int] = field(default_factory=dict)
    _due: list[tuple[int, Task]] = field(default_factory=list)
    _queued: set[Task] = field(default_factory=set)
    _waiting: dict[Task | None, list[Task]] = field(default_factory=dict)
    """Who waits, by what for."""
    _news: list[Task] = field(default_factory=list)

    def begin(self, tasks: Iterable[Task]) -> None:
        """Look at all of these, and at nothing else."""
        self.all_anew = False
        self._places = {task: place for place, task in enumerate(tasks)}
        self._due = [(place, task) for task, place in self._places.items()]  # in order, so it is a heap
        self._queued = set(self._places)
        self._waiting = {}

    def next(self) -> Task | None:
        """The next task that is to be looked at; None where there is none."""
        if not self._due:
            return None
        task = heapq.heappop(self._due)[1]
        self._queued.discard(task)
        return task

    def add(self, task: Task) -> None:
        """A task is to be looked at again."""
        if task in self._places and task not in self._queued:
            self._queued.add(task)
            heapq.heappush(self._due, (self._places[task], task))

    def wait(self, task: Task, other: Task | None) -> None:
        """A task is to be looked at when another is settled."""
        self._waiting.setdefault(other, []).append(task)

    def settled(self, task: Task) -> None:
        """A task is settled: who waited for it is looked at."""
        self._news.append(task)
        for other in self._waiting.pop(task, ()):
            self.add(other)
        self.all_anew = self.all_anew or task in _DECIDE

    def news(self) -> list[Task]:
        """The tasks that were settled since somebody asked last."""
        found, self._news = self._news, []
        return found


@dataclass
class Plan:
    """The tasks of one night.  `refresh` derives all of it from the cache."""

    site: Site
    captures: dict[str, list[CaptureFile]]
    night: str
    cache: Cache
    named: dict[str, CaptureFile] = field(default_factory=dict)
    expectations: dict[str, str] = field(default_factory=dict)
    until: str | None = None
    force: frozenset[str] = frozenset()
    states: dict[Task, State] = field(default_factory=dict)
    """Settled tasks."""
    ready: dict[Task, TaskSpec] = field(default_factory=dict)
    """Tasks whose inputs are all there."""
    waiting: dict[Task, Task | None] = field(default_factory=dict)
    """The rest, with what they wait for (None: for the pair graph)."""
    busy: set[Task] = field(default_factory=set)
    """Tasks that workers have in hand: neither looked up nor handed out again."""
    reference: Reference | None = None
    """What tonight is compared with."""
    misfit: str = ""
    """Why it is not, where a reference is there that is one of the site as it was before its file changed."""
    stale: dict[str, Health] = field(default_factory=dict)
    """Cameras whose captures are not of tonight."""
    night_given: bool = False
    """Has somebody named the night?  Otherwise pictures may say it, where names don't."""
    _agenda: Agenda = field(default_factory=Agenda)
    _bindings: dict[str, Binding] = field(default_factory=dict)
    _known_parameters: dict[str, tuple[dict[str, Any], dict[str, str]]] = field(default_factory=dict)
    """By stage, or by the function in its place."""
    _stages: list[Stage] = field(default_factory=list)

    def __post_init__(self) -> None:
        wanted = ancestors(self.until) if self.until else {stage.name for stage in STAGES}
        settings = self.site.stages
        self._read = functools.cache(self.site.reader.read)  # of this plan only: code may change before the next
        self._folder = self.site.file.resolve().parent
        off = {name for name, stage in settings.items() if not stage.enabled}
        off |= {stage.name for stage in STAGES if not stage.worth_doing(self.site)}
        for stage in STAGES:  # in their order: what needs one that is off is off, and so is what needs that
            off |= {stage.name} if stage.optional and off & stage.needed() else set()
        self._stages = [stage for stage in STAGES if stage.name in wanted - off]
        self._subjects = Subjects(self.site, self.states, any(stage.name == DENSE_PAIRS for stage in self._stages))
        if self.reference:
            self.misfit = misfit(
                self.reference, self.site, self._stages, self._bound, self._stated_parameters, self.cache, self.named
            )
        self.reference = None if self.misfit else self.reference
        past = ShiftHistory(self.cache.work, self.night, self.reference.run) if self.reference else ShiftHistory()
        cameras = [view.id for view in self.site.views]
        forced = frozenset(name.split(" ")[0] for name in self.force)
        self._pinned = Pinned(self.cache, cameras, self._stages, self.states, self.reference, past, forced, self.stale)
        known = self.site, self.captures, self.named, self.expectations
        taking_part = frozenset(stage.name for stage in self._stages)
        self._from = Inputs(*known, self._subjects, taking_part, self.states, self._pinned)

    def refresh(self) -> None:
        """Settle what the cache has, and find what is ready.  Only what may have changed since the last time is looked at."""
        named = {stage.name: stage for stage in self._stages}
        while True:
            if self._agenda.all_anew:
                self._list()
            task = self._agenda.next()
            if task is None:
                return
            if not (task in self.states or task in self.busy or task in self.ready):
                self._settle(named[task.stage], task)

    def settle(self, task: Task, state: State) -> None:
        """Record how a task of this run ended."""
        self.states[task] = state
        self.ready.pop(task, None)
        self.waiting.pop(task, None)
        self._pinned.settled(task)
        self._agenda.settled(task)

    def forget(self, task: Task) -> None:
        """Take a settled task back (its artifact turned out damaged)."""
        self.states.pop(task, None)
        self._pinned.lose(task)
        self._agenda.all_anew = True

    def look_again(self) -> None:
        """What the plan rests on has changed: whatever is not settled is derived anew."""
        self._agenda.all_anew = True

    def hand_out(self, lanes: list[list[TaskSpec]]) -> None:
        """Workers have these in hand."""
        for spec in (spec for lane in lanes for spec in lane):
            self.busy.add(spec.task)
            self.ready.pop(spec.task, None)
            self.waiting.pop(spec.task, None)

    def take_back(self, lane: list[TaskSpec] | None = None) -> None:
        """A lane has come to an end: what it has not settled is to be looked at again.  None: whatever workers have in hand."""
        for task in [spec.task for spec in lane] if lane is not None else list(self.busy):
            self.busy.discard(task)
            self._agenda.add(task)
            if (state := self.states.get(task)) and state.receipt and state.outcome != "cached":
                self.cache.learn(state.receipt)

    def news(self) -> list[tuple[Task, State]]:
        """The tasks that have been settled since somebody asked last."""
        return [(task, state) for task in self._agenda.news() if (state := self.states.get(task))]

    def lanes(self) -> Iterator[list[TaskSpec]]:
        """Ready tasks, each with the tasks of the same subject that can follow it in the same worker call."""
        for task, spec in self.ready.items():
            lane = [spec]
            if task.subject:
                for stage in self._stages:
                    follower = Task(stage.name, task.subject)
                    if follower in self.waiting:
                        try:
                            instead = self._pinned.instead(stage, follower)
                            if not isinstance(instead, Receipt):
                                lane.append(self._spec(stage, follower, {s.task for s in lane}, instead))
                        except (Waiting, Impossible):
                            continue
            among = {spec.task for spec in lane}
            yield [self._with_drawings(spec, among) for spec in lane]

    def pairs_known(self, stage: Stage | None = None) -> bool:
        """Is it known which pairs a stage works on (so that its tasks are listed), or each stage?"""
        return all(self._subjects.pairs(dense) is not None for dense in ([stage.dense] if stage else (False, True)))

    def tasks(self, stage: Stage) -> list[Task]:
        """The tasks of a stage, as far as they are listed yet."""
        return self._subjects.tasks(stage)

    def spec_of(self, task: Task) -> TaskSpec:
        """How a task would be done, whether it has been or not.

        Raises
        ------
        Waiting, Impossible
            Its inputs are not there yet, or will not come.
        """
        stage = stage_named(task.stage)
        instead = self._pinned.instead(stage, task)
        return self._with_drawings(self._spec(stage, task, adapt=None if isinstance(instead, Receipt) else instead), set())

    def likely_pairs(self, dense: bool = False) -> int | None:
        """About how many pairs will be matched, or made dense; None where that is known."""
        if self._subjects.pairs(dense) is not None:
            return None
        if (matched := self._subjects.pairs()) is not None:
            return len(matched)
        stage = stage_named(PAIRS)
        count = len(self.site.views)
        wanted = (self._bound(stage).defaults() | self._stated_parameters(stage, Task(stage.name))).get("degree")
        most = count * (count - 1) // 2
        return min(most, count * wanted // 2) if isinstance(wanted, int) else most

    def upstreams(self, task: Task) -> list[Task]:
        """The tasks that a task takes its inputs from, as far as they are listed yet."""
        return self._from.upstreams(task, self._bound(stage_named(task.stage)).inputs)

    def health(self, camera: str) -> Health | None:
        """What became of a camera; None where nobody knows."""
        return self._pinned.health(camera)

    def stages(self) -> list[Stage]:
        """The stages that take part tonight."""
        return list(self._stages)

    def _list(self) -> None:
        """List every task that is known of, to be looked at in the order of the table."""
        self.ready, self.waiting = {}, {}
        self._agenda.begin(task for stage in self._stages for task in self._subjects.tasks(stage))

    def _settle(self, stage: Stage, task: Task) -> None:
        self.waiting.pop(task, None)
        try:
            instead = self._pinned.instead(stage, task)
            if isinstance(instead, Receipt):
                self._found(task, cached_state(instead))
                return
            spec = self._spec(stage, task, adapt=instead)
        except Waiting as waiting:
            self.waiting[task] = waiting.task
            self._agenda.wait(task, waiting.task)
            return
        except Impossible as impossible:
            self._found(task, State("failed" if stage.name == FRAMES else "skipped", str(impossible), impossible.code))
            return
        preimage = spec.preimage()
        key = preimage.key()
        if stage.name == FRAMES:
            self._pinned.note_frame(task.subject, key)
        receipt = None if spec.force else self.cache.find(preimage, key)
        if receipt is None:
            self.ready[task] = spec
        else:
            self._found(task, cached_state(receipt))

    def _found(self, task: Task, state: State) -> None:
        self.states[task] = state
        self._pinned.settled(task)
        self._agenda.settled(task)

    def _spec(self, stage: Stage, task: Task, among: set[Task] | None = None, adapt: Adapt | None = None) -> TaskSpec:
        """The spec of a task; inputs made by tasks `among` may still be unresolved.  adapt: what takes the function's place."""
        bound = self._bound(stage, adapt)
        inputs = self._from.of(stage, task, bound.inputs, among or set())
        parameters, left_to_function = self._parameters(stage, task, adapt)
        return TaskSpec(
            task,
            bound.function.dotted,
            bound.code,
            parameters,
            inputs,
            stage.table,
            force=bool(self.force & names_of(task)) if self.force else False,
            left_to_function=left_to_function,
            folder=self._folder,
        )

    def _with_drawings(self, spec: TaskSpec, among: set[Task]) -> TaskSpec:
        """A task with what is drawn of its result; inputs made by tasks `among` may still be unresolved."""
        stage = stage_named(spec.task.stage)
        drawings = []
        for name, function in stage.products.drawings.items():
            inputs: dict[str, Input] = {}
            for argument, need in stage.products.picture_inputs.items() if name == "picture" else ():
                try:
                    inputs[argument] = self._from.one(stage, spec.task, need, among)
                except (Waiting, Impossible):
                    inputs[argument] = Absent()
            drawings.append(Drawing(name, function, inputs))
        return dataclasses.replace(spec, drawings=tuple(drawings))

    def _bound(self, stage: Stage, adapt: Adapt | None = None) -> Binding:
        name = adapt.function if adapt else stage.name
        if name not in self._bindings:
            settings = self.site.stages.get(stage.name)
            use, values = (settings.use, settings.parameters) if settings else (None, {})
            if adapt:
                use, values = None, {}
                stage = dataclasses.replace(stage, function=adapt.function, inputs=adapt.inputs, offers={}, method=None)
            self._bindings[name] = bind(stage, use, values, self.site.reader)
        return self._bindings[name]

    def _parameters(self, stage: Stage, task: Task, adapt: Adapt | None) -> tuple[dict[str, Any], dict[str, str]]:
        """Parameters of a task, and the text of those that its function works out: the same for all subjects of a stage."""
        name = adapt.function if adapt else stage.name
        known = self._known_parameters.get(name)
        if known is None or stage.name == FUSE:
            bound = self._bound(stage, adapt)
            stated = self._stated_parameters(stage, task)
            stated = stated if adapt is None else {name: v for name, v in stated.items() if name in bound.parameters}
            left = {name: text for name, text in bound.left_to_function().items() if name not in stated}
            known = self._known_parameters[name] = bound.defaults() | stated, left
        return known

    def _stated_parameters(self, stage: Stage, task: Task) -> dict[str, Any]:
        """Parameters that the site file sets, in the stage's section or elsewhere."""
        values: dict[str, Any] = {name: attrgetter(key)(self.site) for name, key in stage.set_by_site().items()}
        if stage.name == FUSE:
            numbers = range(1, self._subjects.components())
            values[COMPONENT] = next((k for k in numbers if task.subject == (component_name(k),)), 0)
        known = self._bound(stage).parameters
        settings = self.site.stages.get(stage.name)
        return {name: v for name, v in values.items() if name in known} | (settings.parameters if settings else {})


_ACROSS, _ASPECT = 1600, 0.6
"""Pixels along a picture's longer side where nothing is stated, and the shorter side's share of it."""


def outlook(plan: Plan, past: TaskCosts) -> tuple[StageOutlook, ...]:
    """How much there is of each stage, how much of it is settled, and what a task of it takes.

    Parameters
    ----------
    plan : Plan
        As it stands.
    past : TaskCosts
        What tasks took before.
    """
    found = []
    for stage in plan.stages():
        tasks = plan.tasks(stage)
        settled = sum(task in plan.states for task in tasks)
        known = stage.name in past.stages
        walls = [past.expected(stage.name, str(task)) for task in tasks if task not in plan.states] if known else []
        seconds = sum(walls) / len(walls) if walls else past.stages.get(stage.name, _rough(plan, stage))
        count = (plan.likely_pairs(stage.dense) if stage.scope == "pair" else None) or len(tasks)
        compiles = 0.0 if known else sum(ROUGH_SECONDS.get(stage.name, ANY_SECONDS)[2:])
        found.append(StageOutlook(stage.name, count, settled, seconds, known, compiles))
    return tuple(found)


def _rough(plan: Plan, stage: Stage) -> float:
    """What a task of a stage takes that nobody has timed yet."""
    fixed, each, *_ = ROUGH_SECONDS.get(stage.name, ANY_SECONDS)
    stated = sorted(camera.lens.width for camera in plan.site.cameras if camera.lens.width)
    across = min(plan.site.resolution or _ACROSS, stated[len(stated) // 2] if stated else _ACROSS)
    return fixed + each * _ASPECT * across**2 / 1e6 * (len(plan.site.cameras) if stage.scope == "site" else 1)


def anything_left(plan: Plan) -> bool:
    """Is there a task that is not settled, or may there come one?"""
    return bool(plan.ready or plan.waiting or plan.busy)
