"""A finished run's results in the forms that other programs read; from the run's folder and the cache, nothing is run again."""

from __future__ import annotations

import datetime
import importlib.util
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ..cache.atomic import write_atomic
from ..errors import ExitCode, WbflowError
from ..pipeline.exports import EXPORTS, EXTRAS, Export
from ..pipeline.stages import FUSE, POSES, stage_named
from .artifacts import FinishedRun, function


class MissingExtra(WbflowError):
    """Packages that an export needs are not installed; the message says how to get them."""

    exit_code = ExitCode.USAGE


class NothingToExport(WbflowError):
    """The run does not hold what was asked for; the message says what is missing."""


def export(run: FinishedRun, out: Path, forms: frozenset[str]) -> Iterator[Path]:
    """Write a run's results into `out` in the forms asked for (names of `EXPORTS`); yields each file when it is there.

    Raises
    ------
    MissingExtra, NothingToExport, Gone
        Before a file of that form is written.
    DamagedArtifact
        The cache's disk has lost something; the next run makes it again.
    """
    if run.record.poses is None:
        raise NothingToExport(f"run {run.folder.id} solved no cameras: {run.record.reason or 'it ended before'}")
    asked = [row for row in EXPORTS if row.name in forms]
    for row in asked:
        require(row, georeferenced=bool(run.record.poses.crs))
    for row in asked:
        results = {name: _result(run, stages) for name, stages in row.inputs.items()}
        day = datetime.date.fromisoformat(run.record.date)
        try:
            for name, data in function(row.function)(**results, **({"day": day} if row.dated else {})):
                write_atomic(out / name, data)
                yield out / name
        except ValueError as error:
            raise NothingToExport(f"run {run.folder.id}: {error}") from error


def require(row: Export, *, georeferenced: bool) -> None:
    """See that the packages that a form needs are installed.  Raises MissingExtra."""
    extra = row.extra or (row.extra_on_the_map if georeferenced else "")
    missing = [package for package in EXTRAS.get(extra, ()) if importlib.util.find_spec(package) is None]
    if missing:
        what = f"--{row.name}{'' if row.extra else ' of a georeferenced site'}"
        raise MissingExtra(f"{what} needs {' and '.join(missing)}: pip install 'wbflow[{extra}]'")


def _result(run: FinishedRun, stages: tuple[str, ...]) -> Any:
    if stages == (FUSE,):
        return run.cloud()
    if stages == (POSES,):
        return run.made(POSES)
    return run.of_pairs(*stages) if stage_named(stages[0]).scope == "pair" else run.of_cameras(*stages)
