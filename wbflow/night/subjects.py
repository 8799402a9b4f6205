"""Which tasks a site has tonight, as far as is known."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ..config.site import Site, SiteCamera
from ..graph.pipeline import stage_with
from ..graph.rows import FromStage, Role, Stage, Which
from ..task import Task, component_name
from .state import State


@dataclass
class Subjects:
    """What the stages of a night work on: cameras, pairs as far as the pair graph is known, components as far as the world is."""

    site: Site
    states: dict[Task, State]
    """Settled tasks: the plan's own, which it changes."""

    def tasks(self, stage: Stage) -> list[Task]:
        """The tasks of a stage."""
        if stage.scope == "camera":
            return [Task(stage.name, (camera.id,)) for camera in self.site.cameras]
        if stage.scope == "pair":
            return [Task(stage.name, pair) for pair in self.pairs() or ()]
        if stage.component_parameter:
            return [Task(stage.name, ())] + [Task(stage.name, (component_name(k),)) for k in range(1, self.components())]
        return [Task(stage.name, ())]

    def pairs(self) -> list[tuple[str, str]] | None:
        """The pairs of the pair graph; None while it is not there."""
        listed = self._listed(Role.PAIR_GRAPH)
        return None if listed is None else [tuple(pair) for pair in listed]

    def components(self) -> int:
        """Into how many worlds of at least two cameras the site falls, as far as is known."""
        return sum(len(group) > 1 for group in self._listed(Role.WORLD) or ())

    def around(self, camera: str) -> list[str]:
        """The cameras that one makes pairs with, in the order of the site file."""
        around = {c for pair in self.pairs() or () if camera in pair for c in pair} - {camera}
        return [c.id for c in self.site.cameras if c.id in around]

    def joined(self, origin: Stage, need: FromStage, task: Task) -> list[Task]:
        """The tasks whose artifacts an input joins."""
        if need.which is Which.ALL:
            return self.tasks(origin)
        camera = task.subject[0]
        if origin.scope == "pair":
            return [t for t in self.tasks(origin) if camera in t.subject]
        return [Task(origin.name, (c,)) for c in self.around(camera)]

    def camera(self, camera: str) -> SiteCamera:
        """What the site file says of a camera."""
        return next(c for c in self.site.cameras if c.id == camera)

    def _listed(self, role: Role) -> list[Any] | None:
        """What a site-wide stage lists (see `Stage.lists`); None where its task is not settled yet."""
        stage = stage_with(role)
        state = self.states.get(Task(stage.name))
        if state is None:
            return None
        return list(state.receipt.figures.get(stage.lists, ())) if state.usable and state.receipt else []
