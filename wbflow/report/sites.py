"""One page over several sites: the verdict, findings and reports of their last nights."""

from __future__ import annotations

import base64
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ..cache.layout import WorkFolder
from ..cache.store import Cache
from ..cache.untrusted import MOST_TEXT_BYTES, read_outside
from ..errors import WbflowError
from ..outcome.history import Entry, history
from ..pipeline.stages import FUSE
from ..records.findings import Finding
from ..records.run_folder import NoSuchRun, RunFolder
from ..site.load import load_site
from ..site.models import Site
from ..task import Task
from .data import NIGHTS
from .page import ASSETS

_NO_LEVEL = ""
MOST_FINDINGS = 5


@dataclass(frozen=True)
class Night:
    """One night of a site, by its last run."""

    date: str
    level: str
    points: str
    words: str
    href: str
    """Its report; "" where it was removed."""


@dataclass(frozen=True)
class Row:
    """A site on the page."""

    name: str
    file: str
    fault: str = ""
    """Why the site cannot be shown."""
    nights: tuple[Night, ...] = ()
    """Oldest first."""
    findings: tuple[Finding, ...] = ()
    """Of the last one."""
    left_out: int = 0
    """Findings that the page leaves out."""
    picture: str = ""
    """The last cloud, as a data URL."""

    @property
    def last(self) -> Night | None:
        return self.nights[-1] if self.nights else None

    @property
    def order(self) -> tuple[int, str]:
        """Sites that need attention come first."""
        level = "failed" if self.fault else self.last.level if self.last else _NO_LEVEL
        return ({"failed": 0, "degraded": 1}.get(level, 2), self.name)


def site_files(places: Sequence[Path]) -> list[Path]:
    """Return the named site files; of a folder its site.yaml, else all site files in it and one level below."""
    found: list[Path] = []
    for place in places:
        own = place / "site.yaml"
        if not place.is_dir() or own.is_file():
            found.append(own if place.is_dir() else place)
        else:
            below = [*place.glob("*.yaml"), *place.glob("*/site.yaml")]
            found += [path for path in sorted(below) if _is_one(path)]
    return list(dict.fromkeys(found))


def page(places: Sequence[Path], out: Path) -> str:
    """Return the HTML of all sites.  out: its file, for the links in it."""
    from jinja2 import Environment, StrictUndefined
    from markupsafe import Markup

    rows = sorted((_row(file, out.resolve().parent) for file in site_files(places)), key=lambda row: row.order)
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    style = Markup((ASSETS / "style.css").read_text(encoding="utf-8"))
    return environment.from_string((ASSETS / "sites.html").read_text(encoding="utf-8")).render(rows=rows, style=style)


def _is_one(file: Path) -> bool:
    """Return whether a YAML file describes a site, valid or not."""
    try:
        text = read_outside(file, MOST_TEXT_BYTES).decode(errors="replace")
    except OSError:
        return False
    return re.search(r"""^[{\s]*["']?site["']?\s*:""", text, re.MULTILINE) is not None


def _row(file: Path, folder: Path) -> Row:
    try:
        site = load_site(file)
        return _of_site(site, folder)
    except WbflowError as error:
        return Row(file.parent.name, str(file), fault=str(error))


def _of_site(site: Site, folder: Path) -> Row:
    work = site.work_folder
    entries = history(work) if work.run_ids() else []
    by_night = {entry.run.date: entry for entry in entries}
    nights = [by_night[date] for date in sorted(by_night)][-NIGHTS:]
    found = nights[-1].verdict.findings if nights and nights[-1].verdict else ()
    shown, left = tuple(found[:MOST_FINDINGS]), max(0, len(found) - MOST_FINDINGS)
    rows = tuple(_night(work, entry, folder) for entry in nights)
    return Row(site.name, str(site.file), "", rows, shown, left, _picture(work))


def _night(work: WorkFolder, entry: Entry, folder: Path) -> Night:
    report = work.run(entry.run.run).report
    href = Path(os.path.relpath(report, folder)).as_posix() if report.is_file() else ""
    points = f"{entry.run.points:,}" if entry.run.points else "no cloud"
    return Night(entry.run.date, entry.verdict.level if entry.verdict else _NO_LEVEL, points, entry.words, href)


def _picture(work: WorkFolder) -> str:
    """Return the picture of the last cloud."""
    try:
        run = RunFolder.of(work, work.latest_good.name)
        event = run.tasks().get(task := Task(FUSE))
    except NoSuchRun:
        return ""
    picture = Cache(work).drawing(task, event.key, "picture") if event and event.key else None
    return f"data:image/jpeg;base64,{base64.b64encode(picture).decode()}" if picture else ""
