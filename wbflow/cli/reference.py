"""The reference: what later nights are compared with."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from ..errors import ExitCode, UsageError
from .common import load, place_of, run_argument, site_argument, work_option
from .words import say, stop

if TYPE_CHECKING:
    from ..cache.layout import WorkFolder
    from ..site.models import Site


@click.command()
@site_argument
@run_argument
@click.option("--list", "listed", is_flag=True, help="Say what is pinned.")
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
        raise UsageError(
            "--list, --drop, --refine and RUN exclude each other", remedy="wbflow pin SITE.yaml --list  says what is pinned"
        )
    loaded = load(site, work)
    place = place_of(loaded)
    from ..cache.writing import hold_to_write
    from ..records.reference_folder import drop_reference, read_reference

    if listed:
        reference = read_reference(place)
        if reference is None:
            stop(ExitCode.GOOD, f"{loaded.name} has no reference")
        for line in reference.lines():
            say(line)
        return
    with hold_to_write(place, wait=False):
        if drop:
            said = "the reference is dropped" if drop_reference(place) else f"{loaded.name} has no reference"
        elif refine:
            said = _refine(loaded, place)
        else:
            from ..cache.store import Cache
            from ..reference.create import good_run
            from ..reference.create import pin as make

            made = make(Cache(place), good_run(place, run_id))
            said = f"run {made.run} (night of {made.date}) is the reference now: {place.reference}"
    say(said)
    if not (drop or refine) and loaded.pin == "none":
        say("the site file says `pin: none`: as long as it does, nothing is compared with it", err=True)


def _refine(site: Site, place: WorkFolder) -> str:
    from ..cache.store import Cache
    from ..records.reference_folder import read_reference, restore
    from ..reference.aggregate import pool

    reference = read_reference(place)
    if reference is None:
        raise UsageError(f"{site.name} has no reference to refine", remedy=f"first: wbflow pin {site.file}")
    restore(Cache(place), reference)
    pooled = pool(place, reference, site)
    return "\n".join(f"{task}: pooled from {nights} nights" for task, nights in pooled.items()) or "nothing to pool yet"
