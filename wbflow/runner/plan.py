"""The plan: every task of a site with its state, derived repeatedly from the table of stages, the captures and the cache.

A task has ended (cached, ran, rejected, failed, skipped), is running, is ready, or waits for another.  The plan itself is not
stored: after a crash, a new plan finds in the cache exactly what was finished.
"""

from __future__ import annotations

import dataclasses
from collections import Counter, deque
from collections.abc import Iterable, Set
from dataclasses import dataclass, field

from ..cache.receipt import Receipt
from ..pipeline.stages import COMPONENT, DENSE_PAIRS, FRAMES, FUSE, PAIRS, POSES, Adapt, Stage, stage_named
from ..reference.resolve import Resolver
from ..task import Task, names_of
from .inputs import Inputs
from .night import Night
from .spec import Input, ProductFile, TaskSpec
from .state import Impossible, Outcome, State, Waiting, cached_state
from .subjects import Subjects

_DECISIVE = frozenset(Task(name) for name in (PAIRS, POSES, DENSE_PAIRS))
"""Tasks whose results determine which other tasks exist."""


@dataclass
class Plan:
    """The tasks of one night; `refresh` derives their states from the cache."""

    night: Night
    states: dict[Task, State] = field(default_factory=dict)
    """Tasks that have ended."""
    running: set[Task] = field(default_factory=set)
    ready: dict[Task, TaskSpec] = field(default_factory=dict)
    waiting: dict[Task, Task | None] = field(default_factory=dict)
    """All other tasks, with the first task found that each waits for (None: the pair graph)."""
    _must_relist: bool = True
    """Must the tasks be listed again?"""
    _due: deque[Task] = field(default_factory=deque)
    """Tasks whose states must be derived."""
    _dependents: dict[Task | None, list[Task]] = field(default_factory=dict)
    """Waiting tasks, by the task that they wait for."""
    _newly_ended: dict[Task, None] = field(default_factory=dict)
    """Tasks that have ended since the last call of `newly_ended`."""
    _task_counts: Counter[str] = field(default_factory=Counter)
    """Number of tasks by stage, ended ones included."""

    def __post_init__(self) -> None:
        self._force = set(self.night.force)
        """Stages and tasks that are still to be run again."""
        self.subjects = Subjects(self.night.site, self.states, self.night.takes_part(DENSE_PAIRS))
        self.resolver = Resolver(self.night, self.states)
        self._inputs = Inputs(self.night, self.subjects, self.resolver.input, self.resolver.unfit)

    def refresh(self) -> None:
        """Find which tasks are cached, ready or waiting; only those that may have changed are examined."""
        while self._must_relist or self._due:
            if self._must_relist:
                self._list()  # all tasks are due then
                continue
            task = self._due.popleft()
            if task not in self.states and task not in self.running and task not in self.ready:
                self._derive(stage_named(task.stage), task)

    def commit(self, task: Task, state: State) -> None:
        """Record how a task has ended; tasks that wait for it are examined again."""
        self.states[task] = state
        self.ready.pop(task, None)
        self.waiting.pop(task, None)
        self._force.discard(str(task))  # forced once: when it is examined again, its result counts
        # the resolver first: tasks that are examined next may depend on what it has learned
        self.resolver.task_ended(task)
        self._newly_ended[task] = None
        self._due.extend(self._dependents.pop(task, ()))
        self._must_relist = self._must_relist or task in _DECISIVE

    def forget(self, task: Task) -> None:
        """Drop the state of a task that has ended, because its artifact is damaged."""
        self.states.pop(task, None)
        self.resolver.artifact_lost(task)
        self._must_relist = True

    def relist(self) -> None:
        """Have the states of all tasks that have not ended derived again, because a file has changed."""
        self._must_relist = True

    def begin(self, chains: Iterable[list[TaskSpec]]) -> None:
        """Mark the tasks of chains as running."""
        for chain in chains:
            for spec in chain:
                self.running.add(spec.task)
                self.ready.pop(spec.task, None)
                self.waiting.pop(spec.task, None)

    def release(self, tasks: Iterable[Task]) -> None:
        """Mark tasks as no longer running; those that have not ended are examined again."""
        for task in tasks:
            self.running.discard(task)
            self._due.append(task)

    def newly_ended(self) -> list[tuple[Task, State]]:
        """The tasks that have ended since the last call."""
        ended = []
        for task in self._newly_ended:
            state = self.states.get(task)
            if state:  # else it was forgotten since
                ended.append((task, state))
        self._newly_ended = {}
        return ended

    def chains(self) -> list[list[TaskSpec]]:
        """The ready tasks, each with the tasks of the same subject that can follow it in the same worker call."""
        return [self._chain(spec) for spec in self.ready.values()]

    def counts(self) -> dict[str, int]:
        """The number of tasks of each stage that are listed so far."""
        if self._must_relist:
            self._list()
        return {stage.name: self._task_counts[stage.name] for stage in self.night.stages}

    def spec_of(self, task: Task) -> TaskSpec:
        """The spec of a task, whether it has already ended or not.

        Raises Waiting if its inputs are not ready, Impossible if they cannot be made.
        """
        stage = stage_named(task.stage)
        replacement = self.resolver.replacement(stage, task)
        adapt = replacement if isinstance(replacement, Adapt) else None
        return self._with_product_files(self._spec(stage, task, adapt), frozenset())

    def upstreams(self, task: Task) -> list[Task]:
        """The tasks that provide the inputs of a task, as far as they are listed yet."""
        return self._inputs.upstreams(task, self.night.site.bindings.of(stage_named(task.stage)).inputs)

    def _list(self) -> None:
        """List all known tasks, to be examined in the order of the pipeline."""
        self._must_relist = False
        self.ready = {}
        self.waiting = {}
        self._dependents = {}
        self._due = deque()
        for stage in self.night.stages:
            self._due.extend(self.subjects.tasks(stage))
        self._task_counts = Counter(task.stage for task in self._due)

    def _derive(self, stage: Stage, task: Task) -> None:
        """Find the state of a task: it ends (its result is there, or cannot be made), waits for another one, or is ready."""
        try:
            replacement = self.resolver.replacement(stage, task)
            if isinstance(replacement, Receipt):
                self.commit(task, cached_state(replacement))
                return
            spec = self._spec(stage, task, replacement)
        except Waiting as waiting:
            # examined again when that one has ended
            self.waiting[task] = waiting.task
            self._dependents.setdefault(waiting.task, []).append(task)
            return
        except Impossible as impossible:
            # a camera without captures has failed itself; other tasks lack what an earlier one has not made
            outcome: Outcome = "failed" if stage.name == FRAMES else "skipped"
            self.commit(task, State(outcome, str(impossible), impossible.code))
            return
        self.waiting.pop(task, None)
        preimage = spec.preimage()
        key = preimage.key()
        if stage.name == FRAMES:
            self.resolver.note_frame(task.subject, key)
        receipt = None if spec.force else self.night.cache.by_key(task, key)
        if receipt:
            self.commit(task, cached_state(receipt))
        else:
            self.ready[task] = spec

    def _chain(self, first: TaskSpec) -> list[TaskSpec]:
        """A ready task, and those of its camera or pair that need only its result, and what is there already."""
        chain = [first]
        earlier = {first.task}
        if first.task.subject:
            for stage in self.night.stages:
                follower = Task(stage.name, first.task.subject)
                if follower not in self.waiting:
                    continue
                try:
                    replacement = self.resolver.replacement(stage, follower)
                    if not isinstance(replacement, Receipt):
                        chain.append(self._spec(stage, follower, replacement, earlier))
                        earlier.add(follower)
                except (Waiting, Impossible):
                    continue
        return [self._with_product_files(spec, earlier) for spec in chain]

    def _spec(self, stage: Stage, task: Task, adapt: Adapt | None, earlier: Set[Task] = frozenset()) -> TaskSpec:
        """The spec of a task with the stage's function or the `adapt` function; raises Waiting, Impossible.

        earlier: tasks earlier in the same chain; inputs from these are not resolved yet.
        """
        bindings = self.night.site.bindings
        bound = bindings.of_adapt(stage, adapt) if adapt else bindings.of(stage)
        inputs = self._inputs.inputs_of(task, bound.inputs, earlier)
        parameters = bound.defaults()
        stated = self.night.site.stated(stage)
        if adapt:
            # its function reads only some of the stage's parameters
            stated = {name: value for name, value in stated.items() if name in bound.parameters}
        elif stage.name == FUSE and COMPONENT in bound.parameters:
            parameters[COMPONENT] = self.subjects.component_of(task)
        parameters |= stated
        left_to_function = {name: text for name, text in bound.left_to_function().items() if name not in parameters}
        return TaskSpec(
            task,
            bound.function.dotted,
            bound.code,
            parameters,
            inputs,
            method=bound.method.dotted if bound.method else "",
            force=not self._force.isdisjoint(names_of(task)),
            left_to_function=left_to_function,
            folder=self.night.site.folder,
        )

    def _with_product_files(self, spec: TaskSpec, earlier: Set[Task]) -> TaskSpec:
        """A spec with the product files to make of its result.  earlier: as for `_spec`."""
        stage = stage_named(spec.task.stage)
        product_files = []
        for name, function in stage.products.product_files.items():
            inputs: dict[str, Input] = {}
            if name == "picture":
                for argument, need in stage.products.picture_inputs.items():
                    try:
                        inputs[argument] = self._inputs.input_of(spec.task, need, earlier)
                    except (Waiting, Impossible):  # the picture is drawn without it
                        inputs[argument] = None
            product_files.append(ProductFile(name, function, inputs))
        return dataclasses.replace(spec, product_files=tuple(product_files))
