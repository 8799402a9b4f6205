"""The stages of a site, each bound once to the function and the parameters that the site uses for it."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from ..pipeline.binding import Binding, bind
from ..pipeline.stages import STAGES, Adapt, Stage, ancestors
from ..site.models import Site


@dataclass(frozen=True)
class Bindings:
    """Binds the stages of a site when they are first asked for."""

    site: Site
    _bound: dict[str, Binding] = field(default_factory=dict, repr=False)
    """Bindings by stage, or by the function of the `Adapt` that replaces the stage's own."""

    def of(self, stage: Stage) -> Binding:
        """The binding of a stage to the function that the site uses for it."""
        if stage.name not in self._bound:
            settings = self.site.stages[stage.name]
            self._bound[stage.name] = bind(stage, settings.use, settings.parameters, self.site.reader)
        return self._bound[stage.name]

    def of_adapt(self, stage: Stage, adapt: Adapt) -> Binding:
        """The binding of a stage to the function that derives its result from the reference's; it takes no method."""
        if adapt.function not in self._bound:
            adapting = dataclasses.replace(stage, function=adapt.function, inputs=adapt.inputs, offers={}, method=None)
            self._bound[adapt.function] = bind(adapting, None, {}, self.site.reader)
        return self._bound[adapt.function]

    def stated(self, stage: Stage) -> Mapping[str, Any]:
        """The parameters of a stage that the site file sets, in the stage's section or elsewhere."""
        accepted = self.of(stage).parameters
        elsewhere = {name: self.site.setting(key) for name, key in stage.set_by_site().items() if name in accepted}
        return elsewhere | self.site.stages[stage.name].parameters


def stages_of(site: Site, until: str | None = None) -> tuple[Stage, ...]:
    """The stages that take part in a night of a site, in order.  until: the last stage; None: all of them."""
    requested = ancestors(until) if until else {stage.name for stage in STAGES}
    disabled = {name for name, settings in site.stages.items() if not settings.enabled}
    for stage in STAGES:
        if callable(stage.optional) and not stage.optional(site):
            disabled.add(stage.name)
    # in order, so that an optional stage is disabled whenever one that it needs is, directly or not
    for stage in STAGES:
        if stage.optional and disabled & stage.needed():
            disabled.add(stage.name)
    return tuple(stage for stage in STAGES if stage.name in requested - disabled)
