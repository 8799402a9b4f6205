"""The plan: every task of a site with its state, derived again and again from the table of stages, the captures and the cache.

A task is settled (cached, ran, rejected, failed, skipped), ready, or waiting for others.  Nothing is stored: a plan made after
a crash finds in the cache exactly what was finished.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from ..config.site import Site, SiteCamera, plain
from ..graph.binding import Binding, bind
from ..graph.pipeline import (
    SITE_TYPES,
    STAGES,
    FromSite,
    FromStage,
    Need,
    Part,
    Role,
    SiteValue,
    Stage,
    Which,
    ancestors,
    stage_named,
    stage_with,
)
from ..store.cache import Cache
from ..store.pictures import is_drawn
from ..task import Subject, Task, component_name
from .captures import CaptureFile
from .obstacles import Impossible, Waiting, because
from .spec import Absent, Files, Input, Joined, PictureSpec, Stored, TaskSpec, Value
from .state import Cause, State, cached_state


@dataclass
class Plan:
    """The tasks of one night.  `refresh` derives all of it from the cache."""

    site: Site
    captures: dict[str, list[CaptureFile]]
    night: str
    cache: Cache
    masks: dict[str, CaptureFile] = field(default_factory=dict)
    expectations: dict[str, str] = field(default_factory=dict)
    until: str | None = None
    force: frozenset[str] = frozenset()
    states: dict[Task, State] = field(default_factory=dict)
    """Settled tasks."""
    ready: dict[Task, TaskSpec] = field(default_factory=dict)
    """Tasks whose inputs are all there."""
    waiting: dict[Task, Task | None] = field(default_factory=dict)
    """The rest, with what they wait for (None: for the pair graph)."""
    undrawn: dict[Task, TaskSpec] = field(default_factory=dict)
    """Settled tasks whose picture is missing, or out of date."""
    busy: set[Task] = field(default_factory=set)
    """Tasks that workers have in hand: neither looked up nor handed out again."""
    _bindings: dict[str, Binding] = field(default_factory=dict)
    _stages: list[Stage] = field(default_factory=list)

    def __post_init__(self) -> None:
        wanted = ancestors(self.until) if self.until else {stage.name for stage in STAGES}
        settings = self.site.stages
        self._read = functools.cache(self.site.reader.read)  # of this plan only: code may change before the next
        off = {name for name, stage in settings.items() if not stage.enabled}
        off |= {stage.name for stage in STAGES if stage.optional and off & stage.needed()}
        self._stages = [stage for stage in STAGES if stage.name in wanted - off]

    def refresh(self) -> None:
        """Settle what the cache has, and find what is ready."""
        self.ready, self.waiting = {}, {}
        for stage in self._stages:
            for task in self._tasks(stage):
                if task not in self.states and task not in self.busy:
                    self._settle(stage, task)

    def settle(self, task: Task, state: State) -> None:
        """Record how a task of this run ended."""
        self.states[task] = state
        self.undrawn.pop(task, None)

    def forget(self, task: Task) -> None:
        """Take a settled task back (its artifact turned out damaged)."""
        self.states.pop(task, None)

    def lanes(self) -> Iterator[list[TaskSpec]]:
        """Ready tasks, each with the tasks of the same subject that can follow it in the same worker call; when there are none,
        pictures that are missing or were drawn by another function than the present one."""
        for task, spec in self.ready.items():
            lane = [spec]
            if task.subject:
                for stage in self._stages:
                    follower = Task(stage.name, task.subject)
                    if follower in self.waiting:
                        try:
                            lane.append(self._spec(stage, follower, among={s.task for s in lane}))
                        except (Waiting, Impossible):
                            continue
            yield lane
        if not self.ready:
            yield from ([spec] for spec in self.undrawn.values())

    def pairs_known(self) -> bool:
        """Is the pair graph there (so that every pair's tasks are listed)?"""
        return self._pairs() is not None

    def upstreams(self, task: Task) -> list[Task]:
        """The tasks that a task takes its inputs from, as far as they are listed yet."""
        found = []
        for need in self._bound(stage_named(task.stage)).needs.values():
            if isinstance(need, FromSite) or (need.unless_posed and self.site.posed):
                continue
            origin = stage_named(need.stage)
            if need.optional and origin not in self._stages:
                continue
            if need.which in {Which.ALL, Which.AROUND} and origin.scope != "site":
                found += self._joined(origin, need, task)
            else:
                found.append(Task(origin.name, self._subject(origin, need, task)))
        return list(dict.fromkeys(found))

    def stages(self) -> list[Stage]:
        """The stages that take part tonight."""
        return list(self._stages)

    def _tasks(self, stage: Stage) -> list[Task]:
        if stage.scope == "camera":
            return [Task(stage.name, (camera.id,)) for camera in self.site.cameras]
        if stage.scope == "pair":
            return [Task(stage.name, pair) for pair in self._pairs() or ()]
        if stage.component_parameter:
            return [Task(stage.name, ())] + [Task(stage.name, (component_name(k),)) for k in range(1, self._components())]
        return [Task(stage.name, ())]

    def _listed(self, role: Role) -> list[Any] | None:
        """What a site-wide stage lists (see `Stage.lists`); None where its task is not settled yet."""
        stage = stage_with(role)
        state = self.states.get(Task(stage.name))
        if state is None:
            return None
        return list(state.receipt.figures.get(stage.lists, ())) if state.usable and state.receipt else []

    def _pairs(self) -> list[tuple[str, str]] | None:
        listed = self._listed(Role.PAIR_GRAPH)
        return None if listed is None else [tuple(pair) for pair in listed]

    def _components(self) -> int:
        """Into how many worlds of at least two cameras the site falls, as far as is known."""
        return sum(len(group) > 1 for group in self._listed(Role.WORLD) or ())

    def _settle(self, stage: Stage, task: Task) -> None:
        try:
            spec = self._spec(stage, task)
        except Waiting as waiting:
            self.waiting[task] = waiting.task
            return
        except Impossible as impossible:
            self.states[task] = State(stage.missing, str(impossible), impossible.code)
            return
        preimage = spec.preimage()
        receipt = None if spec.force else self.cache.find(preimage, preimage.key())
        if receipt is None:
            self.ready[task] = spec
            return
        self.states[task] = cached_state(receipt)
        picture = spec.picture if receipt.file else None
        if picture and not is_drawn(self.cache, task, receipt.key, picture.digest(receipt.key)):
            self.undrawn[task] = dataclasses.replace(spec, redraw=receipt)

    def _spec(self, stage: Stage, task: Task, among: set[Task] | None = None) -> TaskSpec:
        """The spec of a task; inputs made by tasks `among` may still be unresolved."""
        bound = self._bound(stage)
        inputs = self._inputs(stage, task, bound.needs, among or set())
        stated = self._stated_parameters(stage, task)
        return TaskSpec(
            task,
            bound.function.dotted,
            bound.code,
            bound.defaults() | stated,
            inputs,
            stage.table,
            self._picture(stage, task, inputs, among or set()),
            bool(self.force & {task.stage, str(task)}),
            {name: text for name, text in bound.left_to_function().items() if name not in stated},
            folder=self.site.file.resolve().parent,
        )

    def _picture(self, stage: Stage, task: Task, inputs: dict[str, Input], among: set[Task]) -> PictureSpec | None:
        """How a task's result is shown: with those of its inputs that the function asks for."""
        if not stage.picture:
            return None
        info = self._read(stage.picture.function)
        result, *asked = (argument.name for argument in info.signature.arguments)
        drawn: dict[str, Input] = {}
        for name in asked:
            if name in stage.picture.needs:
                try:
                    drawn[name] = self._input(stage, task, stage.picture.needs[name], among)
                except (Waiting, Impossible):
                    drawn[name] = Absent()
            elif name in inputs:
                drawn[name] = inputs[name]
        return PictureSpec(info.dotted, info.code, result, drawn)

    def _bound(self, stage: Stage) -> Binding:
        if stage.name not in self._bindings:
            settings = self.site.stages.get(stage.name)
            use, values = (settings.use, settings.parameters) if settings else (None, {})
            self._bindings[stage.name] = bind(stage, use, values, self.site.reader)
        return self._bindings[stage.name]

    def _stated_parameters(self, stage: Stage, task: Task) -> dict[str, Any]:
        """Parameters that the site file sets, in the stage's section or elsewhere."""
        values: dict[str, Any] = dict(self.site.pairs) if stage.pair_settings else {}
        values |= {name: getattr(self.site, name) for name in stage.site_parameters}
        numbers = range(1, self._components())
        values[stage.component_parameter] = next((k for k in numbers if task.subject == (component_name(k),)), 0)
        known = self._bound(stage).parameters
        settings = self.site.stages.get(stage.name)
        return {name: v for name, v in values.items() if name in known} | (settings.parameters if settings else {})

    def _inputs(self, stage: Stage, task: Task, needs: Mapping[str, Need], among: set[Task]) -> dict[str, Input]:
        """All inputs of a task by argument name.  Raises Waiting, Impossible."""
        found: dict[str, Input] = {}
        impossible: dict[str, Impossible] = {}
        for name, need in needs.items():
            try:
                found[name] = self._input(stage, task, need, among)
            except Impossible as error:
                if not (isinstance(need, FromStage) and need.unless):
                    raise
                found[name], impossible[name] = Absent(), error
        for name, why in impossible.items():
            need = needs[name]
            if isinstance(need, FromStage) and any(isinstance(found.get(other, Absent()), Absent) for other in need.unless):
                raise why
        return found

    def _input(self, stage: Stage, task: Task, need: Need, among: set[Task]) -> Input:
        if isinstance(need, FromSite):
            return self._from_site(need, task)
        if need.unless_posed and self.site.posed:
            return Joined({})
        origin = stage_named(need.stage)
        if need.which in {Which.ALL, Which.AROUND}:
            return self._join(origin, need, task)
        part = need.part
        if part and origin.scope == "site" and stage.scope != "site":
            camera = self._side(need, task)
            part = dataclasses.replace(part, entry="--".join(camera or task.subject))
        return self._stored(Task(origin.name, self._subject(origin, need, task)), need, part, among)

    @staticmethod
    def _side(need: FromStage, task: Task) -> Subject:
        """The left or right camera of a pair, where one of them is meant."""
        return {Which.LEFT: task.subject[:1], Which.RIGHT: task.subject[1:]}.get(need.which, ())

    def _subject(self, origin: Stage, need: FromStage, task: Task) -> Subject:
        """Of which subject an input is that is not joined."""
        if origin.scope == "site":
            return ()
        return task.subject if need.which is Which.SAME else self._side(need, task)

    def _stored(self, upstream: Task, need: FromStage, part: Part | None, among: set[Task]) -> Input:
        if upstream in among:
            return Stored(upstream, part)
        if need.optional and stage_named(upstream.stage) not in self._stages:
            return Absent()
        state = self.states.get(upstream)
        if state is None:
            raise Waiting(upstream)
        if not state.usable or state.receipt is None:
            if need.optional:
                return Absent()
            raise because(upstream, state)
        if part and str(part) not in state.receipt.parts:
            if need.optional:
                return Absent()
            raise Impossible(f"{upstream} has nothing for {part.entry or part.field}", Cause.UNSOLVED)
        return Stored(upstream, part).resolved(self.cache, state.receipt)

    def _join(self, origin: Stage, need: FromStage, task: Task) -> Input:
        if origin not in self._stages and need.optional:
            return Joined({})
        if not self.pairs_known() and (origin.scope == "pair" or need.which is Which.AROUND):
            raise Waiting(None)
        if origin.scope == "site":
            return self._entries(origin, need, task)
        items: dict[Subject, Value | Stored] = {}
        faults: list[Impossible] = []
        for upstream in self._joined(origin, need, task):
            state = self.states.get(upstream)
            if state is None:
                raise Waiting(upstream)
            if state.usable and state.receipt and (not need.part or str(need.part) in state.receipt.parts):
                items[upstream.subject] = Stored(upstream, need.part).resolved(self.cache, state.receipt)
            else:
                faults.append(because(upstream, state))
        if not items and not need.optional and not (need.empty_if_stated and self.site.some_stated):
            raise self._nothing(origin, faults)
        return Joined(items)

    def _entries(self, origin: Stage, need: FromStage, task: Task) -> Input:
        """The entries of a mapping, made by a site-wide stage, of the cameras around the one in question."""
        assert need.part
        items: dict[Subject, Value | Stored] = {}
        for camera in self._around(task.subject[0]):
            part = dataclasses.replace(need.part, entry=camera)
            stored = self._stored(Task(origin.name), dataclasses.replace(need, optional=True), part, set())
            if isinstance(stored, Stored):
                items[camera,] = stored
        if not items:
            raise because(Task(origin.name), self.states[Task(origin.name)])
        return Joined(items)

    def _around(self, camera: str) -> list[str]:
        """The cameras that one makes pairs with, in the order of the site file."""
        around = {c for pair in self._pairs() or () if camera in pair for c in pair} - {camera}
        return [c.id for c in self.site.cameras if c.id in around]

    def _nothing(self, origin: Stage, faults: list[Impossible]) -> Impossible:
        """Why a stage that joins many has none to join."""
        frame, graph = stage_with(Role.FRAME).name, Task(stage_with(Role.PAIR_GRAPH).name)
        first = f": {faults[0]}" if faults else ""
        usable = [c.id for c in self.site.cameras if (state := self.states.get(Task(frame, (c.id,)))) and state.usable]
        if len(usable) < 2:
            have = f"only camera {usable[0]} has" if usable else "no camera has"
            why = f"{have} a usable capture, a cloud needs two that see the same things{first}"
            return Impossible(why, Cause.TOO_FEW_CAMERAS)
        pairs = self.states.get(graph)
        if origin.scope == "pair" and not faults:
            if pairs and not pairs.usable:
                return because(graph, pairs)
            return Impossible("no two cameras share enough to be matched", Cause.NO_PAIRS)
        return Impossible(f"no {origin.name} to work on{first}", faults[0].code if faults else Cause.UPSTREAM)

    def _joined(self, origin: Stage, need: FromStage, task: Task) -> list[Task]:
        """The tasks whose artifacts an input joins."""
        if need.which is Which.ALL:
            return self._tasks(origin)
        camera = task.subject[0]
        if origin.scope == "pair":
            return [t for t in self._tasks(origin) if camera in t.subject]
        return [Task(origin.name, (c,)) for c in self._around(camera)]

    def _from_site(self, need: FromSite, task: Task) -> Input:
        what = need.value
        if what is SiteValue.SURVEY:
            return Value(SITE_TYPES[what], plain(self.site.survey))
        if need.which is Which.ALL:
            return Joined({(camera.id,): self._stated(camera, what) for camera in self.site.cameras})
        camera = self._camera(task.subject[0])
        if what is SiteValue.MASK:
            file = self.masks.get(camera.id)
            return Files(SITE_TYPES[what], (file,), single=True) if file else Absent()
        if what is SiteValue.CAPTURES:
            return Files(SITE_TYPES[what], self._captured(camera))
        return self._stated(camera, what)

    @staticmethod
    def _stated(camera: SiteCamera, what: SiteValue) -> Value:
        """What the site file says of a camera."""
        return Value(SITE_TYPES[what], plain(camera.lens if what is SiteValue.LENS else camera.placement))

    def _captured(self, camera: SiteCamera) -> tuple[CaptureFile, ...]:
        """A camera's files that can be read."""
        files = self.captures[camera.id]
        if not files:
            raise Impossible(f"no capture: there is no file {self.expectations.get(camera.id, 'for it')}", Cause.NO_CAPTURE)
        readable = tuple(file for file in files if file.digest)
        if not readable:
            raise Impossible(f"no capture: {files[0].name} cannot be read", Cause.NO_CAPTURE)
        return readable

    def _camera(self, camera: str) -> SiteCamera:
        return next(c for c in self.site.cameras if c.id == camera)
