"""The tasks of a site, and the origin of their inputs: earlier tasks, the site file, the captures, the reference."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING

from ..pipeline.stages import DENSE_PAIRS, FRAMES, FUSE, HEALTH, PAIRS, POSES, Source, Stage, stage_named
from ..pipeline.summaries import PairsSummary, PosesSummary
from ..site.captures import CaptureFile, file_of_stage
from ..site.models import Camera, Site
from ..task import Subject, Task, component_name
from .spec import Absent, Files, Input, Joined, Part, Stored, Value, own_subject, site_input, site_inputs, subject_of
from .state import Cause, Impossible, State, Waiting, blocked_by, summary_of

if TYPE_CHECKING:
    from .planner import Plan

_MOST_NEAR = 8
"""`Subjects.near` adds cameras up to this number: they show more of the surface, but each is one more image to read."""


@dataclass
class Subjects:
    """The cameras of a site; its pairs, once the pair graph is known; and its components, once the poses are known.

    If dense pairs are chosen after the cameras are placed, dense stages work on these; if that choice failed, they work on the
    matched pairs.
    """

    site: Site
    states: dict[Task, State]
    """States of the tasks that have ended; the plan's own dictionary, which changes."""
    dense_chosen: bool = False
    """Does the stage `dense_pairs` take part?"""
    _graphs: dict[Task, _PairGraph] = field(default_factory=dict, repr=False)

    def tasks(self, stage: Stage) -> list[Task]:
        """The tasks of a stage."""
        if stage.scope == "camera":
            return [Task(stage.name, (view.id,)) for view in self.site.views]
        if stage.scope == "pair":
            return [Task(stage.name, pair) for pair in self.pairs(stage.dense) or ()]
        components = range(1, self.components()) if stage.name == FUSE else ()
        return [Task(stage.name), *(Task(stage.name, (component_name(k),)) for k in components)]

    def pairs(self, dense: bool = False) -> list[tuple[str, str]] | None:
        """The pairs that are matched, or the dense pairs; None while they are unknown."""
        graph = self._graph(dense)
        return None if graph is None else graph.pairs

    def is_unmatched(self, task: Task) -> bool:
        """Does the stage not work on this pair, because the pair was chosen for dense matching without having been matched?"""
        graph = self._graph(dense=False) if self.dense_chosen and len(task.subject) == 2 else None
        return graph is not None and not stage_named(task.stage).dense and task.subject not in graph.of.get(task.subject[0], ())

    def components(self) -> int:
        """The number of components with at least two placed cameras; 0 while the poses are unknown."""
        state = self.states.get(Task(POSES))
        return sum(len(group) > 1 for group in summary_of(state, PosesSummary).components) if state and state.usable else 0

    def around(self, camera: str) -> list[str]:
        """A camera's partners in dense pairs, in the order of the site file."""
        graph = self._graph(dense=True)
        around = {c for pair in graph.of.get(camera, ()) for c in pair} - {camera} if graph else set()
        return sorted(around, key=self._position.__getitem__)

    def near(self, camera: str) -> list[str]:
        """A camera's partners in dense pairs and, up to `_MOST_NEAR` in all, the cameras with the most dense pairs with these
        partners; in the order of the site file."""
        partners = self.around(camera)
        counts = Counter(other for partner in partners for other in self.around(partner))
        candidates = sorted(counts.keys() - {camera, *partners}, key=lambda other: (-counts[other], self._position[other]))
        return sorted([*partners, *candidates[: max(0, _MOST_NEAR - len(partners))]], key=self._position.__getitem__)

    def joined(self, origin: Stage, need: Source, task: Task) -> list[Task]:
        """The tasks whose artifacts, or entries of one, form a mapping input."""
        if need.of == "every":
            return self.tasks(origin)
        camera = task.subject[0]
        if origin.scope == "pair":
            graph = self._graph(origin.dense)
            return [Task(origin.name, pair) for pair in graph.of.get(camera, ())] if graph else []
        return [Task(origin.name, (c,)) for c in (self.near(camera) if need.of == "near" else self.around(camera))]

    def camera(self, camera: str) -> Camera:
        """The site's entry for a camera with one view, or for a view."""
        return self.site.views[self._position[camera]]

    @cached_property
    def _position(self) -> dict[str, int]:
        """Position of each view in the order of the site file."""
        return {view.id: k for k, view in enumerate(self.site.views)}

    def _graph(self, dense: bool) -> _PairGraph | None:
        """The pair graph, indexed once for each result of its task; None while the task has not ended."""
        task = Task(DENSE_PAIRS if dense and self.dense_chosen else PAIRS)
        state = self.states.get(task)
        if state is None:
            return None
        if task.stage == DENSE_PAIRS and not state.usable:
            return self._graph(dense=False)
        if task not in self._graphs or self._graphs[task].state is not state:
            pairs = list(summary_of(state, PairsSummary).pairs) if state.usable else []
            self._graphs[task] = graph = _PairGraph(state, pairs)
            for pair in pairs:
                for camera in pair:
                    graph.of.setdefault(camera, []).append(pair)
        return self._graphs[task]


