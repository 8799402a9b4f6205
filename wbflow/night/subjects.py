"""Which tasks a site has tonight, as far as is known."""

from __future__ import annotations

from collections import Counter
from dataclasses import field
from functools import cached_property
from typing import Any

from ..config.site import Site, SiteCamera
from ..graph.pipeline import stage_with
from ..graph.rows import FromStage, Role, Stage, Which
from ..lean import dataclass
from ..task import Task, component_name
from .state import State

_NEAR = 8
"""Cameras that show more of what one sees than its partners alone; each is one more picture that a task reads."""


@dataclass
class Subjects:
    """What the stages of a night work on: cameras, pairs as far as the pair graph is known, components as far as the world is."""

    site: Site
    states: dict[Task, State]
    """Settled tasks: the plan's own, which it changes."""
    _graph: _Graph | None = field(default=None, repr=False)
    _groups: tuple[State, int] | None = field(default=None, repr=False)

    def tasks(self, stage: Stage) -> list[Task]:
        """The tasks of a stage."""
        if stage.scope == "camera":
            return [Task(stage.name, (view.id,)) for view in self.site.views]
        if stage.scope == "pair":
            return [Task(stage.name, pair) for pair in self.pairs() or ()]
        if stage.component_parameter:
            return [Task(stage.name, ())] + [Task(stage.name, (component_name(k),)) for k in range(1, self.components())]
        return [Task(stage.name, ())]

    def pairs(self) -> list[tuple[str, str]] | None:
        """The pairs of the pair graph; None while it is not there."""
        graph = self._known_graph()
        return None if graph is None else graph.pairs

    def components(self) -> int:
        """Into how many worlds of at least two cameras the site falls, as far as is known."""
        state = self.states.get(_WORLD)
        if state is None:
            return 0
        if self._groups is None or self._groups[0] is not state:
            self._groups = state, sum(len(group) > 1 for group in _listed(Role.WORLD, state))
        return self._groups[1]

    def around(self, camera: str) -> list[str]:
        """The cameras that one makes pairs with, in the order of the site file."""
        graph = self._known_graph()
        around = {c for pair in graph.of.get(camera, ()) for c in pair} - {camera} if graph else set()
        return sorted(around, key=self._position.__getitem__)

    def near(self, camera: str) -> list[str]:
        """The cameras that one makes pairs with, and where these are fewer than eight, those that make pairs with the most of
        them; in the order of the site file."""
        partners = self.around(camera)
        shared = Counter(other for partner in partners for other in self.around(partner))
        more = sorted(shared.keys() - {camera, *partners}, key=lambda other: (-shared[other], self._position[other]))
        return sorted([*partners, *more[: max(0, _NEAR - len(partners))]], key=self._position.__getitem__)

    def among(self, which: Which, camera: str) -> list[str]:
        """The cameras around one, or near it."""
        return self.near(camera) if which is Which.NEAR else self.around(camera)

    def joined(self, origin: Stage, need: FromStage, task: Task) -> list[Task]:
        """The tasks whose artifacts an input joins."""
        if need.which is Which.ALL:
            return self.tasks(origin)
        camera = task.subject[0]
        if origin.scope == "pair":
            graph = self._known_graph()
            return [Task(origin.name, pair) for pair in graph.of.get(camera, ())] if graph else []
        return [Task(origin.name, (c,)) for c in self.among(need.which, camera)]

    def camera(self, camera: str) -> SiteCamera:
        """What the site file says of a camera, or of one of its views."""
        return self.site.views[self._position[camera]]

    @cached_property
    def _position(self) -> dict[str, int]:
        """Of each camera in the site file."""
        return {view.id: k for k, view in enumerate(self.site.views)}

    def _known_graph(self) -> _Graph | None:
        """The pair graph, indexed once for each result of its task; None while that is not settled."""
        state = self.states.get(_PAIR_GRAPH)
        if state is None:
            return None
        if self._graph is None or self._graph.state is not state:
            self._graph = _Graph(state, [tuple(pair) for pair in _listed(Role.PAIR_GRAPH, state)])
            for pair in self._graph.pairs:
                for camera in pair:
                    self._graph.of.setdefault(camera, []).append(pair)
        return self._graph


@dataclass
class _Graph:
    """The pair graph of a night."""

    state: State
    """Of its task."""
    pairs: list[tuple[str, str]]
    of: dict[str, list[tuple[str, str]]] = field(default_factory=dict)
    """The pairs of each camera."""


_PAIR_GRAPH, _WORLD = Task(stage_with(Role.PAIR_GRAPH).name), Task(stage_with(Role.WORLD).name)


def _listed(role: Role, state: State) -> list[Any]:
    """What a site-wide stage lists (see `Stage.lists`)."""
    return list(state.receipt.figures.get(stage_with(role).lists, ())) if state.usable and state.receipt else []
