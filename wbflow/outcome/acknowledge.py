"""Findings and changes that somebody knows of: they stay in the report, and neither degrade a night nor notify anybody.

They lie beside the site file, and enter the verdict of a night but no key of the cache.
"""

from __future__ import annotations

import datetime
import getpass
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from ..cache.atomic import write_atomic
from ..cache.untrusted import MOST_TEXT_BYTES, read_outside
from ..errors import UsageError
from ..plain import Plain
from ..records.findings import FINDINGS, Finding
from ..site.models import Site
from .known_changes import CHANGE, named_change

_HEAD = "# What `wbflow acknowledge` says of this site's findings.\n"


@dataclass(frozen=True)
class Acknowledgement(Plain):
    """That somebody knows of a finding."""

    finding: str
    """Code and subject, "camera-lost crane-2", "fewer-points"; of a change its kind and place, "change new at 9.2,15.3,1.3"."""
    by: str
    on: str
    """ISO 8601 date."""
    until: str = ""
    """The last night that it holds for; "": all."""
    note: str = ""

    def holds(self, night: str) -> bool:
        """Does it hold for a night?"""
        return not self.until or night <= self.until

    @property
    def words(self) -> str:
        """Who knows of it, until when, and why."""
        until = f", until {self.until}" if self.until else ""
        return f"acknowledged by {self.by} on {self.on}{until}{': ' if self.note else ''}{self.note}"


def name_of(finding: Finding) -> str:
    """Return a finding's code and subject, as `wbflow acknowledge` takes it."""
    return " ".join((finding.kind, *finding.subject))


def file_of(site: Site) -> Path:
    """Return where the acknowledgements of a site lie: beside its file."""
    return site.file.with_suffix(".acknowledged")


def read(site: Site) -> tuple[Acknowledgement, ...]:
    """Return the acknowledgements of a site.

    Raises
    ------
    UsageError
        The file is not as `wbflow acknowledge` writes it.
    """
    path = file_of(site)
    if not path.exists():
        return ()
    try:
        data: Any = yaml.safe_load(read_outside(path, MOST_TEXT_BYTES))
        return tuple(Acknowledgement.from_json(entry) for entry in data or ())
    except (OSError, ValueError, TypeError, yaml.YAMLError):
        remedy = "correct it, or remove it and acknowledge again: wbflow acknowledge SITE.yaml FINDING"
        raise UsageError(
            "is not as wbflow acknowledge writes it; nothing is acknowledged", where=str(path), remedy=remedy
        ) from None


def add(site: Site, finding: str, until: datetime.date | None, note: str) -> Acknowledgement:
    """Acknowledge a finding, or a change.  An earlier acknowledgement of it gives way.

    Parameters
    ----------
    site
        Whose.
    finding
        Code and subject; "change" and its number in the newest run.
    until
        The last night that it holds for; None: all.
    note
        Why.

    Raises
    ------
    UsageError
        There is no such finding or change, or it is one of nights that have failed.
    """
    name = _named(site, finding)
    code, *subject = name.split()
    if code == CHANGE:
        subject = []
    elif code not in FINDINGS or FINDINGS[code].level == "failed":
        known = ", ".join(name for name, row in FINDINGS.items() if row.level != "failed")
        raise UsageError(f"{code!r} is no finding that can be acknowledged", remedy=f"there are {known}")
    cameras = {camera.id for camera in site.cameras}
    if unknown := sorted(set(subject) - cameras):
        raise UsageError(f"the site has no camera {unknown[0]!r}", remedy=f"its cameras are {', '.join(sorted(cameras))}")
    today = site.today().isoformat()
    made = Acknowledgement(name, getpass.getuser(), today, until.isoformat() if until else "", note)
    _write(site, [*(one for one in read(site) if one.finding != made.finding), made])
    return made


def drop(site: Site, finding: str) -> None:
    """Take an acknowledgement back.  Raises UsageError where there is none."""
    there = read(site)
    name = _named(site, finding)
    if all(one.finding != name for one in there):
        known = ", ".join(one.finding for one in there) or "none"
        raise UsageError(f"{name!r} is not acknowledged", remedy=f"acknowledged: {known}")
    _write(site, (one for one in there if one.finding != name))


def _named(site: Site, finding: str) -> str:
    name = " ".join(finding.split())
    if name.split(" ")[0] != CHANGE:
        return name
    return named_change(site.work_folder, name, (one.finding for one in read(site)))


def split(
    findings: Iterable[Finding], known: Iterable[Acknowledgement], night: str
) -> tuple[tuple[Finding, ...], tuple[Finding, ...]]:
    """Return the findings of a night that count, and those that somebody knows of, with who does as their remedy."""
    by_name = {one.finding: one for one in known if one.holds(night)}
    counts, acknowledged = list[Finding](), list[Finding]()
    for finding in findings:
        one = by_name.get(name_of(finding))
        if one is None or FINDINGS[finding.kind].level == "failed":
            counts.append(finding)
        else:
            acknowledged.append(
                Finding(finding.kind, finding.subject, finding.text, finding.figures, finding.expected, one.words)
            )
    return tuple(counts), tuple(acknowledged)


def _write(site: Site, entries: Iterable[Acknowledgement]) -> None:
    data = [{name: value for name, value in vars(one).items() if value} for one in entries]
    write_atomic(file_of(site), (_HEAD + yaml.safe_dump(data, sort_keys=False, allow_unicode=True)).encode())
