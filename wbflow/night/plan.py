"""The plan: every task of a site with its state, derived again and again from the table of stages, the captures and the cache.

A task is settled (cached, ran, rejected, failed, skipped), ready, or waiting for others.  Nothing is stored: a plan made after
a crash finds in the cache exactly what was finished.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from ..config.load import Site, SiteCamera
from ..graph.functions import FunctionInfo
from ..graph.pipeline import STAGES, Need, Stage, ancestors, stage_named
from ..store import artifact
from ..store.cache import Cache, Preimage, Receipt
from ..task import Subject, Task
from .captures import CaptureFile, expected

Outcome = Literal["cached", "ran", "rejected", "failed", "skipped"]


@dataclass(frozen=True)
class Value:
    """An input given by the site file: a dataclass of the stages (`kind`, dotted) made from plain values."""

    kind: str
    plain: dict[str, Any]

    def digest(self) -> str:
        return artifact.digest(json.dumps([self.kind, self.plain], sort_keys=True).encode())


@dataclass(frozen=True)
class Files:
    """An input read from files as they are; single: one file rather than a list."""

    kind: str
    files: tuple[CaptureFile, ...]
    single: bool = False

    def digest(self) -> str:
        return artifact.digest(json.dumps([f.digest for f in self.files]).encode())


@dataclass(frozen=True)
class Stored:
    """An input made by another task: an artifact on disk, or a part of it; no path while a task of the same lane makes it."""

    task: Task
    part: str = ""
    path: Path | None = None
    file_digest: str = ""
    content: str = ""

    def digest(self) -> str:
        return self.content

    def resolved(self, cache: Cache, receipt: Receipt) -> Stored:
        """The same input, now that its task is done."""
        content = receipt.parts[self.part] if self.part else receipt.digest
        return dataclasses.replace(self, path=cache.path(receipt), file_digest=receipt.digest, content=content)


@dataclass(frozen=True)
class Joined:
    """An input that maps each subject to its own (camera id, or a pair of ids)."""

    items: dict[Subject, Value | Stored]


@dataclass(frozen=True)
class Absent:
    """An optional input that is not there."""


Input = Value | Files | Stored | Joined | Absent


@dataclass(frozen=True)
class TaskSpec:
    """All that a worker needs to do a task."""

    task: Task
    function: str
    code: str
    parameters: dict[str, Any]
    inputs: dict[str, Input]
    suffix: str
    picture: str | None
    picture_inputs: dict[str, Input] = field(default_factory=dict)
    force: bool = False

    def preimage(self) -> Preimage:
        """All that determines the artifact; every input must be resolved."""
        digests: dict[str, str] = {}
        for name, value in self.inputs.items():
            if isinstance(value, Joined):
                digests |= {f"{name} {'--'.join(subject)}": item.digest() for subject, item in value.items.items()}
            else:
                digests[name] = "" if isinstance(value, Absent) else value.digest()
        return Preimage(self.task.stage, self.task.subject, self.function, self.code, self.parameters, digests)


@dataclass(frozen=True)
class State:
    """How a settled task ended.  reason: why, for all but cached and ran."""

    outcome: Outcome
    reason: str | None = None
    receipt: Receipt | None = None

    @property
    def usable(self) -> bool:
        """Did it leave an artifact?"""
        return self.outcome in {"cached", "ran"}


class _Waiting(Exception):
    """An input depends on `task`, which is not settled yet."""

    def __init__(self, task: Task | None) -> None:
        super().__init__(str(task))
        self.task = task


class _Impossible(Exception):
    """An input will not come; the message says why."""


@dataclass
class Plan:
    """The tasks of one night.

    states: settled tasks; ready: tasks whose inputs are all there, with their specs; waiting: the rest, with what they wait for
    (None: for the pair graph).  `refresh` derives all of it from the cache.
    """

    site: Site
    captures: dict[str, list[CaptureFile]]
    night: str
    cache: Cache
    masks: dict[str, CaptureFile] = field(default_factory=dict)
    expectations: dict[str, str] = field(default_factory=dict)
    until: str | None = None
    force: frozenset[str] = frozenset()
    states: dict[Task, State] = field(default_factory=dict)
    ready: dict[Task, TaskSpec] = field(default_factory=dict)
    waiting: dict[Task, Task | None] = field(default_factory=dict)
    _infos: dict[str, FunctionInfo] = field(default_factory=dict)
    _stages: list[Stage] = field(default_factory=list)

    def __post_init__(self) -> None:
        wanted = ancestors(self.until) if self.until else {stage.name for stage in STAGES}
        settings = self.site.stages
        self._stages = [s for s in STAGES if s.name in wanted and not (s.name in settings and not settings[s.name].enabled)]

    def refresh(self) -> None:
        """Settle what the cache has, and find what is ready."""
        self.ready, self.waiting = {}, {}
        for stage in self._stages:
            for task in self._tasks(stage):
                if task not in self.states:
                    self._settle(stage, task)

    def settle(self, task: Task, state: State) -> None:
        """Record how a task of this run ended."""
        self.states[task] = state

    def forget(self, task: Task) -> None:
        """Take a settled task back (its artifact turned out damaged)."""
        self.states.pop(task, None)

    def lanes(self) -> Iterator[list[TaskSpec]]:
        """Ready tasks, each with the tasks of the same subject that can follow it in the same worker call."""
        for task, spec in self.ready.items():
            lane = [spec]
            if task.subject:
                for stage in self._stages:
                    follower = Task(stage.name, task.subject)
                    if follower in self.waiting:
                        try:
                            lane.append(self._spec(stage, follower, among={s.task for s in lane}))
                        except (_Waiting, _Impossible):
                            continue
            yield lane

    def pairs_known(self) -> bool:
        """Is the pair graph there (so that every pair's tasks are listed)?"""
        return self._pairs() is not None

    def upstreams(self, task: Task) -> list[Task]:
        """The tasks that a task takes its inputs from, as far as they are listed yet."""
        found = []
        for need in stage_named(task.stage).needs.values():
            if need.origin.startswith("site:") or (need.unless_posed and self.site.posed):
                continue
            origin = stage_named(need.origin)
            if need.optional and origin not in self._stages:
                continue
            if need.which in {"all", "around"} and origin.scope != "site":
                found += self._joined(origin, need, task)
            elif need.which == "same" or origin.scope == "site":
                found.append(Task(origin.name, task.subject if origin.scope != "site" else ()))
            else:
                found.append(Task(origin.name, task.subject[:1] if need.which == "left" else task.subject[1:]))
        return list(dict.fromkeys(found))

    def stages(self) -> list[Stage]:
        """The stages that take part tonight."""
        return list(self._stages)

    def _tasks(self, stage: Stage) -> list[Task]:
        if stage.scope == "camera":
            return [Task(stage.name, (camera.id,)) for camera in self.site.cameras]
        if stage.scope == "pair":
            return [Task(stage.name, pair) for pair in self._pairs() or ()]
        if stage.settings == "component":
            return [Task(stage.name, ())] + [Task(stage.name, (component_name(k),)) for k in range(1, self._components())]
        return [Task(stage.name, ())]

    def _pairs(self) -> list[tuple[str, str]] | None:
        state = self.states.get(Task("pairs", ()))
        if state is None:
            return None
        return [tuple(pair) for pair in state.receipt.figures["pairs"]] if state.usable and state.receipt else []

    def _components(self) -> int:
        """Into how many worlds of at least two cameras the site falls, as far as is known."""
        state = self.states.get(Task("poses", ()))
        groups = state.receipt.figures.get("components", ()) if state and state.usable and state.receipt else ()
        return sum(len(group) > 1 for group in groups)

    def _settle(self, stage: Stage, task: Task) -> None:
        try:
            spec = self._spec(stage, task)
        except _Waiting as waiting:
            self.waiting[task] = waiting.task
            return
        except _Impossible as impossible:
            outcome: Outcome = "failed" if stage.name == "frames" else "skipped"
            self.states[task] = State(outcome, str(impossible))
            return
        preimage = spec.preimage()
        receipt = None if spec.force else self.cache.find(preimage, preimage.key())
        if receipt is None:
            self.ready[task] = spec
        else:
            self.states[task] = cached_state(receipt)

    def _spec(self, stage: Stage, task: Task, among: set[Task] | None = None) -> TaskSpec:
        """The spec of a task; inputs made by tasks `among` may still be unresolved."""
        info = self._info(stage)
        inputs = {name: self._input(stage, task, need, among or set()) for name, need in stage.needs.items()}
        forced = bool(self.force & {task.stage, str(task)})
        parameters = self._parameters(stage, info, task)
        drawn = {name: self._input(stage, task, need, set()) for name, need in stage.picture_needs.items()}
        return TaskSpec(task, info.dotted, info.code, parameters, inputs, stage.suffix, stage.picture, drawn, forced)

    def _info(self, stage: Stage) -> FunctionInfo:
        if stage.name not in self._infos:
            settings = self.site.stages.get(stage.name)
            self._infos[stage.name] = self.site.reader.read((settings and settings.use) or stage.function)
        return self._infos[stage.name]

    def _parameters(self, stage: Stage, info: FunctionInfo, task: Task) -> dict[str, Any]:
        values = {name: parameter.default for name, parameter in info.parameters.items()}
        if stage.settings == "pairs":
            values |= self.site.pairs
        if stage.settings == "resolution":
            values["resolution"] = self.site.resolution
        if stage.settings == "component" and "component" in values:
            values["component"] = next((k for k in range(1, self._components()) if task.subject == (component_name(k),)), 0)
        settings = self.site.stages.get(stage.name)
        return values | (settings.parameters if settings else {})

    def _input(self, stage: Stage, task: Task, need: Need, among: set[Task]) -> Input:
        if need.unless_posed and self.site.posed:
            return Joined({})
        if need.origin.startswith("site:"):
            return self._from_site(need, task)
        origin = stage_named(need.origin)
        if need.which in {"all", "around"}:
            return self._join(origin, need, task)
        subject: Subject = task.subject if need.which == "same" and origin.scope != "site" else ()
        camera = {"left": task.subject[:1], "right": task.subject[1:]}.get(need.which, ())
        if camera and origin.scope == "camera":
            subject = camera
        entry = "--".join(camera or (task.subject if stage.scope != "site" else ()))
        part = f"{need.part}[{entry}]" if need.part and entry and origin.scope == "site" else need.part
        return self._stored(Task(origin.name, subject), part, need, among)

    def _stored(self, upstream: Task, part: str, need: Need, among: set[Task]) -> Input:
        if upstream in among:
            return Stored(upstream, part)
        if need.optional and stage_named(upstream.stage) not in self._stages:
            return Absent()
        state = self.states.get(upstream)
        if state is None:
            raise _Waiting(upstream)
        if not state.usable or state.receipt is None:
            if need.optional:
                return Absent()
            raise _Impossible(_because(upstream, state))
        if part and part not in state.receipt.parts:
            if need.optional:
                return Absent()
            raise _Impossible(f"{upstream} has nothing for {part.partition('[')[2].removesuffix(']') or part}")
        return Stored(upstream, part).resolved(self.cache, state.receipt)

    def _join(self, origin: Stage, need: Need, task: Task) -> Input:
        if origin not in self._stages and need.optional:
            return Joined({})
        if not self.pairs_known() and (origin.scope == "pair" or need.which == "around"):
            raise _Waiting(None)
        if origin.scope == "site":
            return self._entries(origin, need, task)
        items: dict[Subject, Value | Stored] = {}
        faults = []
        for upstream in self._joined(origin, need, task):
            state = self.states.get(upstream)
            if state is None:
                raise _Waiting(upstream)
            if state.usable and state.receipt and (not need.part or need.part in state.receipt.parts):
                items[upstream.subject] = Stored(upstream, need.part).resolved(self.cache, state.receipt)
            else:
                faults.append(_because(upstream, state))
        if not items and not need.optional:
            raise _Impossible(self._nothing(origin, faults))
        return Joined(items)

    def _entries(self, origin: Stage, need: Need, task: Task) -> Input:
        """The entries of a mapping, made by a site-wide stage, of the cameras around the one in question."""
        items: dict[Subject, Value | Stored] = {}
        for camera in self._around(task.subject[0]):
            part = f"{need.part}[{camera}]"
            stored = self._stored(Task(origin.name, ()), part, dataclasses.replace(need, optional=True), set())
            if isinstance(stored, Stored):
                items[camera,] = stored
        if not items:
            raise _Impossible(_because(Task(origin.name, ()), self.states[Task(origin.name, ())]))
        return Joined(items)

    def _around(self, camera: str) -> list[str]:
        """The cameras that one makes pairs with, in the order of the site file."""
        around = {c for pair in self._pairs() or () if camera in pair for c in pair} - {camera}
        return [c.id for c in self.site.cameras if c.id in around]

    def _nothing(self, origin: Stage, faults: list[str]) -> str:
        """Why a stage that joins many has none to join."""
        usable = [c.id for c in self.site.cameras if (state := self.states.get(Task("frames", (c.id,)))) and state.usable]
        if len(usable) < 2:
            have = f"only camera {usable[0]} has" if usable else "no camera has"
            return f"{have} a usable capture, a cloud needs two that see the same things" + (f": {faults[0]}" if faults else "")
        pairs = self.states.get(Task("pairs", ()))
        if origin.scope == "pair" and not faults:
            return (
                _because(Task("pairs", ()), pairs) if pairs and not pairs.usable else "no two cameras share enough to be matched"
            )
        return f"no {origin.name} to work on" + (f": {faults[0]}" if faults else "")

    def _joined(self, origin: Stage, need: Need, task: Task) -> list[Task]:
        """The tasks whose artifacts an input joins."""
        if need.which == "all":
            return self._tasks(origin)
        camera = task.subject[0]
        if origin.scope == "pair":
            return [t for t in self._tasks(origin) if camera in t.subject]
        return [Task(origin.name, (c,)) for c in self._around(camera)]

    def _from_site(self, need: Need, task: Task) -> Input:
        what = need.origin.partition(":")[2]
        if what in {"lens", "placement"}:
            kind = f"wbflow_stages.types:{what.capitalize()}"
            cameras = self.site.cameras if need.which == "all" else [self._camera(task.subject[0])]
            values: dict[Subject, Value | Stored] = {(camera.id,): Value(kind, getattr(camera, what)) for camera in cameras}
            return Joined(values) if need.which == "all" else values[task.subject]
        if what == "survey":
            return Value("wbflow_stages.types:Survey", self.site.survey)
        camera = task.subject[0]
        if what == "mask":
            file = self.masks.get(camera)
            return Files("wbflow_stages.types:Capture", (file,), single=True) if file else Absent()
        files = self.captures[camera]
        if not files:
            raise _Impossible(f"no capture: there is no file {self.expectations.get(camera, 'for it')}")
        missing = [file for file in files if not file.digest]
        if len(missing) == len(files):
            raise _Impossible(f"no capture: {missing[0].name} cannot be read")
        return Files("wbflow_stages.types:Capture", tuple(file for file in files if file.digest))

    def _camera(self, camera: str) -> SiteCamera:
        return next(c for c in self.site.cameras if c.id == camera)


def make_plan(
    site: Site,
    captures: dict[str, list[CaptureFile]],
    date: Any,
    cache: Cache,
    masks: dict[str, CaptureFile],
    until: str | None = None,
    force: tuple[str, ...] = (),
) -> Plan:
    """A plan for one night, not yet refreshed."""
    expectations = {camera.id: expected(site, camera, date) for camera in site.cameras if not captures[camera.id]}
    return Plan(site, captures, str(date), cache, masks, expectations, until, frozenset(force))


def component_name(number: int) -> str:
    """What a component of cameras other than the main one is called: component-2 is the second."""
    return f"component-{number + 1}"


def cached_state(receipt: Receipt) -> State:
    """The state of a task whose receipt was found."""
    return State("rejected" if receipt.outcome == "rejected" else "cached", receipt.reason, receipt)


def _because(task: Task, state: State) -> str:
    ended = state.outcome if state.outcome == "failed" else f"was {state.outcome}"
    return f"{task} {ended}: {state.reason}" if state.reason else f"{task} {ended}"
