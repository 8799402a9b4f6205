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

    @property
    def findings(self) -> tuple[Finding, ...]:
        """The findings of the last night."""
        verdict = self.nights[-1][0].verdict if self.nights else None
        return verdict.findings if verdict else ()

    @property
    def order(self) -> tuple[int, str]:
        """Sort key: sites that need attention come first."""
        level = "failed" if self.fault else self.nights[-1][1] if self.nights else ""
        return ({"failed": 0, "degraded": 1}.get(level, 2), self.name)


def site_files(places: Sequence[Path]) -> list[Path]:
    """Return the named site files; for a folder its site.yaml, else all site files in it and each site.yaml one level below."""
    files: list[Path] = []
    for place in places:
        site_yaml = place / "site.yaml"
        if not place.is_dir() or site_yaml.is_file():
            files.append(site_yaml if place.is_dir() else place)
        else:
            files += [path for path in sorted([*place.glob("*.yaml"), *place.glob("*/site.yaml")]) if _describes_site(path)]
    return list(dict.fromkeys(files))


def sites_page(places: Sequence[Path], out: Path) -> str:
    """Return the HTML page of all sites.  out: the file it will be written to; links are relative to it."""
    rows = sorted((_site_row(file, out.resolve().parent) for file in site_files(places)), key=lambda row: row.order)
    return render("sites.html", rows=rows)


def _describes_site(file: Path) -> bool:
    """Return whether a YAML file describes a site, valid or not."""
    try:
        text = read_untrusted(file, MOST_TEXT_BYTES).decode(errors="replace")
    except OSError:
        return False
    return re.search(r"""^[{\s]*["']?site["']?\s*:""", text, re.MULTILINE) is not None


def _site_row(file: Path, folder: Path) -> SiteRow:
    try:
        site = load_site(file)
        work = site.work_folder
        by_night = {entry.run.date: entry for entry in (history(work) if work.run_ids() else []) if not entry.killed}
    except WbflowError as error:
        return SiteRow(file.parent.name, file, fault=str(error))
    nights = []
    for _, entry in sorted(by_night.items())[-NIGHTS:]:
        report = work.run(entry.run.run).report
        link = os.path.relpath(report, folder) if report.is_file() else ""
        nights.append((entry, entry.verdict.level if entry.verdict else "", link))
    return SiteRow(site.name, site.file, "", tuple(nights), _picture_url(work))


def _picture_url(work: WorkFolder) -> str:
    task = Task(FUSE)
    try:
        event = RunFolder.of(work, work.latest_good.name).tasks().get(task)
    except NoSuchRun:
        return ""
    picture = Cache(work).product_file(task, event.key, "picture") if event and event.key else None
    return data_url(picture) if picture else ""
