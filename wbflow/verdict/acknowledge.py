"""Acknowledged findings and changes: they stay in the report, but neither degrade a night nor cause a notification.

They are kept beside the site file, and enter the verdict of a night but no cache key.  A change gets another number each night,
so an acknowledgement stores its kind and position, which are compared as in `RecordedChange.is_same`.
"""

from __future__ import annotations

import datetime
import getpass
import re
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import yaml

from ..cache.atomic import write_atomic
from ..cache.untrusted import MOST_TEXT_BYTES, read_untrusted
from ..errors import UsageError
from ..pipeline.summaries import ChangesSummary, RecordedChange
from ..records.acknowledgement import Acknowledgement
from ..records.findings import FINDINGS, Finding
from ..records.record import RunRecord
from ..records.run_folder import NoSuchRun, RunFolder
from ..site.models import Site

CHANGE = "change"
"""First word of the name of an acknowledged change."""
_NAME = re.compile(rf"{CHANGE} (\w+) at (-?\d+\.\d+),(-?\d+\.\d+),(-?\d+\.\d+)")
"""Name of an acknowledged change: its kind and its position (x, y, z) in metres."""
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

    Raises UsageError if there is no such finding, change or camera, or if the finding is one that fails a night.

    Parameters
    ----------
    site, finding
        The site; code and subject of the finding, or "change" and its number in the newest run.
    until, note
        The last night to which it applies (None: all), and why.
    """
    name = _full_name(site, finding)
    code, *subject = name.split()
    if code == CHANGE:
        subject = []
    elif code not in FINDINGS or FINDINGS[code].level == "failed":
        known = ", ".join(kind for kind, row in FINDINGS.items() if row.level != "failed")
        raise UsageError(f"{code!r} is no finding that can be acknowledged", remedy=f"there are {known}")
    cameras = {camera.id for camera in site.cameras}
    unknown = sorted(set(subject) - cameras)
    if unknown:
        raise UsageError(f"the site has no camera {unknown[0]!r}", remedy=f"its cameras are {', '.join(sorted(cameras))}")
    added = Acknowledgement(
        finding=name,
        by=getpass.getuser(),
        on=site.today().isoformat(),
        until=until.isoformat() if until else "",
        note=note,
    )
    others = [entry for entry in read(site) if entry.finding != name]
    _write(site, [*others, added])
    return added


def drop(site: Site, finding: str) -> None:
    """Remove an acknowledgement.  Raises UsageError if there is none."""
    entries = read(site)
    name = _full_name(site, finding)
    if all(entry.finding != name for entry in entries):
        known = ", ".join(entry.finding for entry in entries) or "none"
        raise UsageError(f"{name!r} is not acknowledged", remedy=f"acknowledged: {known}")
    _write(site, (entry for entry in entries if entry.finding != name))


def _full_name(site: Site, finding: str) -> str:
    """Return the name of a finding or change; a change may be given by its number in the newest run ("change 2") or by name."""
    name = " ".join(finding.split())
    if name.split(" ")[0] != CHANGE or _change_named(name):
        return name
    try:
        changes = changes_of(RunFolder.of(site.work_folder).record())
    except NoSuchRun:
        changes = {}
    number = name.removeprefix(CHANGE).strip()
    if number not in changes:
        known = "; ".join(f"{CHANGE} {name}: {change.kind}" for name, change in changes.items()) or "none"
        raise UsageError(f"the newest run has no change {number!r}", remedy=f"its changes: {known}")
    change = changes[number]
    # a change that is acknowledged already keeps the position that it was acknowledged with
    for entry in read(site):
        acknowledged = _change_named(entry.finding)
        if acknowledged and change.is_same(acknowledged):
            return entry.finding
    return f"{CHANGE} {change.kind} at {change.x:.1f},{change.y:.1f},{change.z:.1f}"


def _change_named(name: str) -> RecordedChange | None:
    """Return kind and position of a change from its name; None for any other name."""
    parts = _NAME.fullmatch(name)
    if parts is None:
        return None
    return RecordedChange(parts[1], float(parts[2]), float(parts[3]), float(parts[4]))


def changes_of(record: RunRecord) -> Mapping[str, RecordedChange]:
    """Return the changes of a night by number."""
    for result in record.results.values():
        if isinstance(result, ChangesSummary):
            return result.objects
    return {}


def with_known(record: RunRecord, known: Iterable[Acknowledgement]) -> RunRecord:
    """Return the record with its acknowledged changes marked."""
    acknowledged: list[tuple[Acknowledgement, RecordedChange]] = []
    for entry in known:
        change = _change_named(entry.finding)
        if change and entry.holds(record.date):
            acknowledged.append((entry, change))
    if not acknowledged:
        return record
    results = dict(record.results)
    for stage, result in record.results.items():
        if isinstance(result, ChangesSummary) and result.changes:
            changes = {number: _with_acknowledgement(change, acknowledged) for number, change in result.changes.items()}
            results[stage] = replace(result, changes=changes)
    return replace(record, results=results)


def _with_acknowledgement(
    change: RecordedChange, acknowledged: Iterable[tuple[Acknowledgement, RecordedChange]]
) -> RecordedChange:
    """Return a change with the words of the first acknowledgement of it; "" if there is none."""
    for entry, known_change in acknowledged:
        if change.is_same(known_change):
            return replace(change, acknowledged=entry.words)
    return replace(change, acknowledged="")


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
