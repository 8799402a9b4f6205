"""Python interface of wbflow: load a site, run a night, open a finished run.

>>> import wbflow
>>> run = wbflow.run("yard/site.yaml", jobs=8)
>>> run.record.exit_code, run.pairs["gate--roof"]
>>> run.artifact("geometry gate--roof").F
>>> run.cloud.get_max_bound()
"""

from __future__ import annotations

import datetime
import os
from collections.abc import Iterable, Mapping
from pathlib import Path

from .errors import UsageError
from .records.events import Listener
from .records.finished_run import Run as Run
from .records.run_folder import RunFolder, refresh
from .runner.life import run_night
from .runner.options import Options
from .site.load import load_site as load_site
from .site.models import Site
from .words import bytes_of


def run(
    site: Site | str | Path,
    *,
    date: datetime.date | None = None,
    jobs: int | None = None,
    until: str | None = None,
    force: Iterable[str] = (),
    wait: bool = False,
    backend: str = "processes",
    scheduler: str | None = None,
    worker_roots: Iterable[str] = (),
    memory: str | None = None,
    time_limit: float | None = None,
    stop_at: datetime.datetime | None = None,
    not_captured: Mapping[str, str] | None = None,
    listen: Listener | None = None,
) -> Run:
    """Process a night: from captures to cloud and report.  Results that have not changed are taken from the cache.

    Parameters
    ----------
    site : Site, str or Path
        A site, or its file.
    date : date, optional
        The night; the newest one with captures, if not given.
    jobs : int, optional
        Number of workers; the number of cores, if not given.
    until : str, optional
        Stop after this stage.
    force : iterable of str
        Stages, or tasks such as "matches gate--roof", to run again.
    wait : bool
        Wait for another run of the same work folder to end.
    backend, scheduler : str
        Where tasks run: processes (or loky, the same), threading or dask; the address of Dask's scheduler.
    worker_roots : iterable of str
        Folders of this machine and their paths on the workers of the cluster: "/srv=/mnt/srv".
    memory : str, optional
        Memory limit for all workers together: "4GB"; four fifths of the machine's memory, if not given.
    time_limit : float, optional
        Limit for a task in seconds; derived from earlier tasks of its stage, if not given.
    stop_at : datetime, optional
        Local time at which running tasks are stopped; after it, only tasks that combine existing results are run.
    not_captured : mapping of str to str, optional
        By camera: the reason why no picture could be taken tonight, for its finding.
    listen : callable, optional
        Called with every event as it happens, including updates of the plan and the start of each task.

    Returns
    -------
    Run
        The finished run, whatever its outcome: see `record.exit_code` and `record.reason`.

    Raises
    ------
    SiteError
        The site file cannot be used.
    UsageError
        An option is invalid, such as an unknown stage, or Dask is not installed.
    Locked
        Another run holds the work folder.
    WbflowError
        The work folder cannot be written.
    """
    site = site if isinstance(site, Site) else load_site(site)
    options = Options(
        date=date,
        jobs=jobs or os.cpu_count() or 1,
        until=until,
        force=tuple(force),
        wait=wait,
        backend=backend,
        scheduler=scheduler,
        worker_roots=tuple(worker_roots),
        memory=_parse_memory(memory),
        time_limit=time_limit,
        stop_at=stop_at,
        not_captured=not_captured or {},
    )
    options.check(site)
    return run_night(site, options, listen or (lambda event: None))


def _parse_memory(memory: str | None) -> int | None:
    try:
        return bytes_of(memory) if memory else None
    except ValueError as error:
        raise UsageError(f"--memory: {error}", remedy="for example: --memory 4GB") from None


def open_run(where: Site | str | Path, run_id: str | None = None) -> Run:
    """Return a finished run.

    Parameters
    ----------
    where : Site, str or Path
        The site, its file or folder, or the folder of the run itself.
    run_id : str, optional
        Id or night of the run; "latest-good" is the newest one that is good or degraded; the newest, if not given.

    Raises
    ------
    NoSuchRun
        There is no such run.
    SiteError
        The site file cannot be used.
    """
    if not isinstance(where, Site) and run_id is None and RunFolder.is_run_folder(Path(where)):
        return Run.at(RunFolder.at(Path(where)))
    work_folder = (where if isinstance(where, Site) else load_site(where)).work_folder
    refresh(work_folder)
    return Run.at(RunFolder.of(work_folder, run_id))