@dataclass
class _PairGraph:
    """The pairs of a night: the matched ones, or the dense ones."""

    state: State
    pairs: list[tuple[str, str]]
    of: dict[str, list[tuple[str, str]]] = field(default_factory=dict)
    """Pairs by camera."""


@dataclass
class Inputs:
    """Finds the inputs of a night's tasks."""

    plan: Plan
    """The plan of the night; its states, subjects and reference change during the run."""
    stages: Collection[str]
    """Names of the stages that take part tonight."""

    def inputs_of(self, task: Task, needs: Mapping[str, Source], earlier: set[Task]) -> dict[str, Input]:
        """All inputs of a task by argument name.  Raises Waiting if one is not ready, Impossible if one cannot be made.

        earlier: tasks before it in the same chain; inputs from these are not resolved yet.
        """
        inputs: dict[str, Input] = {}
        faults: dict[str, Impossible] = {}
        for name, need in needs.items():
            try:
                inputs[name] = self.input_of(task, need, earlier)
            except Impossible as error:
                if not need.unless:
                    raise
                inputs[name], faults[name] = Absent(), error
        for name, fault in faults.items():
            if any(isinstance(inputs.get(other, Absent()), Absent) for other in needs[name].unless):
                raise fault
        return inputs

    def input_of(self, task: Task, need: Source, earlier: set[Task]) -> Input:
        """One input of a task; parameters and exceptions as for `inputs_of`."""
        if need.kind == "site":
            return self._from_site(need, task)
        if need.kind == "file":
            return self._named_file(need.name, file_of_stage(task.stage, need.name))
        if need.kind == "reference":
            return self.plan.resolver.input(need, task)
        if need.kind == "history":
            return self.plan.resolver.history_input(need, task)
        if need.needed_if and not need.needed_if(self.plan.site):
            return Joined({})
        origin = stage_named(need.name)
        if need.joins:
            return self._join(origin, need, task)
        is_site_wide = stage_named(task.stage).scope == "site"
        entry = "--".join(own_subject(need, task)) if origin.scope == "site" and not is_site_wide else None
        part = Part(need.part, entry) if need.part else None
        return self._stored(Task(origin.name, subject_of(origin, need, task)), need, part, earlier)

    def upstreams(self, task: Task, needs: Mapping[str, Source]) -> list[Task]:
        """The tasks that provide the inputs of a task, as far as they are listed yet."""
        upstreams: list[Task] = []
        for need in needs.values():
            not_needed = need.kind != "stage" or (need.needed_if and not need.needed_if(self.plan.site))
            if not_needed or (need.may_lack(self.plan.site) and need.name not in self.stages):
                continue
            origin = stage_named(need.name)
            if need.joins and origin.scope != "site":
                upstreams += self.plan.subjects.joined(origin, need, task)
            else:
                upstreams.append(Task(origin.name, subject_of(origin, need, task)))
        return list(dict.fromkeys(upstreams))

    def _stored(self, upstream: Task, need: Source, part: Part | None, earlier: set[Task] | None = None) -> Input:
        if earlier and upstream in earlier:
            return Stored(upstream, part)
        if need.optional and upstream.stage not in self.stages:
            return Absent()
        state = self.plan.states.get(upstream)
        if state is None and not self.plan.subjects.is_unmatched(upstream):
            raise Waiting(upstream)
        if state and state.usable and state.receipt and (part is None or str(part) in state.receipt.parts):
            return Stored(upstream, part).resolved(state.receipt)
        if need.may_lack(self.plan.site):
            return Absent()
        if state is None:
            raise Impossible(f"{'--'.join(upstream.subject)} was not matched", Cause.NO_PAIRS)
        if state.usable and part:
            raise Impossible(f"{upstream} has nothing for {part.entry or part.field}", Cause.UNSOLVED)
        raise blocked_by(upstream, state)

    def _join(self, origin: Stage, need: Source, task: Task) -> Input:
        """The results of many tasks, or many entries of a site-wide result, by subject."""
        if need.may_lack(self.plan.site) and need.name not in self.stages:
            return Joined({})
        needs_pairs = origin.scope == "pair" or need.of in {"around", "near"}
        if needs_pairs and self.plan.subjects.pairs(origin.dense or origin.scope != "pair") is None:
            raise Waiting(None)
        joined = self.plan.subjects.joined(origin, need, task)
        if origin.scope == "site":
            return self._entries(origin, need, joined)
        for upstream in reversed(joined):  # the last in the list is usually the last to end
            if upstream not in self.plan.states:
                raise Waiting(upstream)
        items: dict[Subject, Value | Stored] = {}
        faults: list[Impossible] = []
        part = Part(need.part) if need.part else None
        useless = self.plan.resolver.useless() if task.stage != HEALTH else frozenset()
        for upstream in joined:
            state = self.plan.states[upstream]
            if useless & set(upstream.subject):
                faults.append(self.plan.resolver.unfit_error(upstream.subject))
            elif state.usable and state.receipt and (part is None or str(part) in state.receipt.parts):
                items[upstream.subject] = Stored(upstream, part).resolved(state.receipt)
            else:
                faults.append(blocked_by(upstream, state))
        if not items and not need.may_lack(self.plan.site):
            raise self._why_empty(origin, faults)
        return Joined(items)

    def _entries(self, origin: Stage, need: Source, joined: list[Task]) -> Input:
        """The entries for some cameras in a mapping from a site-wide stage."""
        optional_need, site_task = replace(need, optional=True), Task(origin.name)
        inputs = {task.subject: self._stored(site_task, optional_need, Part(need.part, task.subject[0])) for task in joined}
        items: dict[Subject, Value | Stored] = {subject: item for subject, item in inputs.items() if isinstance(item, Stored)}
        if not items:
            raise blocked_by(site_task, self.plan.states[site_task])
        return Joined(items)

    def _why_empty(self, origin: Stage, faults: list[Impossible]) -> Impossible:
        """Why a mapping input has no entries."""
        first_fault = f": {faults[0]}" if faults else ""
        frames = {view.id: self.plan.states.get(Task(FRAMES, (view.id,))) for view in self.plan.site.views}
        usable = list(dict.fromkeys(view.camera for view in self.plan.site.views if (state := frames[view.id]) and state.usable))
        if len(usable) < 2:
            reason = f"no camera has a usable capture{first_fault}"
            if usable:
                reason = f"only camera {usable[0]} has a usable capture, a cloud needs two that see the same things{first_fault}"
            elif all(state and state.code == Cause.NO_CAPTURE for state in frames.values()):
                reason = f"no camera has a usable capture: there is none of this night in {self.plan.site.captures.root}"
            return Impossible(reason, Cause.TOO_FEW_CAMERAS)
        pairs = self.plan.states.get(Task(PAIRS))
        if origin.scope == "pair" and not faults:
            if pairs and not pairs.usable:
                return blocked_by(Task(PAIRS), pairs)
            return Impossible("no two cameras see enough in common to be matched", Cause.NO_PAIRS)
        return Impossible(f"no {origin.name} to work on{first_fault}", faults[0].code if faults else Cause.UPSTREAM)

    def _from_site(self, need: Source, task: Task) -> Input:
        name = need.name
        if name == "survey" or need.of == "every":
            return site_inputs(self.plan.site, name)
        camera = self.plan.subjects.camera(task.subject[0])
        if name == "mask":
            return self._named_file("mask", camera.camera)
        if name == "privacy" and not camera.privacy:
            return Absent()
        if name == "captures":
            return Files(self._readable_captures(camera))
        return site_input(camera, name)

    def _named_file(self, kind: str, key: str) -> Input:
        """A file that the site file names.  kind: such as "mask", for the message; key: its key in `Plan.named_files`."""
        file = self.plan.named_files.get(key)
        if file and not file.digest:
            raise Impossible(f"{kind} {file.name} {file.fault}", Cause.BAD_INPUT)
        return Files((file,), single=True) if file else Absent()

    def _readable_captures(self, camera: Camera) -> tuple[CaptureFile, ...]:
        files = self.plan.captures[camera.camera]
        if not files:
            raise Impossible(f"no capture: {self.plan.missing.get(camera.camera, 'there is no file for it')}", Cause.NO_CAPTURE)
        readable = tuple(file for file in files if file.digest)
        if not readable:
            raise Impossible(f"no capture: {files[0].name} {files[0].fault}", Cause.NO_CAPTURE)
        return readable
