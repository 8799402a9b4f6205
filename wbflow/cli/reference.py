"""`wbflow pin`: the reference that later nights are compared with."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from ..errors import ExitCode, UsageError
from .common import echo, load, run_argument, site_argument, stop, work_option

if TYPE_CHECKING:
    from ..site.models import Site


@click.command()
@site_argument
@run_argument
@click.option("--list", "listed", is_flag=True, help="Print the reference.")
@click.option("--drop", is_flag=True, help="Forget the reference.")
@click.option("--refine", is_flag=True, help="Pool what the nights since have measured into the reference.")
@work_option
def pin(site: Path, run_id: str | None, listed: bool, drop: bool, refine: bool, work: str | None) -> None:
    """Make a run the reference that later nights are compared with; the newest good one, if no RUN is named.

    The first good run becomes it by itself, unless the site file says `pin: none`.

    \b
    wbflow pin site.yaml                          the newest good run
    wbflow pin site.yaml 20261120T031500Z
    wbflow pin site.yaml --list
    """
    if listed + drop + refine + (run_id is not None) > 1:
        remedy = "wbflow pin SITE.yaml --list  prints the reference"
        raise UsageError("--list, --drop, --refine and RUN exclude each other", remedy=remedy)
    loaded = load(site, work)
    folder = loaded.work_folder
    from ..records.reference_folder import drop_reference, read_reference
    from ..records.run_folder import hold_to_write

    if listed:
        reference = read_reference(folder)
        if reference is None:
            stop(ExitCode.GOOD, f"{loaded.name} has no reference")
        for line in reference.lines():
            echo(line)
        return
    with hold_to_write(folder, wait=False):
        if drop:
            echo("the reference is dropped" if drop_reference(folder) else f"{loaded.name} has no reference")
        elif refine:
            _refine(loaded)
        else:
            _create(loaded, run_id)


def _create(site: Site, run_id: str | None) -> None:
    from ..cache.store import Cache
    from ..reference.create import good_run
    from ..reference.create import pin as create

    folder = site.work_folder
    reference = create(Cache(folder), good_run(folder, run_id))
    echo(f"run {reference.run} (night of {reference.date}) is the reference now: {folder.reference}")
    if site.pin == "none":
        echo("the site file says `pin: none`: as long as it does, nothing is compared with it", err=True)


def _refine(site: Site) -> None:
    from ..cache.store import Cache
    from ..records.reference_folder import read_reference, restore
    from ..reference.aggregate import pool

    folder = site.work_folder
    reference = read_reference(folder)
    if reference is None:
        raise UsageError(f"{site.name} has no reference to refine", remedy=f"first: wbflow pin {site.file}")
    restore(Cache(folder), reference)
    pooled = pool(folder, reference, site)
    echo("\n".join(f"{task}: pooled from {nights} nights" for task, nights in pooled.items()) or "nothing to pool yet")
