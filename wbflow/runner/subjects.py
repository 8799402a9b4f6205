"""Which tasks a site has tonight, as far as is known."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from functools import cached_property

from ..pipeline.stages import DENSE_PAIRS, FUSE, PAIRS, POSES, Source, Stage, stage_named
from ..pipeline.summaries import PairsSummary, PosesSummary
from ..site.models import Camera, Site
from ..task import Task, component_name
from .state import State, summary_of

_NEAR = 8
"""Cameras that show more of what one sees than its partners alone; each is one more picture that a task reads."""


@dataclass
class Subjects:
    """What the stages of a night work on: cameras, pairs as far as the pair graph is known, components as far as the world is.

    Where dense pairs are chosen once the cameras are placed, the stages that make pairs dense work on these; where nothing came
    of that choice, on those that were matched.
    """

    site: Site
    states: dict[Task, State]
    """Settled tasks: the plan's own, which it changes."""
    chosen_anew: bool = False
    """Does the stage that chooses the dense pairs take part?"""
    _graphs: dict[Task, _Graph] = field(default_factory=dict, repr=False)
    _groups: tuple[State, int] | None = field(default=None, repr=False)

    def tasks(self, stage: Stage) -> list[Task]:
        """The tasks of a stage."""
        if stage.scope == "camera":
            return [Task(stage.name, (view.id,)) for view in self.site.views]
        if stage.scope == "pair":
            return [Task(stage.name, pair) for pair in self.pairs(stage.dense) or ()]
        if stage.name == FUSE:
            return [Task(stage.name, ())] + [Task(stage.name, (component_name(k),)) for k in range(1, self.components())]
        return [Task(stage.name, ())]

    def pairs(self, dense: bool = False) -> list[tuple[str, str]] | None:
        """The pairs that are matched, or made dense; None while nobody knows."""
        graph = self._known_graph(dense)
        return None if graph is None else graph.pairs

    def unmatched(self, task: Task) -> bool:
        """Is this of a pair that the stage does not work on, since it is made dense without having been matched?"""
        graph = self._known_graph(dense=False) if self.chosen_anew and len(task.subject) == 2 else None
        return graph is not None and not stage_named(task.stage).dense and task.subject not in graph.of.get(task.subject[0], ())

    def components(self) -> int:
        """Into how many worlds of at least two cameras the site falls, as far as is known."""
        state = self.states.get(_WORLD)
        if state is None:
            return 0
        if self._groups is None or self._groups[0] is not state:
            self._groups = state, sum(len(group) > 1 for group in _components(state))
        return self._groups[1]

    def around(self, camera: str) -> list[str]:
        """The cameras that one makes dense pairs with, in the order of the site file."""
        graph = self._known_graph(dense=True)
        around = {c for pair in graph.of.get(camera, ()) for c in pair} - {camera} if graph else set()
        return sorted(around, key=self._position.__getitem__)

    def near(self, camera: str) -> list[str]:
        """Those around a camera, and where they are fewer than eight, the cameras that make dense pairs with the most of them;
        in the order of the site file."""
        partners = self.around(camera)
        shared = Counter(other for partner in partners for other in self.around(partner))
        more = sorted(shared.keys() - {camera, *partners}, key=lambda other: (-shared[other], self._position[other]))
        return sorted([*partners, *more[: max(0, _NEAR - len(partners))]], key=self._position.__getitem__)

    def among(self, of: str, camera: str) -> list[str]:
        """The cameras around one, or near it."""
        return self.near(camera) if of == "near" else self.around(camera)

    def joined(self, origin: Stage, need: Source, task: Task) -> list[Task]:
        """The tasks whose artifacts an input joins."""
        if need.of == "every":
            return self.tasks(origin)
        camera = task.subject[0]
        if origin.scope == "pair":
            graph = self._known_graph(origin.dense)
            return [Task(origin.name, pair) for pair in graph.of.get(camera, ())] if graph else []
        return [Task(origin.name, (c,)) for c in self.among(need.of, camera)]

    def camera(self, camera: str) -> Camera:
        """What the site file says of a camera, or of one of its views."""
        return self.site.views[self._position[camera]]

    @cached_property
    def _position(self) -> dict[str, int]:
        """Of each camera in the site file."""
        return {view.id: k for k, view in enumerate(self.site.views)}

    def _known_graph(self, dense: bool) -> _Graph | None:
        """The pair graph, indexed once for each result of its task; None while that is not settled."""
        name = DENSE_PAIRS if dense and self.chosen_anew else PAIRS
        task = Task(name)
        state = self.states.get(task)
        if state is None:
            return None
        if name == DENSE_PAIRS and not state.usable:
            return self._known_graph(dense=False)
        if task not in self._graphs or self._graphs[task].state is not state:
            self._graphs[task] = graph = _Graph(state, list(summary_of(state, PairsSummary).pairs) if state.usable else [])
            for pair in graph.pairs:
                for camera in pair:
                    graph.of.setdefault(camera, []).append(pair)
        return self._graphs[task]


@dataclass
class _Graph:
    """The pairs of a night, those that are matched or those that are made dense."""

    state: State
    """Of its task."""
    pairs: list[tuple[str, str]]
    of: dict[str, list[tuple[str, str]]] = field(default_factory=dict)
    """The pairs of each camera."""


_WORLD = Task(POSES)


def _components(state: State) -> tuple[tuple[str, ...], ...]:
    return summary_of(state, PosesSummary).components if state.usable else ()
