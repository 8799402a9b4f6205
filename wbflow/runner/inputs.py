"""Where the inputs of a task come from: from tasks that are settled, from the site file and the captures, from the reference."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field

from ..cache.store import Receipt
from ..pipeline.stages import FRAMES, HEALTH, PAIRS, SITE_TYPES, Source, Stage, stage_named
from ..reference.resolve import Pinned
from ..site.models import Camera, Site
from ..task import Subject, Task
from .captures import CaptureFile, file_of_stage
from .spec import Absent, Files, Input, Joined, Part, Stored, Value, side, stated, stated_of_site, subject_of
from .state import Cause, Impossible, State, Waiting, because
from .subjects import Subjects


@dataclass
class Inputs:
    """Finds the inputs of a night's tasks."""

    site: Site
    captures: dict[str, list[CaptureFile]]
    named: dict[str, CaptureFile]
    expectations: dict[str, str]
    subjects: Subjects
    stages: Collection[str]
    """Names of those that take part tonight."""
    states: dict[Task, State]
    """Settled tasks: the plan's own, which it changes."""
    pinned: Pinned
    _resolved: dict[tuple[Task, Part | None], tuple[Receipt, Stored]] = field(default_factory=dict, repr=False)
    """Inputs that were found before, and the receipts that they are of: a frame is an input of many tasks."""

    def of(self, stage: Stage, task: Task, needs: Mapping[str, Source], among: set[Task]) -> dict[str, Input]:
        """All inputs of a task by argument name.

        Parameters
        ----------
        stage, task : Stage, Task
            Whose.
        needs : mapping
            What it needs, by argument name.
        among : set of Task
            Inputs made by these may still be unresolved.

        Raises
        ------
        Waiting, Impossible
            One depends on what is not settled yet, or will not come.
        """
        found: dict[str, Input] = {}
        impossible: dict[str, Impossible] = {}
        for name, need in needs.items():
            try:
                found[name] = self.one(stage, task, need, among)
            except Impossible as error:
                if not need.unless:
                    raise
                found[name], impossible[name] = Absent(), error
        for name, why in impossible.items():
            need = needs[name]
            if any(isinstance(found.get(other, Absent()), Absent) for other in need.unless):
                raise why
        return found

    def one(self, stage: Stage, task: Task, need: Source, among: set[Task]) -> Input:
        """An input of a task.

        Parameters
        ----------
        stage, task : Stage, Task
            Whose.
        need : Source
            What it needs.
        among : set of Task
            An input made by one of these may still be unresolved.

        Raises
        ------
        Waiting, Impossible
            It depends on what is not settled yet, or will not come.
        """
        if need.kind == "site":
            return self._from_site(need, task)
        if need.kind == "file":
            return self._named(need.name, file_of_stage(task.stage, need.name))
        if need.kind == "reference":
            return self.pinned.input(need, stage, task)
        if need.kind == "history":
            return self.pinned.observed(need, task)
        if self._needless(need):
            return Joined({})
        origin = stage_named(need.name)
        if need.joins:
            return self._join(origin, need, task)
        entry = "--".join(side(need, task) or task.subject) if origin.scope == "site" and stage.scope != "site" else None
        part = Part(need.part, entry) if need.part else None
        return self._stored(Task(origin.name, subject_of(origin, need, task)), need, part, among)

    def upstreams(self, task: Task, needs: Mapping[str, Source]) -> list[Task]:
        """The tasks that a task takes its inputs from, as far as they are listed yet."""
        found: list[Task] = []
        for need in needs.values():
            if need.kind != "stage" or self._needless(need):
                continue
            origin = stage_named(need.name)
            if need.may_lack(self.site) and need.name not in self.stages:
                continue
            if need.joins and origin.scope != "site":
                found += self.subjects.joined(origin, need, task)
            else:
                found.append(Task(origin.name, subject_of(origin, need, task)))
        return list(dict.fromkeys(found))

    def _needless(self, need: Source) -> bool:
        """Does what the site file says make it an empty mapping?"""
        return need.needed_if is not None and not need.needed_if(self.site)

    def _stored(self, upstream: Task, need: Source, part: Part | None, among: set[Task]) -> Input:
        if upstream in among:
            return Stored(upstream, part)
        if need.optional and upstream.stage not in self.stages:
            return Absent()
        state = self.states.get(upstream)
        if state is None:
            if not self.subjects.unmatched(upstream):
                raise Waiting(upstream)
            if need.may_lack(self.site):
                return Absent()
            raise Impossible(f"{'--'.join(upstream.subject)} was not matched", Cause.NO_PAIRS)
        if not state.usable or state.receipt is None:
            if need.may_lack(self.site):
                return Absent()
            raise because(upstream, state)
        if part and str(part) not in state.receipt.parts:
            if need.may_lack(self.site):
                return Absent()
            raise Impossible(f"{upstream} has nothing for {part.entry or part.field}", Cause.UNSOLVED)
        return self._found(upstream, part, state.receipt)

    def _found(self, upstream: Task, part: Part | None, receipt: Receipt) -> Stored:
        known = self._resolved.get((upstream, part))
        if known is None or known[0] is not receipt:
            known = receipt, Stored(upstream, part).resolved(receipt)
            self._resolved[upstream, part] = known
        return known[1]

    def _join(self, origin: Stage, need: Source, task: Task) -> Input:
        if need.may_lack(self.site) and need.name not in self.stages:
            return Joined({})
        of_pairs = origin.scope == "pair" or need.of in {"around", "near"}
        if of_pairs and self.subjects.pairs(origin.dense or origin.scope != "pair") is None:
            raise Waiting(None)
        if origin.scope == "site":
            return self._entries(origin, need, task)
        items: dict[Subject, Value | Stored] = {}
        faults: list[Impossible] = []
        joined, part = self.subjects.joined(origin, need, task), Part(need.part) if need.part else None
        for upstream in reversed(joined):  # most are settled in order: who waits for the last one is not asked for each
            if upstream not in self.states:
                raise Waiting(upstream)
        useless = self.pinned.useless() if task.stage != HEALTH else frozenset()
        for upstream in joined:
            state = self.states[upstream]
            if useless & set(upstream.subject):
                faults.append(self.pinned.unfit(upstream.subject))
            elif state.usable and state.receipt and (part is None or str(part) in state.receipt.parts):
                items[upstream.subject] = self._found(upstream, part, state.receipt)
            else:
                faults.append(because(upstream, state))
        if not items and not need.may_lack(self.site):
            raise self._nothing(origin, faults)
        return Joined(items)

    def _entries(self, origin: Stage, need: Source, task: Task) -> Input:
        """The entries of a mapping, made by a site-wide stage, of the cameras around the one in question, or near it."""
        items: dict[Subject, Value | Stored] = {}
        optional = dataclasses.replace(need, optional=True)
        for camera in self.subjects.among(need.of, task.subject[0]):
            stored = self._stored(Task(origin.name), optional, Part(need.part, camera), set())
            if isinstance(stored, Stored):
                items[camera,] = stored
        if not items:
            raise because(Task(origin.name), self.states[Task(origin.name)])
        return Joined(items)

    def _nothing(self, origin: Stage, faults: list[Impossible]) -> Impossible:
        """Why a stage that joins many has none to join."""
        frame, graph = FRAMES, Task(PAIRS)
        first = f": {faults[0]}" if faults else ""
        frames = {view.id: self.states.get(Task(frame, (view.id,))) for view in self.site.views}
        views = [view for view in self.site.views if (state := frames[view.id]) and state.usable]
        usable = list(dict.fromkeys(view.camera for view in views))
        if len(usable) < 2:
            why = f"no camera has a usable capture{first}"
            if usable:
                why = f"only camera {usable[0]} has a usable capture, a cloud needs two that see the same things{first}"
            elif all(state and state.code == Cause.NO_CAPTURE for state in frames.values()):
                why = f"no camera has a usable capture: there is none of this night in {self.site.root}"
            return Impossible(why, Cause.TOO_FEW_CAMERAS)
        pairs = self.states.get(graph)
        if origin.scope == "pair" and not faults:
            if pairs and not pairs.usable:
                return because(graph, pairs)
            return Impossible("no two cameras share enough to be matched", Cause.NO_PAIRS)
        return Impossible(f"no {origin.name} to work on{first}", faults[0].code if faults else Cause.UPSTREAM)

    def _from_site(self, need: Source, task: Task) -> Input:
        what = need.name
        if what == "survey" or need.of == "every":
            return stated_of_site(self.site, what)
        camera = self.subjects.camera(task.subject[0])
        if what == "mask":
            return self._named("mask", camera.camera)
        if what == "privacy" and not camera.privacy.counts:
            return Absent()
        if what == "captures":
            return Files(SITE_TYPES[what], self._captured(camera))
        return stated(camera, what)

    def _named(self, words: str, key: str) -> Input:
        """A file that the site file names.  words: what it is."""
        file = self.named.get(key)
        if file and not file.digest:
            raise Impossible(f"{words} {file.name} {file.fault}", Cause.BAD_INPUT)
        return Files(SITE_TYPES["captures"], (file,), single=True) if file else Absent()

    def _captured(self, camera: Camera) -> tuple[CaptureFile, ...]:
        """A camera's files that can be read."""
        files = self.captures[camera.camera]
        if not files:
            raise Impossible(f"no capture: there is no file {self.expectations.get(camera.camera, 'for it')}", Cause.NO_CAPTURE)
        readable = tuple(file for file in files if file.digest)
        if not readable:
            raise Impossible(f"no capture: {files[0].name} {files[0].fault}", Cause.NO_CAPTURE)
        return readable
