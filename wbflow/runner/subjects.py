"""What a night's tasks are about: its cameras, its pairs, and the components of cameras that see the same things."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from functools import cached_property

from wbflow_stages.contracts.pair_figures import PairsFigures

from ..pipeline.stages import DENSE_PAIRS, FUSE, PAIRS, POSES, Source, Stage, stage_named
from ..pipeline.summaries import PosesSummary
from ..site.models import Site
from ..task import Task, component_name
from .state import State, summary_of

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
        tasks = [Task(stage.name)]
        if stage.name == FUSE:  # a cloud for each further component
            tasks += [Task(stage.name, (component_name(k),)) for k in range(1, self.components())]
        return tasks

    def pairs(self, dense: bool = False) -> list[tuple[str, str]] | None:
        """The pairs that are matched, or the dense pairs; None while they are unknown."""
        graph = self._graph(dense)
        return None if graph is None else graph.pairs

    def is_unmatched(self, task: Task) -> bool:
        """Does the stage not work on this pair, because the pair was chosen for dense matching without having been matched?"""
        # without a choice of its own, dense matching works on the matched pairs
        if not self.dense_chosen or len(task.subject) != 2 or stage_named(task.stage).dense:
            return False
        graph = self._graph(dense=False)
        return graph is not None and task.subject not in graph.of.get(task.subject[0], ())

    def components(self) -> int:
        """The number of components with at least two placed cameras; 0 while the poses are unknown."""
        state = self.states.get(Task(POSES))
        if state is None or not state.usable:
            return 0
        return sum(len(component) > 1 for component in summary_of(state, PosesSummary).components)

    def component_of(self, task: Task) -> int:
        """The number of the component that a site-wide task is about; 0 for the main one."""
        for k in range(1, self.components()):
            if task.subject == (component_name(k),):
                return k
        return 0

    def around(self, camera: str) -> list[str]:
        """A camera's partners in dense pairs, in the order of the site file."""
        graph = self._graph(dense=True)
        if graph is None:
            return []
        partners: set[str] = set()
        for pair in graph.of.get(camera, ()):
            partners.update(pair)
        return sorted(partners - {camera}, key=self._position.__getitem__)

    def near(self, camera: str) -> list[str]:
        """A camera's partners in dense pairs and, up to `_MOST_NEAR` in all, the cameras with the most dense pairs with these
        partners; in the order of the site file."""
        partners = self.around(camera)
        counts: Counter[str] = Counter()
        for partner in partners:
            counts.update(self.around(partner))
        others = counts.keys() - {camera, *partners}
        ranked = sorted(others, key=lambda other: (-counts[other], self._position[other]))
        added = ranked[: max(0, _MOST_NEAR - len(partners))]
        return sorted([*partners, *added], key=self._position.__getitem__)

    def joined(self, origin: Stage, need: Source, task: Task) -> list[Task]:
        """The tasks whose artifacts, or entries of one, form a mapping input."""
        if need.of == "every":
            return self.tasks(origin)
        camera = task.subject[0]
        if origin.scope == "pair":
            graph = self._graph(origin.dense)
            pairs = graph.of.get(camera, ()) if graph else ()
            return [Task(origin.name, pair) for pair in pairs]
        others = self.near(camera) if need.of == "near" else self.around(camera)
        return [Task(origin.name, (other,)) for other in others]

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
        # the state is replaced if the artifact was damaged and made again
        if task not in self._graphs or self._graphs[task].state is not state:
            self._graphs[task] = _PairGraph(state)
        return self._graphs[task]


class _PairGraph:
    """The pairs of a night, also by camera: the matched ones, or the dense ones."""

    def __init__(self, state: State) -> None:
        """state: of the task that chose the pairs."""
        self.state = state
        self.pairs = list(summary_of(state, PairsFigures).pairs) if state.usable else []
        self.of: dict[str, list[tuple[str, str]]] = {}
        for pair in self.pairs:
            for camera in pair:
                self.of.setdefault(camera, []).append(pair)
