"""The options of a run."""

from __future__ import annotations

import datetime
import difflib
import importlib.util
import itertools
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from ..errors import UsageError
from ..pipeline.stages import STAGES, stage_named
from ..site.models import Site
from ..task import camera_of, component_name


@dataclass(frozen=True)
class Options:
    """The options of a run; `api.run` explains each."""

    date: datetime.date | None = None
    jobs: int = 1
    until: str | None = None
    force: tuple[str, ...] = ()
    wait: bool = False
    backend: str = "processes"
    scheduler: str | None = None
    worker_roots: tuple[str, ...] = ()
    memory: int | None = None
    """Bytes that all workers together may hold; None: 0.8 of the machine's memory (`limits.machine_memory`)."""
    time_limit: float | None = None
    stop_at: datetime.datetime | None = None
    not_captured: Mapping[str, str] = field(default_factory=dict)

    def check(self, site: Site) -> None:
        """Raises UsageError for impossible options."""
        # options are checked before the work folder is held, so that a mistake is told at once
        names = [stage.name for stage in STAGES]
        if self.until and self.until not in names:
            raise UsageError(f"--until {self.until}: there is no such stage", remedy=_stages_remedy(self.until, names))
        for name in self.force:
            if name.split(" ")[0] not in names:
                what = f"--force {name!r}: name a stage, or a task such as 'matches gate--roof'"
                raise UsageError(what, remedy=_stages_remedy(name, names))
            self._check_subject(site, name)
        if self.worker_roots and self.backend != "dask":
            raise UsageError("--worker-root is of workers on other machines", remedy="with --backend dask")
        worker_roots(self.worker_roots)
        if self.backend == "dask" and not self.scheduler:
            remedy = "for example: --scheduler tcp://host:8786, where `dask scheduler` runs"
            raise UsageError("--backend dask needs --scheduler ADDRESS", remedy=remedy)
        if self.backend == "dask" and importlib.util.find_spec("distributed") is None:
            raise UsageError("--backend dask needs Dask", remedy="pip install 'wbflow[dask]'")

    def _check_subject(self, site: Site, name: str) -> None:
        """Raises UsageError if `force` names a task that the site cannot have."""
        stage, _, subject = name.partition(" ")
        if not subject:
            return  # the whole stage
        existing = _subjects(site, stage_named(stage).scope)
        if subject in existing:
            return
        swapped = "--".join(reversed(subject.split("--")))
        if swapped in existing:
            similar = [swapped]
        else:
            # hundreds of cameras have tens of thousands of pairs, and each comparison takes a while
            similar = difflib.get_close_matches(subject, sorted(existing)[:20_000], n=1)
        remedy = "wbflow status SITE.yaml  lists the night's tasks"
        if similar:
            remedy = f"did you mean '{stage} {similar[0]}'?"
        raise UsageError(f"--force {name!r}: the site has no such task", remedy=remedy)


def _subjects(site: Site, scope: str) -> set[str]:
    """All subjects, as text, that tasks of a scope can have; of a camera with several views, the camera counts, too."""
    views: dict[str, None] = {}  # a set that keeps its order
    for view in site.views:
        views[view.id] = None
        views[camera_of(view.id)] = None
    if scope == "camera":
        return set(views)
    if scope == "pair":
        return {"--".join(pair) for pair in itertools.combinations(views, 2)}
    return {component_name(k) for k in range(1, len(views))}


def _stages_remedy(name: str, names: list[str]) -> str:
    remedy = f"stages are {', '.join(names)}"
    similar = difflib.get_close_matches(name.split(" ")[0], names, n=1)
    if similar:
        remedy = f"did you mean {similar[0]}? {remedy}"
    return remedy


def worker_roots(texts: tuple[str, ...]) -> dict[Path, Path]:
    """Return the workers' paths by folder of this machine, parsed from texts HERE=THERE.  Raises UsageError."""
    roots = {}
    for text in texts:
        local, _, remote = text.partition("=")
        if not local or not remote.startswith("/"):
            what = f"--worker-root {text!r}: write HERE=THERE, a folder of this machine and its path on the workers"
            raise UsageError(what, remedy="for example: --worker-root /srv=/mnt/srv")
        roots[Path(local).resolve()] = Path(remote)
    return roots
