"""The tasks of a site, and the origin of their inputs: earlier tasks, the site file, the captures, the reference."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping, Set
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

from ..pipeline.stages import DENSE_PAIRS, FRAMES, FUSE, HEALTH, PAIRS, POSES, Source, Stage, stage_named
from ..pipeline.summaries import PairsSummary, PosesSummary
from ..site.captures import CaptureFile, file_of_stage
from ..site.models import Site
from ..task import Subject, Task, camera_of, component_name
from .spec import Files, Input, Joined, Stored, site_input, stored_input
from .state import Cause, Impossible, State, Waiting, blocked_by, summary_of

if TYPE_CHECKING:
    from .plan import Plan

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
            self._graphs[task] = _PairGraph(state)
        return self._graphs[task]


class _PairGraph:
    """The pairs of a night, also by camera: the matched ones, or the dense ones."""

    def __init__(self, state: State) -> None:
        """state: of the task that chose the pairs."""
        self.state = state
        self.pairs = list(summary_of(state, PairsSummary).pairs) if state.usable else []
        self.of: dict[str, list[tuple[str, str]]] = {}
        for pair in self.pairs:
            for camera in pair:
                self.of.setdefault(camera, []).append(pair)


@dataclass
class Inputs:
    """Finds the inputs of a night's tasks."""

    plan: Plan
    """The plan of the night; its states, subjects and reference change during the run."""
    stages: Collection[str]
    """Names of the stages that take part tonight."""

    def inputs_of(self, task: Task, needs: Mapping[str, Source], earlier: Set[Task]) -> dict[str, Input]:
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
                inputs[name], faults[name] = None, error
        for name, fault in faults.items():
            if any(inputs.get(other) is None for other in needs[name].unless):
                raise fault
        return inputs

    def input_of(self, task: Task, need: Source, earlier: Set[Task]) -> Input:
        """One input of a task; parameters and exceptions as for `inputs_of`."""
        if need.kind == "site":
            return self._from_site(need, task)
        if need.kind == "file":
            return self._named_file(need.name, file_of_stage(task.stage, need.name))
        if need.kind in {"reference", "history"}:
            return self.plan.resolver.input(need, task)
        if not self._is_made(need):
            return Joined({}) if need.joins else None
        if need.joins:
            return self._join(stage_named(need.name), need, task)
        wanted = stored_input(need, task)
        return wanted if wanted.task in earlier else self._stored(wanted, need)

    def upstreams(self, task: Task, needs: Mapping[str, Source]) -> list[Task]:
        """The tasks that provide the inputs of a task, as far as they are listed yet."""
        upstreams: dict[Task, None] = {}
        for need in needs.values():
            if need.kind != "stage" or not self._is_made(need):
                continue
            origin = stage_named(need.name)
            is_mapping = need.joins and origin.scope != "site"
            tasks = self.plan.subjects.joined(origin, need, task) if is_mapping else [stored_input(need, task).task]
            upstreams |= dict.fromkeys(tasks)
        return list(upstreams)

    def _is_made(self, need: Source) -> bool:
        """Does the site need this input from a stage, and does the stage take part (or must it be waited for)?"""
        is_needed = need.needed_if is None or need.needed_if(self.plan.site)
        return is_needed and (need.name in self.stages or not need.may_lack(self.plan.site))

    def _stored(self, wanted: Stored, need: Source) -> Input:
        state = self.plan.states.get(wanted.task)
        if state is None and not self.plan.subjects.is_unmatched(wanted.task):
            raise Waiting(wanted.task)
        if state and (stored := wanted.resolved(state.receipt)):
            return stored
        if need.may_lack(self.plan.site):
            return None
        if state is None:
            raise Impossible(f"{'--'.join(wanted.task.subject)} was not matched", Cause.NO_PAIRS)
        if state.usable:
            raise Impossible(f"{wanted.task} has nothing for {wanted.entry or wanted.field}", Cause.UNSOLVED)
        raise blocked_by(wanted.task, state)

    def _join(self, origin: Stage, need: Source, task: Task) -> Input:
        """The results of many tasks, or many entries of a site-wide result, by subject."""
        subjects, states, resolver = self.plan.subjects, self.plan.states, self.plan.resolver
        needs_pairs = origin.scope == "pair" or need.of in {"around", "near"}
        if needs_pairs and subjects.pairs(origin.dense or origin.scope != "pair") is None:
            raise Waiting(None)
        joined = subjects.joined(origin, need, task)
        if origin.scope == "site":
            return self._entries(Task(origin.name), need.part, [other.subject[0] for other in joined])
        for upstream in reversed(joined):  # the last in the list is usually the last to end
            if upstream not in states:
                raise Waiting(upstream)
        items: dict[Subject, Stored] = {}
        faults: list[Impossible] = []
        for upstream in joined:
            if task.stage != HEALTH and any(map(resolver.is_useless, upstream.subject)):
                faults.append(resolver.unfit_error(upstream.subject))
            elif stored := Stored(upstream, need.part).resolved(states[upstream].receipt):
                items[upstream.subject] = stored
            else:
                faults.append(blocked_by(upstream, states[upstream]))
        if not items and not need.may_lack(self.plan.site):
            raise self._why_empty(origin, faults)
        return Joined(items)

    def _entries(self, upstream: Task, part: str, cameras: list[str]) -> Joined:
        """The entries for some cameras in a mapping from a site-wide stage."""
        state = self.plan.states.get(upstream)
        if state is None:
            raise Waiting(upstream)
        items: dict[Subject, Stored] = {}
        for camera in cameras:
            if entry := Stored(upstream, part, camera).resolved(state.receipt):
                items[camera,] = entry
        if not items:
            raise blocked_by(upstream, state)
        return Joined(items)

    def _why_empty(self, origin: Stage, faults: list[Impossible]) -> Impossible:
        """Why a mapping input has no entries."""
        first_fault = f": {faults[0]}" if faults else ""
        frames = [(view.camera, self.plan.states.get(Task(FRAMES, (view.id,)))) for view in self.plan.site.views]
        usable = list(dict.fromkeys(camera for camera, state in frames if state and state.usable))
        if not usable and all(state and state.code == Cause.NO_CAPTURE for _, state in frames):
            reason = f"no camera has a usable capture: there is none of this night in {self.plan.site.captures.root}"
            return Impossible(reason, Cause.TOO_FEW_CAMERAS)
        if not usable:
            return Impossible(f"no camera has a usable capture{first_fault}", Cause.TOO_FEW_CAMERAS)
        if len(usable) == 1:
            reason = f"only camera {usable[0]} has a usable capture, a cloud needs two that see the same things{first_fault}"
            return Impossible(reason, Cause.TOO_FEW_CAMERAS)
        if faults:
            return Impossible(f"no {origin.name} to work on{first_fault}", faults[0].code)
        if origin.scope != "pair":
            return Impossible(f"no {origin.name} to work on", Cause.UPSTREAM)
        pairs = self.plan.states.get(Task(PAIRS))
        if pairs and not pairs.usable:
            return blocked_by(Task(PAIRS), pairs)
        return Impossible("no two cameras see enough in common to be matched", Cause.NO_PAIRS)

    def _from_site(self, need: Source, task: Task) -> Input:
        if need.name == "captures":
            return Files(self._readable_captures(camera_of(task.subject[0])))
        if need.name == "mask":
            return self._named_file("mask", camera_of(task.subject[0]))
        return site_input(self.plan.site, need, task)

    def _named_file(self, kind: str, key: str) -> Input:
        """A file that the site file names.  kind: such as "mask", for the message; key: its key in `Plan.named_files`."""
        file = self.plan.named_files.get(key)
        if file and not file.digest:
            raise Impossible(f"{kind} {file.name} {file.fault}", Cause.BAD_INPUT)
        return Files((file,), single=True) if file else None

    def _readable_captures(self, camera: str) -> tuple[CaptureFile, ...]:
        files = self.plan.captures[camera]
        if not files:
            raise Impossible(f"no capture: {self.plan.missing.get(camera, 'there is no file for it')}", Cause.NO_CAPTURE)
        readable = tuple(file for file in files if file.digest)
        if not readable:
            raise Impossible(f"no capture: {files[0].name} {files[0].fault}", Cause.NO_CAPTURE)
        return readable
