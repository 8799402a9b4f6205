"""The page about several sites: the last nights and a picture of each; sites that need attention come first."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ..cache.layout import WorkFolder
from ..cache.store import Cache
from ..cache.untrusted import MOST_TEXT_BYTES, read_untrusted
from ..errors import WbflowError
from ..pipeline.stages import FUSE
from ..records.findings import Finding
from ..records.history import Entry, history
from ..records.run_folder import NoSuchRun, RunFolder
from ..site.load import load_site
from ..task import Task
from . import render
from .data import NIGHTS
from .pictures import data_url

_URGENCY = {"failed": 0, "degraded": 1}
"""Order of sites by the level of their last night; sites with other levels follow."""


@dataclass(frozen=True)
class SiteRow:
    """A site on the page."""

    name: str
    file: Path
    fault: str = ""
    """Why the site cannot be shown."""
    nights: tuple[tuple[Entry, str, str], ...] = ()
    """For each night, oldest first: its last run, the level of its verdict, and the link to its report; "" if there is none."""
    picture: str = ""
    page: str = ""
    """Link to the page about all its nights; "" if there is none."""

    @property
    def findings(self) -> tuple[Finding, ...]:
        """The findings of the last night."""
        if not self.nights:
            return ()
        last_night, _, _ = self.nights[-1]
        if last_night.verdict is None:
            return ()
        return last_night.verdict.findings

    @property
    def order(self) -> tuple[int, str]:
        """Sort key: sites that need attention come first."""
        level = ""
        if self.fault:
            level = "failed"
        elif self.nights:
            level = self.nights[-1][1]
        return _URGENCY.get(level, len(_URGENCY)), self.name


def site_files(places: Sequence[Path]) -> list[Path]:
    """Return the named site files; for a folder its site.yaml, else all site files in it and each site.yaml one level below."""
    files: list[Path] = []
    for place in places:
        site_yaml = place / "site.yaml"
        if not place.is_dir():
            files.append(place)
        elif site_yaml.is_file():
            files.append(site_yaml)
        else:
            candidates = sorted([*place.glob("*.yaml"), *place.glob("*/site.yaml")])
            files += filter(_describes_site, candidates)
    # without repetitions, in this order
    return list(dict.fromkeys(files))


def sites_page(places: Sequence[Path], out: Path) -> str:
    """Return the HTML page of all sites.  out: the file it will be written to; links are relative to it."""
    folder = out.resolve().parent
    rows = [_site_row(file, folder) for file in site_files(places)]
    rows.sort(key=lambda row: row.order)
    return render("sites.html", rows=rows)


def _describes_site(file: Path) -> bool:
    """Return whether a YAML file describes a site, valid or not."""
    try:
        text = read_untrusted(file, MOST_TEXT_BYTES).decode(errors="replace")
    except OSError:
        return False
    # the key alone decides: a file with faults is shown with them
    return re.search(r"""^[{\s]*["']?site["']?\s*:""", text, re.MULTILINE) is not None


def _site_row(file: Path, folder: Path) -> SiteRow:
    try:
        site = load_site(file)
        work = site.work_folder
        runs = history(work) if work.run_ids() else []
    except WbflowError as error:
        # the page says so, and shows the other sites
        return SiteRow(file.parent.name, file, fault=str(error))
    # of several runs of a night, the last one that ended counts
    by_night = {entry.run.date: entry for entry in runs if not entry.killed}
    nights = []
    for date in sorted(by_night)[-NIGHTS:]:
        entry = by_night[date]
        level = entry.verdict.level if entry.verdict else ""
        report = work.run(entry.run.run).report
        link = os.path.relpath(report, folder) if report.is_file() else ""
        nights.append((entry, level, link))
    page = os.path.relpath(work.site_page, folder) if work.site_page.is_file() else ""
    return SiteRow(site.name, site.file, "", tuple(nights), _picture_url(work), page)


def _picture_url(work: WorkFolder) -> str:
    task = Task(FUSE)
    try:
        event = RunFolder.of(work, work.latest_good.name).tasks().get(task)
    except NoSuchRun:
        # no night has been good yet
        return ""
    if event is None or not event.key:
        return ""
    picture = Cache(work).product_file(task, event.key, "picture")
    if not picture:
        return ""
    return data_url(picture)
