"""Acknowledged findings and changes: they stay in the report, but neither degrade a night nor cause a notification.

They are kept beside the site file, and enter the verdict of a night but no cache key.  A change keeps its id for life, so that an
acknowledgement holds for it alone.
"""

from __future__ import annotations

import datetime
import getpass
import re
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import yaml

from ..cache.atomic import write_atomic
from ..cache.untrusted import MOST_TEXT_BYTES, read_untrusted
from ..errors import UsageError
from ..pipeline.summaries import ChangesSummary
from ..records.acknowledgement import Acknowledgement
from ..records.findings import FINDINGS, UNEXPECTED_CHANGE, Finding
from ..records.record import RunRecord
from ..records.run_folder import ended_change, newest_compared
from ..site.models import Site
from ..site.yaml_document import suggest

CHANGE_ID = re.compile(r"C[1-9]\d*", re.IGNORECASE)
"""The id of a change."""
_HEAD = "# What `wbflow acknowledge` says of this site's findings.\n"
"""First line of the file."""


def name_of(finding: Finding) -> str:
    """Return a finding's code and subject, as `wbflow acknowledge` takes it."""
    return " ".join((finding.kind, *finding.subject))


def _file_of(site: Site) -> Path:
    """Return the file of a site's acknowledgements, which is beside the site file."""
    return site.file.with_suffix(".acknowledged")


def read(site: Site) -> tuple[Acknowledgement, ...]:
    """Return the acknowledgements of a site.  Raises UsageError for a file that is not as `wbflow acknowledge` writes it."""
    path = _file_of(site)
    if not path.exists():
        return ()
    try:
        data: Any = yaml.safe_load(read_untrusted(path, MOST_TEXT_BYTES))
        return tuple(Acknowledgement.from_json(entry) for entry in data or ())
    except (OSError, ValueError, TypeError, yaml.YAMLError):
        what = "is not as wbflow acknowledge writes it; nothing is acknowledged"
        remedy = "correct it, or remove it and acknowledge again: wbflow acknowledge SITE.yaml FINDING"
        raise UsageError(what, where=str(path), remedy=remedy) from None


def add(site: Site, finding: str, until: datetime.date | None, note: str) -> Acknowledgement:
    """Acknowledge a finding or a change, replacing an earlier acknowledgement of it.

    Raises UsageError if there is no such finding, change or camera, if the finding is one that fails a night, or if `until` has
    passed.

    Parameters
    ----------
    site, finding
        The site; code and subject of the finding, or the id of a change.
    until, note
        The last night to which it applies (None: all), and why.
    """
    if until and until < site.today():
        raise UsageError(f"--until {until} has passed: today is {site.today()}", remedy="name a day that is to come, or none")
    name = _full_name(finding)
    what = ""
    if CHANGE_ID.fullmatch(name):
        what = _standing_change(site, name)
    else:
        _check_finding(site, name)
    added = Acknowledgement(
        finding=name,
        by=getpass.getuser(),
        on=site.today().isoformat(),
        what=what,
        until=until.isoformat() if until else "",
        note=note,
    )
    others = [entry for entry in read(site) if entry.finding != name]
    _write(site, [*others, added])
    return added


def drop(site: Site, finding: str) -> Acknowledgement:
    """Remove an acknowledgement, and return it.  Raises UsageError if there is none."""
    name = _full_name(finding)
    entries = read(site)
    others = [entry for entry in entries if entry.finding != name]
    if len(others) == len(entries):
        acknowledged = [entry.finding for entry in entries]
        remedy = suggest(name, acknowledged, f"acknowledged: {', '.join(acknowledged) or 'nothing'}")
        raise UsageError(f"{name!r} is not acknowledged", remedy=remedy)
    _write(site, others)
    return next(entry for entry in entries if entry.finding == name)


