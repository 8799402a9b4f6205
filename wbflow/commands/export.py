"""A run's results in formats that other programs read: the rows of `pipeline.exports`, written to a folder."""

from __future__ import annotations

import datetime
import importlib.util
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ..cache.atomic import write_atomic
from ..errors import ExitCode, WbflowError
from ..pipeline.exports import EXPORTS, EXTRAS, Export
from ..pipeline.stages import FUSE, stage_named
from ..plugins import load
from ..records.finished_run import Run
from ..task import Task


class MissingExtra(WbflowError):
    """Packages that an export needs are not installed; the message says how to get them."""

    exit_code = ExitCode.USAGE


def export(run: Run, out: Path, forms: frozenset[str]) -> Iterator[Path]:
    """Write a run's results into `out` in some formats (names of `EXPORTS`); yields each file when it is written.

    Raises MissingExtra before any file is written; WbflowError if the run lacks what a format needs; DamagedArtifact if the disk
    has lost a part of the cache, which the next run makes again.
    """
    if run.record.poses is None:
        raise WbflowError(f"run {run.id} solved no cameras: {run.record.reason or 'it ended before that'}")
    rows = [row for row in EXPORTS if row.name in forms]
    # all packages are looked for first, so that nothing is half exported
    for row in rows:
        _require(row, georeferenced=bool(run.record.poses.crs))
    for row in rows:
        arguments = {name: _result(run, stages) for name, stages in row.inputs.items()}
        if row.dated:
            arguments["day"] = datetime.date.fromisoformat(run.record.date)
        try:
            for name, data in load(row.function)(**arguments):
                write_atomic(out / name, data)
                yield out / name
        except (ValueError, RuntimeError, ImportError) as error:  # also of the format's library, which may not load
            raise WbflowError(f"run {run.id}: {error}") from error


def _require(row: Export, *, georeferenced: bool) -> None:
    """Check that the packages that a format needs are installed.  Raises MissingExtra."""
    extra = row.extra
    what = f"--{row.name}"
    if not extra and georeferenced:
        extra = row.extra_on_the_map
        what += " of a georeferenced site"
    missing = [package for package in EXTRAS.get(extra, ()) if importlib.util.find_spec(package) is None]
    if missing:
        raise MissingExtra(f"{what} needs {' and '.join(missing)}: pip install 'wbflow[{extra}]'")


def _result(run: Run, stages: tuple[str, ...]) -> Any:
    """Return what an export takes: of a site-wide stage its result, else those of the first stage that made any, by subject."""
    if stages == (FUSE,):
        return run.cloud_table()
    scope = stage_named(stages[0]).scope
    if scope == "site":
        return run.load(Task(stages[0]))
    if scope == "pair":
        return run.of_pairs(*stages)
    return run.of_cameras(*stages)