def _full_name(finding: str) -> str:
    """Return what a user wrote as it is stored: single spaces, and a change by its id alone."""
    words = finding.split()
    if words and CHANGE_ID.fullmatch(words[-1]) and words[:-1] in ([], ["change"], [UNEXPECTED_CHANGE]):
        return words[-1].upper()
    return " ".join(words)


def _check_finding(site: Site, name: str) -> None:
    """Raise UsageError if there is no such finding, or if it cannot be acknowledged."""
    code, *subject = name.split()
    if code not in FINDINGS or FINDINGS[code].level == "failed":
        known = [kind for kind, row in FINDINGS.items() if row.level != "failed"]
        guess = "" if code in FINDINGS else suggest(code, known, "")
        remedy = f"{guess} there are {', '.join(known)}".strip()
        if code.lower() == "change":
            remedy = "name the change by its id, such as C17: wbflow acknowledge SITE.yaml  lists them"
        raise UsageError(f"{code!r} is no finding that can be acknowledged", remedy=remedy)
    cameras = {camera.id for camera in site.cameras}
    unknown = sorted(set(subject) - cameras)
    if unknown:
        remedy = f"{suggest(unknown[0], cameras, '')} its cameras are {', '.join(sorted(cameras))}".strip()
        raise UsageError(f"the site has no camera {unknown[0]!r}", remedy=remedy)


def _standing_change(site: Site, name: str) -> str:
    """Return a change in words.  Raises UsageError if the newest night that was compared does not have it."""
    newest = newest_compared(site.work_folder)
    if newest is None:
        raise UsageError(f"there is no change {name}", remedy="no night has been compared with a reference yet")
    changes = newest.changes
    unit = newest.unit
    if name in changes:
        return changes[name].words(unit)
    # what there is instead
    texts = [f"{change.id} {change.words(unit)}" for change in changes.values()]
    remedy = f"the changes of the newest night: {'; '.join(texts) or 'none'}"
    ended = ended_change(site.work_folder, name)
    if ended:
        change, night = ended
        what = f"{name} ({change.words(unit)}) is gone since the night of {night}: nothing is left to acknowledge"
        raise UsageError(what, remedy=remedy)
    guess = suggest(name, [*changes], "")
    raise UsageError(f"there is no change {name}", remedy=f"{guess} {remedy}".strip())


def with_known(record: RunRecord, known: Iterable[Acknowledgement]) -> RunRecord:
    """Return the record with its acknowledged changes marked."""
    words = {entry.finding: entry.words for entry in known if entry.holds(record.date)}
    results = dict(record.results)
    for stage, result in record.results.items():
        if isinstance(result, ChangesSummary) and result.changes:
            changes = {name: replace(change, acknowledged=words.get(name, "")) for name, change in result.changes.items()}
            results[stage] = replace(result, changes=changes)
    return replace(record, results=results)


def split(
    findings: Iterable[Finding], known: Iterable[Acknowledgement], night: str
) -> tuple[tuple[Finding, ...], tuple[Finding, ...]]:
    """Return the findings of a night that count, and the acknowledged ones, each with its acknowledgement as the remedy."""
    by_name = {entry.finding: entry for entry in known if entry.holds(night)}
    effective: list[Finding] = []
    acknowledged: list[Finding] = []
    for finding in findings:
        entry = by_name.get(name_of(finding))
        # what fails a night counts even if the file says otherwise: `add` refuses it, but people edit files
        if entry is None or FINDINGS[finding.kind].level == "failed":
            effective.append(finding)
        else:
            acknowledged.append(replace(finding, remedy=entry.words))
    return tuple(effective), tuple(acknowledged)


def _write(site: Site, entries: Iterable[Acknowledgement]) -> None:
    items = []
    for entry in entries:
        stated = {name: value for name, value in vars(entry).items() if value}
        items.append(stated)
    text = yaml.safe_dump(items, sort_keys=False, allow_unicode=True)
    write_atomic(_file_of(site), (_HEAD + text).encode())
